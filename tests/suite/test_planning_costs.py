"""The cost of scripted teams."""

from twc_env.config import override
from twc_env.suite.planning_costs import bench_teams
from twc_env.tasks import task_config


def test_planning_and_environment_of_each_team_are_measured_apart(monkeypatch):
    clock = iter(range(10_000))
    monkeypatch.setattr("twc_env.suite.planning_costs.time.process_time", lambda: float(next(clock)))
    config = override(task_config("twc/ExploreQuick-v1"), {"max_cycles": 10})
    lines: list[str] = []
    random, wall = bench_teams(config, ["random", "wall-follower"], 2, lines.append)
    assert (random["team"], wall["team"]) == ("random", "wall-follower") and len(lines) == 2
    assert random["steps"] == 10.0
    assert random["planning_s"] == 10.0  # one tick of the clock from before each decision until after it
    assert random["environment_s"] == 11.0  # one from there to the next, and to the end
