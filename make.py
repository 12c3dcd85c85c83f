"""The two commands of the README where there is no make, such as on Windows:

    py make.py demo       install into .venv (no torch), run one episode; pictures in runs/demo
    py make.py test       install torch too and run all tests
    py make.py docs       build the documentation site into build/site

The same as `make demo`, `make test` and `make docs`. Needs Python 3.11 or newer.
"""

from __future__ import annotations

import os
import subprocess
import sys
import venv
from pathlib import Path

ROOT = Path(__file__).resolve().parent
FOLDER = ROOT / ".venv"
PYTHON = FOLDER / ("Scripts/python.exe" if os.name == "nt" else "bin/python")
TARGETS: dict[str, tuple[str, list[str], list[list[str]]]] = {
    "demo": ("demo", ["-e", ".[viz]"], [["-m", "twc_env", "explore", "--map", "twin-01", "--out", "runs/demo"]]),
    "test": ("test", ["torch", "-e", ".[viz,dev,train,ocr]"], [["-m", "pytest", "-q"]]),
    "docs": ("docs", ["-e", ".[viz,docs]"], [["-m", "mkdocs", "build", "--strict"]]),
}
"""Target -> name of the mark that it is installed, what pip installs, and the commands of Python to run."""


def main(arguments: list[str]) -> int:
    """Install what a target needs, once, and run it; returns the exit status."""
    if sys.version_info < (3, 11):  # noqa: UP036 that is what this line is for
        print("twc_env needs Python 3.11 or newer; on Windows: py -3.12 make.py ...")
        return 1
    if len(arguments) != 1 or arguments[0] not in TARGETS:
        print(__doc__)
        return 2
    mark, packages, commands = TARGETS[arguments[0]]
    if not PYTHON.exists():
        venv.create(FOLDER, with_pip=True)
    done = FOLDER / f"installed-{mark}"
    pins = [ROOT / "pyproject.toml", ROOT / "constraints.txt"]
    if not done.exists() or done.stat().st_mtime < max(pin.stat().st_mtime for pin in pins):
        print("installing into .venv (a minute or more)", flush=True)
        pip = ["-m", "pip", "install", "--quiet", "--disable-pip-version-check", "-c", "constraints.txt"]
        if status := run([*pip, *packages]):
            return status
        done.touch()
    for command in commands:
        if status := run(command):
            return status
    return 0


def run(arguments: list[str]) -> int:
    """The exit status of the Python of .venv with these arguments."""
    return subprocess.run([str(PYTHON), *arguments], cwd=ROOT).returncode


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
