"""Settings that all tests share."""

import os
import signal
import threading

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # the workers of pytest-xdist share the cores
os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np
import pytest
from hypothesis import settings

from tests.chromium import browser  # noqa: F401  a fixture
from twc_env.errors import ConfigError
from twc_env.records.geometry import wrap_angle
from twc_env.world.sensors import ocr

if threading.current_thread() is threading.main_thread():  # workers of pytest-xdist ignore it, and so would children
    signal.signal(signal.SIGINT, signal.default_int_handler)

# No deadlines, because the first call of a kernel compiles it; CI draws the same examples in every run.
settings.register_profile("twc_env", deadline=None, derandomize="CI" in os.environ)
settings.load_profile("twc_env")


def wander_by_scan(ranges_m: np.ndarray, step: int = 0, robot: int = 0) -> np.ndarray:
    """Action (2,) of a reactive policy that drives towards open space, from the latest scan (beams,) [m] only."""
    beams = len(ranges_m)
    bearing = wrap_angle(np.arange(beams) * 2 * np.pi / beams)
    near = np.minimum(ranges_m, 4.0)
    width = beams // 18
    clear = np.min([np.roll(near, k) for k in range(-width, width + 1)], axis=0)
    score = np.where(np.abs(bearing) > 2.2, -np.inf, clear - 0.6 * np.abs(bearing))
    goal = bearing[np.argmax(score)] + 0.3 * np.sin(0.02 * step + 2 * robot)
    ahead = near[np.abs(bearing) < 0.5].min()
    speed = np.clip((ahead - 0.35) / 0.8, 0.0, 1.0) * max(np.cos(goal), 0.0)
    return np.array([speed, np.clip(1.5 * goal, -1.0, 1.0)], np.float32)


@pytest.fixture(scope="session")
def wander():
    return wander_by_scan


@pytest.fixture(scope="session")
def slowdown() -> float:
    """How much more processor time than alone a test may take: workers of pytest-xdist share caches and cores. In `make
    check`, which runs the tests marked `timed` one by one, the limits hold as they stand."""
    return 3.0 if "PYTEST_XDIST_WORKER" in os.environ else 1.0


@pytest.fixture
def refusal(capsys):
    """A function that runs a command with invalid arguments; returns its error message, which must be one line."""

    def refusal_of(main, arguments) -> str:
        capsys.readouterr()
        assert main(arguments) == 2
        said = capsys.readouterr().err
        assert said.startswith("error: ") and said.count("\n") == 1
        return said

    return refusal_of


@pytest.fixture(scope="session")
def real_ocr():
    """Skips where the extra `ocr` is not installed or cannot be loaded."""
    try:
        ocr.require()
    except ConfigError as error:
        pytest.skip(str(error))
