"""When the oracle follows its tours, and when it does as information-gain."""

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
