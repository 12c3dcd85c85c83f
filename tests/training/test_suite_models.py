"""Trained models as teams of a benchmark."""

import json

import pytest

from twc_env import tasks
from twc_env.__main__ import main
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


def test_models_are_evaluated_beside_scripted_teams_each_in_a_row_the_shipped_one_among_them(
    run, tmp_path, monkeypatch, capsys
):
    tiny = {"map": "gen:office:120:train", "robots": 2, "max_cycles": 20, "lidar.beam_count": 60}
    monkeypatch.setitem(tasks.TASKS, "twc/Tiny-v1", tiny)
    monkeypatch.setitem(tasks.SUITES, "v1", ("twc/Tiny-v1",))
    asked = ["evaluate", "--suite", "v1", "--tasks", "Tiny-v1", "--buildings", "1", "--agents", "minpos"]
    asked += ["--model", "learned", str(run), "--out", str(tmp_path), "--json", str(tmp_path / "rows.json")]
    assert main(asked) == 0
    rows = json.loads((tmp_path / "rows.json").read_text())
    assert [(row["model"], row["best_scripted"]) for row in rows] == [("learned", "minpos"), (str(run), "minpos")]
    for row in rows:
        assert set(row["mean_coverage"]) == {"model", "minpos", "random", "informed"}
    (line,) = (line for line in capsys.readouterr().out.splitlines() if "mean coverage:" in line)
    for name in ("learned", str(run), "minpos", "random", "informed"):
        assert f" {name} 0." in line


def test_shipped_policies_are_evaluated_in_the_tasks_that_they_are_shipped_for(monkeypatch, tmp_path):
    planned = []
    monkeypatch.setattr("twc_env.suite.runs.play_all", lambda entries, *_: planned.extend(entries) or 1 / 0)
    with pytest.raises(ZeroDivisionError):
        main(["evaluate", "--suite", "v1", "--model", "learned", "--buildings", "1", "--out", str(tmp_path)])
    assert {entry.task for entry in planned} == {"twc/ExploreQuick-v1", "twc/ExplorePeers-v1"}
    assert "learned" in {entry.team for entry in planned}
