"""What a mapper was sent of the access points that robots of other maps hear."""

import numpy as np
import pytest
from twc_env.agents.policy import make_policy

import twc_env


def played(steps, **config):
    """The environment and all beliefs of an episode, with the beliefs of each step."""
    env = twc_env.parallel_env(map="gen:office:300:3", robots=2, max_cycles=steps, config=config)
    env.reset(seed=4)
    policy, told = make_policy("nearest-frontier", env.config), []
    policy.reset(4, env.possible_agents)
    while env.agents:
        beliefs = {agent: env.belief(agent) for agent in env.agents}
        told.append(list(beliefs.values()))
        env.step(policy.act(beliefs))
    return env, told


@pytest.fixture(scope="module")
def central():
    return played(400)


def test_trails_are_of_the_own_group_first_and_then_of_the_others(central):
    _, told = central
    apart = [belief for beliefs in told for belief in beliefs if belief.radio_trails]
    assert apart
    for belief in apart:
        own, *others = belief.radio_trails
        assert set(own.robots) == {belief.robot, *belief.teammates}
        assert not set(own.robots) & {robot for other in others for robot in other.robots}
        assert all(len(each.places_m) == len(each.fingerprints) for each in belief.radio_trails)
    assert any(len(belief.radio_trails) == 2 for belief in apart)


def test_the_own_trail_ends_near_the_robot(central):
    for beliefs in central[1]:
        for belief in beliefs:
            if belief.radio_trails and len(belief.radio_trails[0].places_m):
                away_m = belief.radio_trails[0].places_m[-1] - belief.pose_map_robot[:2]
                assert np.hypot(*away_m) < 1.5


def test_robots_with_one_map_have_no_trails(central):
    merged = [belief for beliefs in central[1] for belief in beliefs if belief.teammates]
    assert merged
    assert all(belief.radio_trails == () for belief in merged)


def test_peers_out_of_range_know_their_own_trail_only():
    _, told = played(60, **{"link.topology": "peer", "link.range_max_m": 0.1})
    assert all(len(belief.radio_trails) == 1 for beliefs in told for belief in beliefs)
