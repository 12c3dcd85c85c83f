"""The environment without an engine (`slam.mode = "off"`): spaces, evaluation, no ground truth in observations."""

import json

import numpy as np
import pytest
from pettingzoo.test import api_test, parallel_api_test, parallel_seed_test

import twc_env
from twc_env.errors import ConfigError
from twc_env.metrics import absolute_trajectory_error_m
from twc_env.records.geometry import compose
from twc_env.slam.dead_reckoning import DeadReckoning
from twc_env.slam.modes import make_engine

OFF = {"slam.mode": "off"}
STEPS = 120


@pytest.fixture(scope="module")
def log(explore):
    return explore(STEPS, max_cycles=STEPS, config={**OFF, "reward.collision": -0.5})


def test_pettingzoo_accepts_the_environment_without_an_engine():
    parallel_api_test(twc_env.parallel_env(config=OFF, max_cycles=40), num_cycles=100)
    parallel_seed_test(lambda: twc_env.parallel_env(config=OFF, max_cycles=30), num_cycles=30)


@pytest.mark.filterwarnings(  # the observation is a Dict, which PettingZoo allows
    "ignore:Observation is not a NumPy array", "ignore:Observation space for each agent probably should be"
)
def test_pettingzoo_accepts_it_turn_by_turn():
    api_test(twc_env.env(config=OFF, max_cycles=40), num_cycles=60)


def test_the_spaces_are_those_of_the_environment_with_an_engine(log):
    assert log.env.observation_space("robot_0") == twc_env.parallel_env().observation_space("robot_0")
    for observations in log.observations:
        for agent, observation in observations.items():
            assert log.env.observation_space(agent).contains(observation)


def test_the_pose_is_the_integrated_odometry(wander):
    env = twc_env.parallel_env(robots=2, config=OFF, max_cycles=40)
    observations, _ = env.reset(seed=0)
    summed = [np.zeros(3), np.zeros(3)]
    for step in range(40):
        observations = env.step({a: wander(o["lidar"] * 10, step) for a, o in observations.items()})[0]
        for robot, frame in enumerate(env.frames):
            summed[robot] = compose(summed[robot], frame.odometry)
            x, y, heading = summed[robot]
            seen = observations[f"robot_{robot}"]["pose"]
            assert seen[:4] == pytest.approx([x, y, np.cos(heading), np.sin(heading)], abs=1e-5)
            assert env.belief(f"robot_{robot}").pose_map_robot == pytest.approx(summed[robot])
    assert np.abs(summed).max() > 0.5
    true = env.state().reshape(2, 6)[:, :2]
    assert np.abs(true - [pose[:2] for pose in summed]).max() > 0.5, "the frame of the building has leaked"


def test_map_and_team_blocks_stay_empty(log):
    for observations in log.observations:
        for observation in observations.values():
            assert not observation["map"][[0, 1, 3, 5, 6]].any() and not observation["team"][:, :4].any()
    belief = log.env.belief("robot_0")
    assert belief.grid.log_odds.size == 0 and belief.teammates == {} and belief.signs == ()


def test_the_other_blocks_contain_measurements(log):
    for key in ("lidar", "wifi", "signs"):
        assert any(o[key].any() for observations in log.observations for o in observations.values()), key


def test_rewards_and_result_evaluate_dead_reckoning(log):
    result = log.env.result()
    figures = result.figures
    json.dumps(figures, allow_nan=False)
    assert figures["coverage_correct"] == figures["wall_iou"] == figures["bytes_sent"] == 0
    assert figures["merged_robots"] == 1 and figures["closures"]["proposed"] == 0
    assert figures["per_robot_ate_m"] == pytest.approx(
        [absolute_trajectory_error_m(result.odometry_poses[:, r], result.true_poses[:, r]) for r in range(3)]
    )
    for rewards, infos in zip(log.rewards, log.infos[1:], strict=True):
        for agent, reward in rewards.items():
            assert infos[agent]["reward_terms"]["coverage"] == 0.0
            assert reward == -0.5 * infos[agent]["reward_terms"]["collision"]


def test_the_world_is_the_same_with_and_without_an_engine():
    envs = [twc_env.parallel_env(config={"slam.mode": mode}, max_cycles=25) for mode in ("cooperative", "off")]
    for env in envs:
        env.reset(seed=4)
    while envs[0].agents:
        actions = dict.fromkeys(envs[0].agents, np.array([0.8, 0.3], np.float32))
        first, second = (env.step(actions)[0] for env in envs)
        for agent in first:
            for key in ("lidar", "wifi"):
                assert np.array_equal(first[agent][key], second[agent][key])
    assert isinstance(envs[1].engine, DeadReckoning)


def test_a_picture_shows_the_robots_without_a_map():
    env = twc_env.parallel_env(robots=2, config=OFF, render_mode="rgb_array")
    env.reset(seed=0)
    assert env.render().std() > 0


def test_dead_reckoning_can_replay_recorded_frames(log):
    engine = make_engine(log.env.config, 3)
    engine.update(log.env.frames)
    assert engine.belief(1).step == STEPS
    assert engine.pose_map_robot(1) == pytest.approx(log.env.frames[1].odometry)


@pytest.mark.parametrize("kind", ["frontier", "waypoint"])
def test_actions_planned_on_a_map_are_rejected_without_an_engine(kind):
    with pytest.raises(ConfigError, match="'velocity'"):
        twc_env.parallel_env(config={**OFF, "action.kind": kind})


def test_localisation_and_pictures_lay_dead_reckoning_at_the_true_start(wander):
    """Perfect odometry is 1 all along; drifting odometry loses the position error of dead reckoning."""
    for drift in (0.0, 3.0):
        config = {**OFF, "odometry.drift": drift, "reward.coverage": 0.0, "reward.localisation": 1.0}
        env = twc_env.parallel_env(robots=2, config=config, max_cycles=60)
        observations, _ = env.reset(seed=3)
        paid = 0.0
        while env.agents:
            actions = {a: wander(o["lidar"] * 10, env.episode.steps) for a, o in observations.items()}
            observations, rewards, *_ = env.step(actions)
            paid += rewards["robot_0"]
        result = env.result()
        error_m = np.hypot(*(result.odometry_poses - result.true_poses)[-1, :, :2].T)
        assert paid == pytest.approx(1.0 - error_m.mean(), abs=1e-6)
        assert (error_m.max() > 0.01) == (drift > 0.0)
        laid = [compose(pose, env.engine.pose_map_robot(r)) for r, pose in enumerate(result.pose_building_map)]
        assert np.array(laid)[:, :2] == pytest.approx(result.odometry_poses[-1, :, :2])
