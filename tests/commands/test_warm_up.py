"""`twc-env warm-up`."""

import subprocess
import sys
from unittest.mock import Mock

import pytest

from twc_env.__main__ import main
from twc_env.commands import warm_up
from twc_env.exploration import warm_up as episode
from twc_env.exploration.environment import ExplorationEnv
from twc_env.kernels import cache_folder


@pytest.mark.parametrize("count, expected", [(12, "12 functions compiled"), (0, "nothing to compile")])
@pytest.mark.parametrize("kept", [True, False])
def test_it_says_what_was_compiled_and_where_it_is_kept(monkeypatch, capsys, count, expected, kept):
    monkeypatch.setattr(episode, "compile_all", lambda total: count)
    monkeypatch.setattr(warm_up, "compile_for_commands", lambda: 0)
    monkeypatch.setattr(cache_folder, "is_kept", lambda: kept)
    assert main(["warm-up"]) == 0
    said = capsys.readouterr().out
    assert expected in said
    assert (str(cache_folder.cache_folder()) if kept else "NUMBA_CACHE_DIR") in said


def test_it_runs_a_whole_episode(monkeypatch):
    monkeypatch.setattr(episode, "STEPS", 20)
    assert episode.compile_all() >= 0


def test_it_also_plays_a_scripted_team_and_choices_of_frontiers_draws_them_and_replays_the_sample(monkeypatch):
    played = []
    monkeypatch.setattr("twc_env.agents.explore.explore", lambda config, team, seed: played.append(team))
    render = ExplorationEnv.render
    monkeypatch.setattr(ExplorationEnv, "render", lambda env: played.append(env.config.action.kind) or render(env))
    monkeypatch.setattr(
        "twc_env.replaying.run.run", lambda source, config, note: played.append(config.robots) or Mock()
    )
    assert warm_up.compile_for_commands(steps=20) >= 0
    teams = ["nearest-frontier", "informed", "informed", "voronoi", "random", "segments", "rrt", "nearest-frontier"]
    assert played == [*teams, "frontier", 2]


LOADED = """
import gc
from itertools import cycle
from numba.core.registry import CPUDispatcher
from twc_env.agents.roster import TEAMS
from twc_env.agents.explore import explore
from twc_env.commands import warm_up
from twc_env.config import EnvConfig, override
from twc_env.tasks import SUITES, task_config
def kernels():
    found = [each for each in gc.get_objects() if isinstance(each, CPUDispatcher)]
    return {f"{each.py_func.__module__}.{each.__name__} {kinds}" for each in found for kinds in each.overloads}
warm_up._run(None)
before = kernels()
for team, own in (
    ("rendezvous", {"world": "office", "robots": 3}),
    ("nearest-frontier", {"world": "warehouse", "lidar.preset": "lms-200"}),
    ("voronoi", {"map": "twin-01", "lidar.preset": "lds-01", "team": ["handheld", "wheeled"]}),
    ("minpos", {"slam.cues.lidar": False, "failure.kidnap_step": 50}),
):
    explore(override(EnvConfig(), {"map": "gen:office:200:7", "robots": 2, "max_cycles": 100, **own}), team, 2)
for task, team in [*zip(cycle(SUITES["v1"]), TEAMS), ("twc/ExploreWard-v1", "information-gain")]:
    explore(override(task_config(task), {"max_cycles": 100}), team, 1)
print(*sorted(name for name in kernels() - before if name.startswith("twc_env.")), sep="\\n")
"""


@pytest.mark.slow
def test_after_it_other_worlds_scanners_and_teams_and_the_suite_use_no_other_kernels():
    done = subprocess.run([sys.executable, "-c", LOADED], capture_output=True, text=True, check=True)
    assert done.stdout.split("\n", 1)[1] == "\n"
