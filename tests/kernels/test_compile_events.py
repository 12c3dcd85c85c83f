"""A numba that lacks its experimental events compiles all the same."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
HIDDEN = "import sys, numba\ndel numba.core.event\nsys.modules['numba.core.event'] = None\n"
KERNEL = "from twc_env.kernels.compiled import kernel\n\n\n@kernel\ndef doubled(x):\n    return 2 * x\n"
CALL = """
from kernels import doubled
from twc_env.kernels import compilation, compile_events
announcer = compilation.announcer()
assert doubled(3) == 6
print(compile_events.ARE_KNOWN, announcer.count, len(doubled.stats.cache_hits))
"""


def said(folder, code, **environment):
    environment = {**os.environ, "PYTHONPATH": str(ROOT), **environment}
    done = subprocess.run([sys.executable, "-c", code], cwd=folder, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return done.stdout.split()


@pytest.fixture
def told(tmp_path):
    """What a process says of a kernel that the cache in this folder may hold."""
    (tmp_path / "kernels.py").write_text(KERNEL)
    return lambda code: said(tmp_path, code, NUMBA_CACHE_DIR=str(tmp_path / "cache"))


def test_without_events_kernels_are_compiled_kept_and_read_and_nothing_is_announced(told):
    assert told(HIDDEN + CALL) == ["False", "0", "0"]
    assert told(HIDDEN + CALL) == ["False", "0", "1"]


def test_with_events_the_compilation_is_counted(told):
    assert told(CALL) == ["True", "1", "0"]


def test_without_events_an_episode_is_explored_and_timed(tmp_path):
    code = (
        "from twc_env.agents.explore import explore\nfrom twc_env.config import EnvConfig, override\n"
        "config = override(EnvConfig(), {'max_cycles': 12, 'robots': 1, 'slam.mode': 'off', 'map': 'twin-01'})\n"
        "run = explore(config, 'wall-follower', 0)\n"
        "print(run.result.figures['steps'], run.report['env_steps_per_s'] > 0)\n"
    )
    assert said(tmp_path, HIDDEN + code) == ["12", "True"]
