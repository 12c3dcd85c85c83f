import os
import re
import shutil
import subprocess
import sys
import tarfile
import zipfile
from pathlib import Path

import pytest

from tests.given_kernels import give_kernels

ROOT = Path(__file__).parents[1]


def unpacked_wheel(folder: Path) -> Path:
    """A folder into which the wheel of this clone, built in `folder`, was unpacked."""
    command = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(folder)]
    subprocess.run(command, cwd=ROOT, check=True, capture_output=True)
    (wheel,) = folder.glob("*.whl")
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(folder / "site")
    return folder / "site"


@pytest.fixture(scope="module")
def installed(tmp_path_factory):
    return unpacked_wheel(tmp_path_factory.mktemp("wheel"))


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


def test_the_sample_log_and_the_catalogue_of_data_are_in_the_wheel(installed):
    for folder in ("sample", "public"):
        place = Path("twc_env") / "datasets" / folder
        names = {path.name for path in (ROOT / place).iterdir() if path.suffix not in (".py", "")}
        assert names
        assert names <= {path.name for path in (installed / place).iterdir()}
    assert sum(path.stat().st_size for path in (installed / "twc_env" / "datasets" / "sample").iterdir()) < 600_000


def test_the_wheel_has_the_version_of_the_package(installed):
    import twc_env

    (metadata,) = installed.glob("*.dist-info/METADATA")
    assert f"\nVersion: {twc_env.__version__}\n" in metadata.read_text()


def metadata_of(built_in: Path, kind: str, into: Path, **env: str) -> str:
    """What the wheel or the sdist built there says of itself."""
    command = [sys.executable, "-m", "hatchling", "build", "-t", kind, "-d", str(into)]
    subprocess.run(command, cwd=built_in, check=True, capture_output=True, env={**os.environ, **env})
    if kind == "sdist":
        (file,) = into.glob("*.tar.gz")
        with tarfile.open(file) as archive:
            archive.extractall(into, filter="data")
        (text,) = into.glob("*/PKG-INFO")
        return text.read_text(encoding="utf-8")
    (file,) = into.glob("*.whl")
    with zipfile.ZipFile(file) as archive:
        (name,) = (name for name in archive.namelist() if name.endswith(".dist-info/METADATA"))
        return archive.read(name).decode()


def test_a_build_that_knows_the_repository_has_project_urls_and_absolute_links(installed, tmp_path):
    here = {"GITHUB_REPOSITORY": "some-one/twc.env", "GITHUB_WORKSPACE": str(ROOT)}
    (plain,) = (path.read_text() for path in installed.glob("*.dist-info/METADATA"))
    strange = metadata_of(ROOT, "wheel", tmp_path / "1", **{**here, "GITHUB_WORKSPACE": str(tmp_path)})
    assert not re.search("^Project-URL:", plain + strange, re.MULTILINE) and "](docs/results.md)" in plain
    known = metadata_of(ROOT, "sdist", tmp_path / "2", **here)
    assert "\nProject-URL: Repository, https://github.com/some-one/twc.env\n" in known
    assert "](https://github.com/some-one/twc.env/blob/main/docs/results.md)" in known
    assert "](https://raw.githubusercontent.com/some-one/twc.env/main/docs/pictures/episode.gif)" in known
    assert not re.search(r"\]\((?!https://|#)", known)
    (unpacked,) = (tmp_path / "2").glob("*/PKG-INFO")
    again = metadata_of(unpacked.parent, "wheel", tmp_path / "3", GITHUB_REPOSITORY="other/project")
    assert [line for line in again.splitlines() if "URL" in line] == [
        line for line in known.splitlines() if "URL" in line
    ]


def test_the_wheel_has_the_command_the_teams_and_the_learners(installed):
    (entries,) = installed.glob("*.dist-info/entry_points.txt")
    assert "twc-env = twc_env.__main__:main" in entries.read_text()
    for folder in ("agents", "training"):
        names = {path.name for path in (ROOT / folder).glob("*.py")}
        assert names == {path.name for path in (installed / "twc_env" / folder).glob("*.py")}


def environment(folder: Path) -> Path:
    """The Python of a fresh virtual environment, which also finds the libraries that this one finds."""
    subprocess.run([sys.executable, "-m", "venv", "--without-pip", str(folder)], check=True)
    python = folder / ("Scripts/python.exe" if os.name == "nt" else "bin/python")
    (site,) = (Path(path) for path in printed(python, "import sysconfig; print(sysconfig.get_path('purelib'))"))
    libraries = [path for path in sys.path if path.endswith("site-packages")]
    (site / "libraries.pth").write_text("\n".join(libraries))  # not their own .pth files, which may name a clone
    return python


def printed(python: Path, code: str, **settings) -> list[str]:
    done = subprocess.run([str(python), "-c", code], check=True, capture_output=True, text=True, **settings)
    return done.stdout.splitlines()


def install(python: Path, *what: str) -> None:
    """Install by pip, from this machine alone."""
    pytest.importorskip("pip")
    offline = ["--no-index", "--no-deps", "--no-build-isolation", "--disable-pip-version-check", "--quiet"]
    command = [sys.executable, "-m", "pip", "--python", str(python), "install", *offline, *what]
    subprocess.run(command, check=True, capture_output=True)


STRANGERS = """
from importlib.util import find_spec
import twc_env
from twc_env.agents import Policy
specs = [find_spec(name) for name in ("agents", "training", "tests")]
print(twc_env.__file__)
for spec in filter(None, specs):
    print(spec.origin, *spec.submodule_search_locations or ())
"""
"""Where the package is, and packages that it must not bring."""


@pytest.mark.parametrize("kind", ["ordinary", "editable"])
def test_an_install_by_pip_brings_one_package(installed, tmp_path, kind):
    python = environment(tmp_path / "env")
    install(python, *(["-e", str(ROOT)] if kind == "editable" else map(str, installed.parent.glob("*.whl"))))
    (tmp_path / "empty").mkdir()
    file, *others = printed(python, STRANGERS, cwd=tmp_path / "empty")
    assert Path(file).is_relative_to(ROOT if kind == "editable" else tmp_path / "env")
    assert [other for other in others if str(ROOT) in other or str(tmp_path) in other] == []


COMPILED_AGAIN = "twc_env.world.motion.dynamics-"
"""Kernels that the commands below need, and compile in a moment; the others are given."""


@pytest.mark.slow
def test_an_installed_wheel_works_without_home_in_an_empty_folder_if_the_package_cannot_be_written(installed, tmp_path):
    python = environment(tmp_path / "env")
    install(python, *map(str, installed.parent.glob("*.whl")))
    (empty := tmp_path / "empty").mkdir()
    package = Path(printed(python, "import twc_env; print(twc_env.__file__)", cwd=empty)[0]).parent
    for folder in [package, *(path for path in package.rglob("*") if path.is_dir() and path.name != "__pycache__")]:
        shutil.rmtree(folder / "__pycache__", ignore_errors=True)
        (folder / "__pycache__").write_text("")  # a file: not even root can make the folder
        folder.chmod(0o555)
    before = sorted(package.rglob("*"))
    env = {key: os.environ[key] for key in ("PATH", "SYSTEMROOT") if key in os.environ}
    env["XDG_CACHE_HOME"] = str(tmp_path / "cache")
    give_kernels(package.parent, tmp_path / "cache")
    for some in (tmp_path / "cache").rglob(f"{COMPILED_AGAIN}*"):
        shutil.rmtree(some)
    for arguments in (
        ["explore", "--map", "twin-01", "--steps", "20", "--out", "run"],
        ["compare", "--agents", "nearest-frontier", "random", "--buildings", "2", "--steps", "20"],
    ):
        command = [str(python.with_name("twc-env")), *arguments]
        done = subprocess.run(command, cwd=empty, env=env, capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
    assert list((tmp_path / "cache").rglob(f"{COMPILED_AGAIN}*/**/*.nbc"))
    assert {path.name for path in empty.iterdir()} == {"run", "runs"}
    assert {"report.json", "map.png", "twin-01-seed0.gif"} <= {path.name for path in (empty / "run").iterdir()}
    assert sorted(package.rglob("*")) == before
    for folder in [package, *(path for path in package.rglob("*") if path.is_dir())]:
        folder.chmod(0o755)  # so that it can be removed


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
