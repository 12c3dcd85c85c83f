"""Policies are found by name and give valid actions."""

import numpy as np
import pytest
from twc_env.agents.policy import make_policy
from twc_env.agents.roster import TEAMS

from twc_env import ConfigError, EnvConfig
from twc_env.records.messages import Belief, GridMap


def some_beliefs(step=0):
    grid = GridMap(np.full((40, 40), -4, np.int16), np.array([-2.0, -2.0]), 0.1)
    return {f"robot_{i}": Belief(i, step, np.zeros(3), grid, ranges_m=np.full(90, 10.0)) for i in range(2)}


def stuck_beliefs(step):
    """Robots that never reach a visible frontier, so that exploring policies draw random recovery motions."""
    beliefs = some_beliefs(step)
    for belief in beliefs.values():
        belief.grid.log_odds[:, 30:] = 0
    return beliefs


DRAW_NOTHING_WHERE_STUCK = ("radio-walk", "wall-follower", "information-gain")
OF_BELIEFS = [name for name, team in TEAMS.items() if not team.is_oracle]


def test_the_error_of_a_misspelt_policy_suggests_the_nearest_name():
    with pytest.raises(ConfigError, match="did you mean 'nearest-frontier'"):
        make_policy("nearest-frontir")


@pytest.mark.parametrize("name", OF_BELIEFS)
def test_actions_are_float32_pairs_within_their_bounds(name):
    policy = make_policy(name, EnvConfig(robots=2))
    policy.reset(0, ("robot_0", "robot_1"))
    for step in range(30):
        actions = policy.act(some_beliefs(step))
        assert set(actions) == {"robot_0", "robot_1"}
        for action in actions.values():
            assert action.shape == (2,)
            assert action.dtype == np.float32
            assert np.abs(action).max() <= 1.0


@pytest.mark.parametrize("name", OF_BELIEFS)
def test_the_same_seed_gives_the_same_actions(name):
    def first_actions(seed):
        policy = make_policy(name, EnvConfig(robots=2))
        policy.reset(seed, ("robot_0", "robot_1"))
        return np.array([list(policy.act(stuck_beliefs(step)).values()) for step in range(60)])

    assert np.array_equal(first_actions(5), first_actions(5))
    if name not in DRAW_NOTHING_WHERE_STUCK:
        assert not np.array_equal(first_actions(5), first_actions(6))


def test_the_random_walk_is_smooth_and_seeded():
    def walk(seed):
        policy = make_policy("random")
        policy.reset(seed, ("robot_0", "robot_1"))
        return np.array([policy.act(some_beliefs())["robot_0"] for _ in range(400)])

    velocities = walk(1)
    assert not np.array_equal(velocities, walk(2))
    assert velocities.std(axis=0).min() > 0.2
    assert np.abs(np.diff(velocities, axis=0)).mean() < 0.3 * velocities.std(axis=0).min() * np.sqrt(2)


def test_the_random_walk_never_finishes():
    policy = make_policy("random")
    policy.reset(0, ("robot_0", "robot_1"))
    assert not policy.finished(some_beliefs())
