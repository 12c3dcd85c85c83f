"""When the oracle follows its tours, and when it does as information-gain."""

from dataclasses import replace

import numpy as np
import pytest
from twc_env.agents.policy import begin, make_policy

import twc_env


def _actions(name: str, doors: float, steps: int = 12) -> np.ndarray:
    """(steps, robots, 2) in a small office of which this share of the doors opens and closes."""
    config = {"clutter.door_share": doors}
    env = twc_env.parallel_env(map="gen:office:150:3", robots=2, max_cycles=steps, config=config)
    env.reset(seed=2)
    policy, found = make_policy(name, env.config), []
    begin(policy, name, env, 2)
    while env.agents:
        actions = policy.act({agent: env.belief(agent) for agent in env.agents})
        found.append([actions[agent] for agent in env.agents])
        env.step(actions)
    return np.array(found)


@pytest.mark.parametrize(("doors", "is_alike"), [(0.8, True), (0.5, False)])
def test_the_oracle_follows_tours_but_where_most_doors_open_and_close(doors, is_alike):
    assert np.array_equal(_actions("informed", doors), _actions("information-gain", doors)) == is_alike


def _begun(agent: str, **more):
    env = twc_env.parallel_env(map="gen:office:150:3", robots=2, max_cycles=100, **more)
    env.reset(seed=2)
    policy = make_policy(agent, env.config)
    begin(policy, agent, env, 2)
    return policy, {agent: env.belief(agent) for agent in env.agents}


def test_signs_that_are_in_no_map_any_more_are_not_read():
    """As those that a robot read before it was carried away."""
    policy, beliefs = _begun("informed")
    policy.act(beliefs)
    policy._state.read[:] = 1
    bare = {agent: replace(belief, signs=()) for agent, belief in beliefs.items()}
    policy._plan_tours(policy._route, bare, policy._poses(), 0)
    assert not policy._state.read.any()


def test_what_is_random_after_the_tours_still_follows_from_the_seed():
    drawn = []
    for seed in (2, 3):
        policy, beliefs = _begun("informed")
        policy.reset(seed, list(beliefs))
        policy._looks[:] = 1000  # there is nothing left to see
        policy._state.is_merged[:] = True
        known = {agent: replace(belief, grid=policy._grid, pose_map_robot=pose) for (agent, belief), pose in
                 zip(beliefs.items(), policy._poses(), strict=True)}  # fmt: skip
        policy._plan_tours(policy._route, known, policy._poses(), 50)
        assert policy._route is None
        drawn.append(policy.random.random())
    assert drawn[0] != drawn[1]
