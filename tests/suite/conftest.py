"""A tiny suite: two tasks of a few seconds of simulated time."""

import pytest

from twc_env import tasks

TINY = {
    "twc/TinyOne-v1": {
        "map": "gen:office:120:train", "robots": 2, "max_cycles": 60, "lidar.beam_count": 60,
        "episode.ends_at_coverage": 0.95,
    },
    "twc/TinyTwo-v1": {
        "map": "gen:office+ring:150:train", "robots": 2, "max_cycles": 45, "lidar.beam_count": 60,
        "episode.starts": "entrance", "episode.ends_at_coverage": 0.3,
    },
}  # fmt: skip


@pytest.fixture
def tiny(monkeypatch):
    """Ids of the tasks of the suite v1, which are those of a tiny one."""
    monkeypatch.setitem(tasks.SUITES, "v1", tuple(TINY))
    for task, settings in TINY.items():
        monkeypatch.setitem(tasks.TASKS, task, settings)
    return tuple(TINY)
