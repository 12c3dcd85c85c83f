"""Paired comparison of teams, with reuse of finished episodes."""

import csv
import json

import pytest
from twc_env.agents import compare
from twc_env.agents.compare import Outcome

from twc_env.__main__ import main
from twc_env.config import EnvConfig, override
from twc_env.exploration.assessment import map_scores
from twc_env.exploration.assessment.rewards import Standing

SMALL = override(EnvConfig(), {"max_cycles": 60, "robots": 2, "lidar.beam_count": 60})


def outcome(goal_s: float, coverage_mean: float = 0.5) -> Outcome:
    return Outcome(goal_s, True, 0.95, 0.95, coverage_mean, 100.0, 0.02, 2, 0)


def test_pairs_are_resumed_and_compared_with_the_first_agent(tmp_path, monkeypatch):
    calls = []

    def run(config, agent, seed):
        calls.append((config.map, agent, seed))
        return outcome(50.0, 0.6) if agent == "voronoi" else outcome(60.0 + seed)

    monkeypatch.setattr(compare, "explore", run)
    maps, agents = ["test/0000", "test/0001"], ["nearest-frontier", "voronoi"]
    first, second = compare.compare(SMALL, maps, agents, tmp_path)
    again = compare.compare(SMALL, maps, agents, tmp_path)
    assert calls == [(name, agent, seed) for seed, name in enumerate(maps) for agent in agents]
    assert first.sooner_s == (0.0, 0.0, 0.0)
    mean, low, high = second.sooner_s
    assert (mean, again[1].sooner_s[0]) == (10.5, 10.5)
    assert (low, high) == pytest.approx((10.5 - 0.5 * 12.706, 10.5 + 0.5 * 12.706), abs=1e-3)  # Student's t of two
    assert second.more == pytest.approx((0.1, 0.1, 0.1))
    assert "10.5 (4.1 to 16.9)" in compare.table_of(again)


def test_every_building_is_played_with_every_seed_that_is_asked_for(tmp_path, monkeypatch, capsys):
    calls = []
    monkeypatch.setattr(compare, "explore", lambda config, _, seed: calls.append((config.map, seed)) or outcome(50.0))
    asked = ["compare", "--agents", "voronoi", "--no-pictures", "--out", str(tmp_path / "out")]
    maps = ["--maps", "twin-01", "twin-02"]
    assert main([*asked, *maps, "--seeds", "3-4"]) == 0
    assert calls == [("twin-01", 3), ("twin-01", 4), ("twin-02", 3), ("twin-02", 4)]
    assert "[3/4] twin-02, seed 3, voronoi: 90% 50 s" in capsys.readouterr().err
    written = csv.DictReader((tmp_path / "out" / "episodes.csv").read_text().splitlines())
    assert [(row["map"], int(row["seed"])) for row in written] == calls
    assert main([*asked, *maps]) == 0 and calls[4:] == [("twin-01", 0), ("twin-02", 1)]
    assert main([*asked, *maps, "twin-01", "--seeds", "0"]) == 2
    assert "--maps names twin-01 twice" in capsys.readouterr().err


def test_an_agent_that_is_named_twice_is_played_once(tmp_path, monkeypatch):
    monkeypatch.setattr(compare, "explore", lambda config, agent, seed: outcome(50.0))
    told = []
    found = compare.compare(EnvConfig(), ["twin-01"], ["random", "minpos", "random"], tmp_path, tell=told.append)
    assert [standing.agent for standing in found] == ["random", "minpos"] and len(told) == 2


def test_a_picture_of_an_earlier_comparison_is_not_left_beside_other_tables(tmp_path):
    standing = compare._standing("random", [outcome(50.0)], [outcome(50.0)])
    for name in ("coverage.png", "coverage.pdf", "coverage.txt"):
        (tmp_path / name).touch()
    compare.write_tables([standing], ["twin-01"], EnvConfig(), tmp_path, None)
    assert [path.name for path in tmp_path.glob("coverage.*")] == ["coverage.txt"]


def test_one_building_has_no_interval_and_a_goal_that_nobody_reached_no_time():
    def of(coverage_mean):
        return (Outcome(10.0, False, 0.6, 0.6, coverage_mean, 18.0, 0.005, 2, 0),)

    first, mine = compare._standing("random", of(0.4), of(0.4)), compare._standing("voronoi", of(0.3), of(0.4))
    titles, _, row = compare.rows_of([first, mine])
    cells = dict(zip(titles, row, strict=True))
    assert (cells["to 90 % s"], cells["IQM s"], cells["sooner s (95 %)"]) == ("-", "-", "-")
    assert cells["more mean cov. (95 %)"] == "-0.100"
    assert compare.rows_of([first, compare._standing("voronoi", (outcome(50.0),), of(0.4))])[2][-2] == "-40.0"


def test_the_table_of_means_is_numbers_in_columns_of_their_own(tmp_path):
    lost = Outcome(6.0, False, 0.25, 0.25, 0.125, 10.5, 0.05, 2, 1, 0.5)
    plain = [compare._standing(agent, (lost,) * 2, (lost,) * 2) for agent in ("random", "voronoi")]
    compare.write_tables(plain, ["test/0000", "test/0001"], SMALL, tmp_path, None)
    first, second = csv.DictReader((tmp_path / "compare.csv").read_text().splitlines())
    assert (first["agent"], second["agent"]) == ("random", "voronoi")
    parts = [f"{name}_{part}" for name in ("sooner_s", "more_coverage") for part in ("mean", "low", "high")]
    assert [first[key] for key in parts] == [""] * 6  # it is what the others are compared with
    assert [second[key] for key in parts] == ["", "", "", "0.0", "0.0", "0.0"]
    assert second["goal_s"] == second["goal_s_iqm"] == ""  # nobody reached it
    assert all(float(value) >= 0 for key, value in second.items() if key != "agent" and value)
    assert (second["reached_share"], second["stuck_share_max"], second["wrong_merges"]) == ("0.0", "0.5", "2")
    assert "90 \\% s" in (tmp_path / "compare.tex").read_text()


def test_episodes_of_other_code_are_run_again_and_reported(tmp_path, monkeypatch):
    calls, told = [], []
    monkeypatch.setattr(compare, "explore", lambda config, agent, seed: calls.append(agent) or outcome(50.0))
    compare.compare(SMALL, ["test/0000"], ["voronoi"], tmp_path)
    monkeypatch.setattr("twc_env.running.finished_parts.code_digest", lambda *_: "other")
    compare.compare(SMALL, ["test/0000"], ["voronoi"], tmp_path, tell=told.append)
    assert calls == ["voronoi", "voronoi"]
    assert "1 finished parts were computed by other code" in told[0]


def test_coverage_over_time_is_the_sum_of_rewards():
    found = compare.explore(SMALL, "nearest-frontier", 0)
    assert 0.0 < found.coverage_mean < found.coverage_end == pytest.approx(found.coverage)
    assert not found.is_reached
    assert found.goal_s == pytest.approx(6.0)
    assert found.curve[16] is None and found.curve[17] > 0.0  # rewards are evaluated every ten of its 60 steps


def test_after_a_wrong_merge_the_final_coverage_is_the_end_of_the_curve_whose_mean_stands_beside_it(monkeypatch):
    true_standing = map_scores.standing

    def merged_wrongly(engine, record, *more):
        is_late = len(record.true_poses) > 30
        return Standing.nothing(SMALL.robots) if is_late else true_standing(engine, record, *more)

    monkeypatch.setattr(map_scores, "standing", merged_wrongly)
    found = compare.explore(SMALL, "nearest-frontier", 0)
    assert found.curve[40] > 0.0 and found.coverage_mean > 0.0
    assert found.coverage > 0.0, "the report's figure is that of the largest map, merged rightly or not"
    assert found.coverage_end == found.curve[-1] == 0.0
    standings = [compare._standing("nearest-frontier", (found,), (found,))]
    titles, row = compare.rows_of(standings)
    cells = dict(zip(titles, row, strict=True))
    assert (cells["mean cov."], cells["final cov."]) == (f"{found.coverage_mean:.3f}", "0.000")
    assert compare.means_of(standings)[0]["final_coverage"] == 0.0
    assert compare._line(1, 1, ("twin-01", "nearest-frontier", 0), found).endswith("at the end 0.000")


def test_actions_other_than_velocity_are_rejected_before_the_first_episode(tmp_path, capsys):
    assert main(["compare", "--set", "action.kind=frontier", "--buildings", "1", "--out", str(tmp_path / "out")]) == 2
    assert "need action.kind = 'velocity'; got 'frontier'" in capsys.readouterr().err
    assert not list(tmp_path.glob("out/**/*.json"))


def test_coverage_does_not_depend_on_the_reward_weights():
    plain = compare.explore(SMALL, "random", 0)
    assert plain.coverage_mean > 0
    paid = override(SMALL, {"reward.coverage": 3.0, "reward.time": -5.0, "reward.sharing": "individual"})
    assert compare.explore(paid, "random", 0) == plain


def test_the_command_prints_and_writes_every_episode(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(compare, "explore", lambda config, agent, seed: outcome(50.0))
    json_file = tmp_path / "out.json"
    arguments = ["compare", "--buildings", "2", "--agents", "random", "voronoi", "--out", str(tmp_path / "done")]
    assert main([*arguments, "--json", str(json_file)]) == 0
    assert len(json.loads(json_file.read_text())["voronoi"]["episodes"]) == 2
    assert capsys.readouterr().out.count("\n") == 3
    assert main(["compare", "--agents", "voronoy", "--out", str(tmp_path / "done")]) == 2
    assert "did you mean 'voronoi'?" in capsys.readouterr().err
