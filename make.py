"""The commands of the Makefile where there is no make, such as on Windows; all but `coverage` and `clean`:

    py make.py demo       install into .venv (no torch), run one episode; pictures in runs/demo
    py make.py test       install torch too and run all tests
    py make.py setup      .venv with everything but torch
    py make.py docs       build the documentation site into build/site; with --repository OWNER/NAME, where the
                          project lies on GitHub, notebooks get links to Colab
    py make.py check      format, lint, types, import arrows and costs
    py make.py test-bounds       the engine's tests with bounds checks of compiled code (slow)
    py make.py soak       hours: 1,000,000 steps, malformed input of every kind; counts in runs/soak
    py make.py test-ray   RLlib trains a team, Ray plays a benchmark, in .venv-ray
    py make.py train-torchrl     PPO of TorchRL on a task
    py make.py train-benchmarl   MAPPO of BenchMARL on a task, in .venv-benchmarl

Each is the same as `make` of that name. Needs Python 3.11 or newer.
"""

from __future__ import annotations

import os
import subprocess
import sys
import venv
from pathlib import Path

ROOT = Path(__file__).resolve().parent
PINS = ["-c", "constraints.txt"]
DEV = [*PINS, "-e", ".[viz,dev]"]
TEST = [*PINS, "torch", "-e", ".[viz,dev,train,ocr]"]
SOAK = (
    "--actions 100000 --maps 10000 --logs 10000 --bags 10000 --tables 10000 --settings 10000 --graphs 10000 "
    "--arrays 10000 --calls 10000 --bombs 50 --doors 1000 --accidents 74 --instructions 140 --observations 10000 "
    "--resume runs/soak/rows.jsonl --json runs/soak/trust.json"
)
STEPS = "--steps 1000000 --resume runs/soak/episodes.jsonl --json runs/soak/trust.json"
PYTEST = ["-m", "pytest", "-q", "-n", "auto", "--maxprocesses", "4", "--dist", "worksteal"]
RAY_TESTS = ["tests/running/test_ray_cluster.py", "tests/suite/test_ray.py"]
RAY_TESTS += ["tests/vector/test_ray_pool.py", "tests/training/test_resuming.py"]
TARGETS: dict[str, tuple[str, list[str], list[list[str]]]] = {
    "demo": (
        ".venv/installed-demo",
        [*PINS, "-e", ".[viz]"],
        [["-m", "twc_env", "explore", "--map", "twin-01", "--out", "runs/demo"]],
    ),
    "setup": (".venv/installed-dev", DEV, []),
    "check": (
        ".venv/installed-dev",
        DEV,
        [
            ["-m", "ruff", "format", "--check", "."],
            ["-m", "ruff", "check", "."],
            ["-m", "mypy"],
            ["-m", "pytest", "-q", "tests/test_architecture.py", "tests/test_import.py"],
            [
                "-m",
                "pytest",
                "-q",
                "-m",
                "timed",
                "tests/world/building",
                "tests/planning",
                "tests/exploration/drawing",
            ],
        ],
    ),
    "test": (".venv/installed-test", TEST, [["-m", "twc_env", "warm-up"], PYTEST]),
    "test-bounds": (".venv/installed-test", TEST, [[*PYTEST, "tests/slam", "tests/exploration"]]),
    "soak": (
        ".venv/installed-test",
        TEST,
        [
            ["-m", "tests.soak", *SOAK.split()],
            ["-m", "tests.soak", *STEPS.split()],
        ],
    ),
    "docs": (".venv/installed-docs", [*PINS, "-e", ".[viz,docs]"], [["-m", "mkdocs", "build", "--strict"]]),
    "test-ray": (
        ".venv-ray/installed",
        ["-e", ".[ray,viz,train]", "torch==2.13.0", "pytest", "hypothesis"],
        [
            ["-c", "import ray.rllib"],
            ["-m", "pytest", "-q", "-k", "rllib or RLlib", "tests/vector/test_tools.py", "tests/docs/test_snippets.py"],
            ["-m", "pytest", "-q", *RAY_TESTS],
            ["docs/tutorials/rllib_ppo.py", "1200", "runs/rllib", "twc/ExploreQuick-v1"],
        ],
    ),
    "train-torchrl": (
        ".venv/installed-test",
        TEST,
        [["docs/tutorials/torchrl_ppo.py", "1200", "runs/torchrl", "twc/ExploreQuick-v1"]],
    ),
    "train-benchmarl": (
        ".venv-benchmarl/installed",
        ["-e", ".[viz]", "benchmarl>=1.5", "torch==2.13.0"],
        [["docs/tutorials/benchmarl_mappo.py", "1200", "runs/benchmarl", "twc/ExploreQuick-v1"]],
    ),
}
"""Target -> the mark that it is installed, what pip installs, and the commands of Python to run."""
OPTIONAL = {
    ".venv/installed-test": [
        ([*PINS, "-e", ".[viz,ros,docs]"], "rosbags or mkdocs-material"),
        ([*PINS, "-e", ".[torchrl,rerun]", "sb3-contrib"], "TorchRL, Rerun or sb3-contrib"),
    ],
}
"""Mark -> what pip may also install, and its name in words: where it is not to be had, its tests are skipped."""
ENVIRONMENT = {
    "test-bounds": {"NUMBA_BOUNDSCHECK": "1", "NUMBA_CACHE_DIR": ".numba_bounds"},
    "docs": {"NO_MKDOCS_2_WARNING": "1"},
}


def main(arguments: list[str]) -> int:
    """Install what a target needs, once, and run it; returns the exit status."""
    if sys.version_info < (3, 11):  # noqa: UP036 that is what this line is for
        print("twc_env needs Python 3.11 or newer; on Windows: py -3.12 make.py ...")
        return 1
    if arguments[:1] == ["docs"] and arguments[1:2] == ["--repository"] and len(arguments) == 3:
        os.environ["GITHUB_REPOSITORY"] = arguments.pop()
        arguments.pop()
    if len(arguments) != 1 or arguments[0] not in TARGETS:
        print(__doc__)
        return 2
    mark, packages, commands = TARGETS[arguments[0]]
    os.environ |= ENVIRONMENT.get(arguments[0], {})
    done = ROOT / mark
    python = done.parent / ("Scripts/python.exe" if os.name == "nt" else "bin/python")
    if not python.exists():
        venv.create(done.parent, with_pip=True)
    pins = [ROOT / "pyproject.toml", ROOT / "constraints.txt"]
    if not done.exists() or done.stat().st_mtime < max(pin.stat().st_mtime for pin in pins):
        print(f"installing into {done.parent.name} (a minute or more)", flush=True)
        if status := install(python, packages):
            return status
        for others, names in OPTIONAL.get(mark, []):
            if install(python, others):
                print(f"{names} is not to be had here: their tests are skipped", flush=True)
        done.touch()
    for command in commands:
        if status := run(python, command):
            return status
    return 0


def install(python: Path, packages: list[str]) -> int:
    """The exit status of pip, which shows its errors, but not its warnings about the machine's own settings of pip."""
    return run(python, ["-m", "pip", "install", "-qq", "--disable-pip-version-check", *packages])


def run(python: Path, arguments: list[str]) -> int:
    """The exit status of this Python with these arguments."""
    return subprocess.run([str(python), *arguments], cwd=ROOT).returncode


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
