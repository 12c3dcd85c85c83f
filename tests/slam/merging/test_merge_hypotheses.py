"""What pending closures between two maps imply, before they are merged."""

import numpy as np
import pytest
from twc_env.agents.policy import make_policy

import twc_env
from twc_env.records.geometry import between, compose

SETTINGS = {"lidar.range_max_m": 5.0}


@pytest.fixture(scope="module")
def told():
    """Beliefs with hypotheses about unmerged groups, with the true poses of all robots at that time."""
    env = twc_env.parallel_env(map="gen:office:400:3", robots=3, max_cycles=400, config=SETTINGS)
    env.reset(seed=4)
    policy, found = make_policy("nearest-frontier", env.config), []
    policy.reset(4, env.possible_agents)
    while env.agents:
        beliefs = {agent: env.belief(agent) for agent in env.agents}
        poses = env.state().reshape(-1, 6)[:, :3].astype(float)
        found += [(belief, poses) for belief in beliefs.values() if belief.hypotheses]
        env.step(policy.act(beliefs))
    assert found, "no closure was ever pending"
    return found


def test_a_hypothesis_is_about_robots_of_another_map(told):
    for belief, _ in told:
        for hypothesis in belief.hypotheses:
            assert not set(hypothesis.robots) & {belief.robot, *belief.teammates}
            assert set(hypothesis.teammates) == set(hypothesis.robots)
            assert hypothesis.support >= 1


def test_most_hypotheses_place_the_other_robot_where_it_is(told):
    errors_m = []
    for belief, poses in told:
        for hypothesis in belief.hypotheses:
            for robot, pose in hypothesis.teammates.items():
                implied = between(belief.pose_map_robot, pose)
                errors_m.append(np.hypot(*(implied - between(poses[belief.robot], poses[robot]))[:2]))
    assert np.median(errors_m) < 1.5  # the other robot has moved on since its newest keyframe


def test_two_robots_hold_opposite_hypotheses_of_each_other(told):
    by_step = {}
    for belief, _ in told:
        for hypothesis in belief.hypotheses:
            if len(belief.teammates) == 0 and len(hypothesis.robots) == 1:
                by_step.setdefault((belief.step, frozenset((belief.robot, *hypothesis.robots))), []).append(hypothesis)
    pairs = [pair for pair in by_step.values() if len(pair) == 2 and pair[0].support == pair[1].support]
    assert pairs
    for mine, theirs in pairs:
        both = compose(mine.pose_map_other, theirs.pose_map_other)
        assert np.allclose(both, 0.0, atol=1e-6)
