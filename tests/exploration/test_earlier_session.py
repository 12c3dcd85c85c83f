import numpy as np
import pytest

from twc_env.datasets.lasting_maps import prior_of
from twc_env.errors import ConfigError, DataError
from twc_env.exploration import earlier_session
from twc_env.exploration.environment import ExplorationEnv

SETTINGS = {"map": "gen:office:300:7", "robots": 2, "max_cycles": 150, "slam.prior": "earlier-session:600"}


def begun(seed=0, **settings):
    env = ExplorationEnv(config={**SETTINGS, **settings})
    env.reset(seed=seed)
    return env


def prior_of_team(env):
    return env.engine.team._lasting


@pytest.fixture(scope="module")
def env():
    return begun()


def test_every_episode_in_a_building_begins_with_the_same_map_made_anew_or_not(env):
    known = prior_of_team(env)
    assert prior_of_team(begun(seed=5)) is known, "made once"
    earlier_session._explored.cache_clear()
    again = prior_of_team(begun(seed=5, robots=3))
    assert again is not known
    for name in ("poses", "scans_m"):
        assert np.array_equal(getattr(again, name), getattr(known, name))
    assert np.array_equal(again.grid.log_odds, known.grid.log_odds)


def test_what_a_team_decides_and_sees_changes_nothing_of_an_earlier_session(env):
    """Learners' robots choose views and would have mapped half as much again."""
    choices = {"action.kind": "frontier", "action.goals": "views", "action.timing": "in-turn", "action.reverses": True}
    seen = {"observation.gains": True, "observation.frontier_period_s": 60.0, "episode.ends_at_coverage": 0.9}
    assert prior_of_team(begun(**choices, **seen, **{"action.decision_max_s": 0.5})) is prior_of_team(begun())


def test_another_building_and_another_scanner_have_maps_of_their_own(env):
    known = prior_of_team(env)
    assert len(prior_of_team(begun(map="gen:office:300:8")).poses) > 0
    other = prior_of_team(begun(**{"lidar.beam_count": 90}))
    assert other.scans_m.shape[1] == 90 != known.scans_m.shape[1]


def test_robots_that_explore_on_find_the_map_of_the_earlier_session():
    env = begun(seed=1, **{"action.kind": "frontier", "max_cycles": 400})
    before = float((prior_of_team(env).grid.log_odds < 0).sum())
    while env.agents:
        env.step(dict.fromkeys(env.agents, 0))
    assert env.engine.found_prior(0) and env.engine.found_prior(1)
    assert float((env.engine.belief(0).grid.log_odds < 0).sum()) > before
    result = env.result()
    assert result["wrong_merges"] == 0
    assert result["found_prior"] == [0, 1] and result["prior_closures"] >= 2
    told = [" ".join(line.split()) for line in str(result).splitlines()]
    assert f"saved map found by robots 0, 1, by {result['prior_closures']} more loop closures" in told
    assert f"floor mapped correctly {result['coverage_correct']:.1%}, with what the saved map held" in told


def test_a_report_says_that_the_map_of_the_earlier_session_was_not_found(env):
    told = [" ".join(line.split()) for line in str(env.result()).splitlines()]
    assert "saved map not found" in told
    assert f"floor mapped correctly {env.result()['coverage_correct']:.1%}" in told


@pytest.mark.parametrize("steps", ["", "0", "-3", "many", "1e3", "2000000", "²"])
def test_an_earlier_session_of_no_number_of_steps_is_refused(steps):
    with pytest.raises(ConfigError, match="earlier-session:STEPS needs 1 to 1000000"):
        begun(**{"slam.prior": f"earlier-session:{steps}"})


def test_a_log_has_no_earlier_session(env):
    with pytest.raises(DataError, match="a map that an environment makes; name a file by --prior"):
        prior_of(env.config)
