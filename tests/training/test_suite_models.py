"""Trained models as teams of a benchmark."""

import pytest

from twc_env.config import EnvConfig, override
from twc_env.errors import DataError
from twc_env.suite.entries import Entry
from twc_env.suite.player import digest_of_team, is_model, play

pytestmark = pytest.mark.usefixtures("torch")


def entry(run, robots: int, **settings) -> Entry:
    fixed = {"map": "gen:office:150:test/0000", "robots": robots, "max_cycles": 60, **settings}
    return Entry("twc/Tiny-v1", override(EnvConfig(), fixed), str(run), 0)


def test_a_model_plays_a_task_in_time_steps_like_any_team(task, run):
    assert is_model(str(run)) and is_model(str(run / "model.zip"))
    assert not is_model("random") and not is_model("mine.py:Mine")
    first = play(entry(run, task.robots))
    assert (first["steps"], len(first["coverage"])) == (60, 6)
    assert play(entry(run / "model.zip", task.robots)) == first, "a folder and its model are the same team"
    assert digest_of_team(entry(run, 2)) == digest_of_team(entry(run / "model.zip", 2)) != ""


def test_a_model_of_another_number_of_robots_is_refused_with_the_remedy(task, run):
    wanted = task.robots + 1
    with pytest.raises(
        DataError, match=f"trained for teams of {task.robots} robots, .* train it with --robots {wanted}"
    ):
        play(entry(run, wanted))
    with pytest.raises(DataError, match="trained for teams of"):
        digest_of_team(entry(run, wanted))  # before the first episode
