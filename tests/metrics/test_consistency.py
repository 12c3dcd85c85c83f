import numpy as np
import pytest

import agents
from twc_env.config import EnvConfig, override
from twc_env.exploration.environment import ExplorationEnv
from twc_env.metrics.consistency import errors_since_closure


def test_errors_are_in_the_axes_of_the_map_and_start_at_the_last_closure():
    true = np.zeros((5, 1, 3))
    true[:, 0, 0] = [0, 1, 2, 3, 4]
    believed = true.copy()
    believed[:, 0, :2] = np.stack([np.full(5, 7.0), true[:, 0, 0]], axis=1)  # the map is turned by 90 degrees
    believed[:, 0, 2] = np.pi / 2
    believed[1, 0, 0] -= 0.1
    believed[4, 0, 1:] += 0.2, -0.3
    since_m = np.array([0.0, 1.0, 0.0, 1.0, 2.0])[:, None]
    std = np.arange(15.0).reshape(5, 1, 3)
    errors, stds = errors_since_closure(believed, true, std, since_m, np.zeros((5, 1), int))
    assert errors == pytest.approx(np.array([[-0.1, 0.0, 0.0], [0.0, 0.0, 0.0], [0.0, 0.2, -0.3]]))
    assert np.array_equal(stds, std[[1, 3, 4], 0])


def test_a_motion_ends_where_the_map_jumps():
    poses, since_m = np.zeros((3, 1, 3)), np.array([[0.0], [1.0], [2.0]])
    errors, _ = errors_since_closure(poses, poses, poses, since_m, np.array([[0], [0], [1]]))
    assert len(errors) == 1


@pytest.mark.parametrize(
    "changes",
    [{}, {"odometry.platform": "legged", "odometry.drift": 2.0}, {"map": "train/0003", "slam.cues.lidar": False}],
)
def test_reported_standard_deviations_match_errors_within_a_factor_of_two(changes):
    env = ExplorationEnv(config=override(EnvConfig(), {"map": "train/0017", "max_cycles": 600, **changes}))
    env.reset(seed=3)
    policy = agents.make_policy("nearest-frontier", env.config)
    policy.reset(3, env.possible_agents)
    told = []
    while env.agents:
        beliefs = {agent: env.belief(agent) for agent in env.agents}
        true_poses = env.episode.world.poses.copy()
        env.step(policy.act(beliefs))
        of_all = list(beliefs.values())
        told.append(
            (
                [belief.pose_map_robot for belief in of_all],
                true_poses,
                [belief.pose_std for belief in of_all],
                [belief.since_closure_m for belief in of_all],
                [belief.map_version for belief in of_all],
            )
        )
    errors, stds = errors_since_closure(*(np.array(part) for part in zip(*told, strict=True)))
    assert len(errors) > 500
    position = np.square(errors[:, :2]).mean() / np.square(stds[:, :2]).mean()
    assert 1 / 4 < position < 4
