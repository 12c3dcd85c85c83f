"""Benchmarks of suites: what is played, kept and continued."""

import json

import numpy as np
import pytest

from twc_env.__main__ import main
from twc_env.config import EnvConfig
from twc_env.errors import ConfigError
from twc_env.exploration.observation.map_view import MapViews
from twc_env.suite import player, runs
from twc_env.suite.entries import Entry, entries, suite_tasks, with_references
from twc_env.suite.player import play
from twc_env.suite.runs import Progress

FILES = ("json", "csv", "md", "tex", "html")


def command(folder, *more: str) -> list[str]:
    return ["benchmark", "--suite", "v1", "--buildings", "2", "--out", str(folder), *more]


def board(folder) -> str:
    return (folder / "leaderboard.json").read_text()


def test_two_processes_and_an_interrupted_benchmark_give_the_same_leaderboard(tiny, tmp_path, monkeypatch, capsys):
    agents = ["--agents", "nearest-frontier", "voronoi"]
    whole, parallel, broken = (tmp_path / name for name in ("whole", "parallel", "broken"))
    assert main(command(whole, *agents, "--json", str(whole / "rows.json"))) == 0
    assert main(command(parallel, *agents, "--jobs", "2")) == 0
    real, calls = runs.play, []

    def impatient(entry):
        calls.append(entry)
        if len(calls) == 6:
            raise KeyboardInterrupt
        return real(entry)

    monkeypatch.setattr(runs, "play", impatient)
    assert main(command(broken, *agents)) == 130
    assert "the same command continues" in capsys.readouterr().err
    assert not (broken / "leaderboard.json").exists()
    assert main(command(broken, *agents)) == 0
    assert "5 of 16 episodes are finished already" in capsys.readouterr().err
    assert len(calls) == 6 + 11, "what was finished is not played again"
    assert board(whole) == board(parallel) == board(broken)
    for ending in FILES:
        assert (whole / f"leaderboard.{ending}").stat().st_size > 0
    rows = json.loads((whole / "rows.json").read_text())
    assert {(row["task"], row["team"]) for row in rows} == {
        (task, team) for task in ("all", *tiny) for team in ("nearest-frontier", "voronoi", "random", "informed")
    }
    wanted = {"task", "team", "score", "low", "high", "wrong_merges", "merged_s", "ate_m", "coverage_mean"}
    assert all(wanted | {"score_is"} == set(row) for row in rows)


def test_an_episode_is_the_same_wherever_it_is_played_and_its_curve_ends_with_it(tiny):
    entry = entries(tiny, ["random"], "validation", 1)[1]
    first = play(entry)
    assert play(entry) == json.loads(json.dumps(first)) == first
    assert entry.config.map == "gen:office+ring:150:validation/0000"
    assert len(first["coverage"]) == first["steps"] // 10
    assert first["is_covered"] == (first["coverage"][-1] >= 0.3)


def test_entries_are_all_teams_in_the_same_buildings_building_by_building(tiny):
    planned = entries(tiny, ["a", "b"], "test", 2)
    assert [(e.number, e.task, e.team) for e in planned] == [
        (number, task, team) for number in (0, 1) for task in tiny for team in ("a", "b")
    ]
    assert {e.config.map for e in planned if e.task == tiny[0]} == {
        "gen:office:120:test/0000", "gen:office:120:test/0001"
    }  # fmt: skip
    with pytest.raises(ConfigError, match="the split test has 100 buildings; got 101"):
        entries(tiny, ["a"], "test", 101)


def test_tasks_are_chosen_by_their_whole_or_short_names(tiny):
    assert suite_tasks("v1", None) == tiny
    assert suite_tasks("v1", ["TinyTwo-v1", "twc/TinyTwo-v1"]) == (tiny[1],)
    with pytest.raises(ConfigError, match=r"v1 has no task 'TinyTwo'; did you mean 'TinyTwo-v1'"):
        suite_tasks("v1", ["TinyTwo"])


def test_references_are_played_with_every_team():
    assert with_references(["mine", "mine"], ["random", "informed", "voronoi"]) == ("mine", "random", "informed")
    assert with_references(["random", "mine"], ["random"]) == ("random", "mine")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ("--suite v1 --maps twin-01", "--maps twin-01: a suite has fixed settings: leave it out"),
        ("--suite v1 --set robots=3", "--set robots=3: a suite has fixed settings"),
        ("--tasks ExploreOffice-v1", "--tasks ExploreOffice-v1: it needs --suite v1"),
        ("--buildings 3", "--buildings 3: it needs --suite v1"),
        ("--suite v1 --ray auto --jobs 2", "--jobs 2: a Ray cluster uses all of its cores"),
        ("--suite v1 --tasks ExploreOfice-v1", "did you mean 'ExploreOffice-v1'"),
        ("--suite v1 --agents voronoy", "unknown agent 'voronoy'"),
        ("--suite v1 --agents none.zip", "cannot read the model none.zip: No such file or directory"),
    ],
)
def test_options_that_exclude_each_other_are_refused_before_any_episode(arguments, message, tmp_path, refusal):
    said = refusal(main, ["benchmark", *arguments.split(), "--out", str(tmp_path / "out")])
    assert message in said
    assert not list(tmp_path.glob("**/*.json"))


def test_progress_has_a_bar_and_the_time_left_by_the_weight_of_the_episodes():
    short, long = (Entry("twc/A-v1", EnvConfig(robots=1, max_cycles=steps), "random", 0) for steps in (100, 300))
    now = [0.0]
    progress = Progress([short, short, long, long], [1, 2, 3], lambda: now[0])
    now[0] = 10.0
    progress.note(short)
    assert progress.line == "[############------------] 2/4 episodes, 60 s left"
    now[0] = 400.0
    progress.note(long)
    assert progress.line == "[##################------] 3/4 episodes, 5 min left"
    progress.note(long)
    assert progress.line.endswith("4/4 episodes, 0 s left")


def test_a_first_episode_that_waited_for_kernels_tells_no_time_left():
    entry, now = Entry("twc/A-v1", EnvConfig(robots=1, max_cycles=100), "random", 0), [0.0]
    progress = Progress([entry] * 40, range(40), lambda: now[0])
    now[0] = 60.0
    progress.note(entry)
    assert progress.line == "[------------------------] 1/40 episodes"
    now[0] = 62.0
    progress.note(entry)
    assert progress.line.endswith("2/40 episodes, 76 s left")


def test_a_worker_with_other_code_is_refused(tiny, tmp_path, monkeypatch):
    monkeypatch.setattr(runs, "spread_out", lambda work, parts, jobs, ray: [(0, ("abcd0123", {}))])
    with pytest.raises(Exception, match=r"a worker has other code \(abcd0123\)"):
        runs.play_all(entries(tiny, ["random"], "test", 1), tmp_path)


def test_scripted_teams_play_the_same_with_and_without_observations(tiny, monkeypatch):
    entry = entries(tiny, ["minpos"], "validation", 1)[1]
    unseen = play(entry)
    built = []
    monkeypatch.setattr(MapViews, "draw", lambda *given: built.append(given) or np.zeros((2, 7, 64, 64), np.uint8))
    play(entry)
    assert not built, "no map is drawn that nobody sees"
    monkeypatch.undo()
    monkeypatch.setattr(player, "UNSEEN", {})
    assert play(Entry(entry.task, entry.config, entry.team, entry.number)) == unseen
