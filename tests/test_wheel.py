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
