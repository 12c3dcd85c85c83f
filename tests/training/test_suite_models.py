"""Trained models as teams of a benchmark."""

import pytest

from twc_env.config import EnvConfig, override
from twc_env.suite.entries import Entry
from twc_env.suite.player import digest_of_team, is_model, play

pytestmark = pytest.mark.usefixtures("torch")


def entry(run, robots: int, **settings) -> Entry:
    fixed = {"map": "gen:office:150:test/0000", "robots": robots, "max_cycles": 60, **settings}
    return Entry("twc/Tiny-v1", override(EnvConfig(), fixed), str(run), 0)


def test_a_model_plays_a_task_in_time_steps_like_any_team(task, run):
    assert is_model(str(run)) and is_model(str(run / "model.safetensors"))
    assert not is_model("random") and not is_model("mine.py:Mine")
    first = play(entry(run, task.robots))
    assert (first["steps"], len(first["coverage"])) == (60, 6)
    assert play(entry(run / "model.safetensors", task.robots)) == first, "a folder and its model are the same team"
    assert digest_of_team(entry(run, 2)) == digest_of_team(entry(run / "model.safetensors", 2)) != ""


def test_a_model_plays_with_any_number_of_robots(run):
    for robots in (1, 3, 5):
        assert play(entry(run, robots, max_cycles=20))["steps"] == 20
