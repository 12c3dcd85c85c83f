import os
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]


@pytest.fixture(scope="module")
def installed(tmp_path_factory):
    """A folder into which the built wheel was unpacked."""
    folder = tmp_path_factory.mktemp("wheel")
    command = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(folder)]
    subprocess.run(command, cwd=ROOT, check=True, capture_output=True)
    (wheel,) = folder.glob("*.whl")
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(folder / "site")
    return folder / "site"


def test_the_wheel_contains_only_twc_env_at_the_top(installed):
    names = {path.name for path in installed.iterdir()}
    assert {name for name in names if not name.endswith(".dist-info")} == {"twc_env"}


def test_every_bundled_map_is_in_the_wheel(installed):
    maps = {path.name for path in (ROOT / "maps").glob("*.json")}
    assert maps >= {"twin-01.json", "twin-02.json"}
    assert maps == {path.name for path in (installed / "twc_env" / "maps").glob("*.json")}


def test_maps_can_be_loaded_by_name_from_an_installed_wheel(installed, tmp_path):
    code = "import twc_env; print(twc_env.__file__); print(twc_env.load_map('twin-01').name)"
    done = subprocess.run(
        [sys.executable, "-c", code],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(installed)},
        check=True,
        capture_output=True,
        text=True,
    )
    file, name = done.stdout.splitlines()
    assert Path(file).is_relative_to(installed)
    assert name == "twin-01"


def test_the_wheel_has_the_version_of_the_package(installed):
    import twc_env

    (metadata,) = installed.glob("*.dist-info/METADATA")
    assert f"\nVersion: {twc_env.__version__}\n" in metadata.read_text()


def test_the_wheel_has_the_command_the_teams_and_the_learners(installed):
    (entries,) = installed.glob("*.dist-info/entry_points.txt")
    assert "twc-env = twc_env.__main__:main" in entries.read_text()
    for folder in ("agents", "training"):
        names = {path.name for path in (ROOT / folder).glob("*.py")}
        assert names == {path.name for path in (installed / "twc_env" / folder).glob("*.py")}


@pytest.mark.slow
def test_an_installed_wheel_explores_and_compares_in_any_folder(installed, tmp_path):
    env = {**os.environ, "PYTHONPATH": str(installed), "NUMBA_CACHE_DIR": str(tmp_path / "cache")}
    code = "from twc_env.agents import Policy; import twc_env.agents; print(twc_env.agents.__file__)"
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path, env=env, check=True, capture_output=True, text=True
    )
    assert Path(done.stdout.strip()).is_relative_to(installed)
    for arguments in (
        ["explore", "--map", "twin-01", "--steps", "20", "--no-pictures", "--out", "run"],
        ["compare", "--agents", "nearest-frontier", "random", "--buildings", "2", "--steps", "20"],
    ):
        command = [sys.executable, "-m", "twc_env", *arguments]
        done = subprocess.run(command, cwd=tmp_path, env=env, capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
    assert (tmp_path / "run" / "report.json").exists()


def test_an_editable_install_puts_no_other_package_on_the_path(tmp_path):
    command = [sys.executable, "-m", "hatchling", "build", "-t", "wheel:editable", "-d", str(tmp_path)]
    subprocess.run(command, cwd=ROOT, check=True, capture_output=True)
    (wheel,) = tmp_path.glob("*.whl")
    with zipfile.ZipFile(wheel) as archive:
        tops = {name.split("/")[0] for name in archive.namelist()}
        paths = [
            line
            for name in archive.namelist()
            if name.endswith(".pth")
            for line in archive.read(name).decode().split("\n")
        ]
    assert not tops & {"agents", "training", "tests", "twc_env"}  # a folder twc_env would hide the clone
    assert str(ROOT) not in paths
