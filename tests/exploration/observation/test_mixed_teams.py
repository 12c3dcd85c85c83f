"""Teams in which every robot has its own platform, size, speed, scanner, receiver and camera."""

import pickle

import numpy as np
import pytest
from pettingzoo.test import api_test, parallel_api_test

import twc_env
from twc_env.config import EnvConfig, override
from twc_env.datasets.logs.frame_log import read_frame_log, write_frame_log
from twc_env.errors import ConfigError
from twc_env.slam.engine import CooperativeSlam
from twc_env.vector import VectorTeams

MIXED = {
    "robot": [
        {"preset": "turtlebot-burger", "dynamics.speed_max_m_s": 0.5, "radio.scan_period_s": 0.7},
        {
            "preset": "handheld",
            "lidar.preset": "utm-30lx",
            "lidar.beam_count": 400,
            "lidar.range_max_m": 12.0,
            "signs.period_s": 0.8,
        },
        {"preset": "legged", "radio.device_offset_db": -6.0, "signs.range_max_m": 2.5},
    ],
    "max_cycles": 400,
}
BEAMS = [360, 400, 180]


def action(step: int, robot: int) -> np.ndarray:
    return np.array([0.7, np.sin(0.11 * step + 2 * robot)], np.float32)


def played(env, steps: int, seed: int = 1):
    """Observations and frames of an episode."""
    observations, _ = env.reset(seed=seed)
    log = [(observations, list(env.frames))]
    for step in range(steps):
        observations = env.step({a: action(step, int(a[-1])) for a in env.agents})[0]
        log.append((observations, list(env.frames)))
    return log


@pytest.fixture(scope="module")
def here():
    env = twc_env.parallel_env(config=MIXED)
    return env, played(env, 150)


def test_each_agent_has_a_space_of_its_own_scanner(here):
    env, log = here
    assert [env.observation_space(a)["lidar"].shape for a in env.possible_agents] == [(n,) for n in BEAMS]
    for observations, frames in log:
        assert all(env.observation_space(a).contains(o) for a, o in observations.items())
        assert all(len(frame.ranges_m) in (0, count) for frame, count in zip(frames, BEAMS, strict=True))
    shown = np.array([observations["robot_2"]["lidar"] for observations, _ in log])
    measured = np.array([frames[2].ranges_m for _, frames in log])
    assert np.array_equal(shown, (measured * (1.0 / 10.0)).astype(np.float32)), "by its own range"


def test_equal_shapes_are_filled_with_zero_and_change_nothing_else(here):
    _, log = here
    padded = twc_env.parallel_env(config=MIXED | {"observation.equal_shapes": True})
    assert all(padded.observation_space(a) is padded.observation_space("robot_0") for a in padded.possible_agents)
    for (plain, _), (full, _) in zip(log, played(padded, 150), strict=True):
        for (agent, blocks), count in zip(plain.items(), BEAMS, strict=True):
            for key, block in blocks.items():
                other = full[agent][key]
                assert np.array_equal(block, other[:count] if key == "lidar" else other), key
            assert not full[agent]["lidar"][count:].any()


def test_flat_observations_have_their_own_length_each():
    env = twc_env.parallel_env(config=MIXED | {"observation.kind": "flat", "observation.map": False})
    observations, _ = env.reset(seed=1)
    assert all(env.observation_space(a).contains(o) for a, o in observations.items())
    lengths = np.array([len(o) for o in observations.values()])
    assert (lengths - lengths[2]).tolist() == [180, 220, 0]


def test_actions_are_shares_of_the_robot_s_own_top_speed():
    env = twc_env.parallel_env(config=MIXED | {"slam.mode": "off"})
    env.reset(seed=3)
    before = env.episode.world.poses.copy()
    for _ in range(10):
        env.step(dict.fromkeys(env.agents, np.array([0.5, 0.0], np.float32)))
    moved_m = np.hypot(*(env.episode.world.poses - before).T[:2])
    assert moved_m == pytest.approx([0.25, 0.6, 0.5], abs=0.15)
    assert moved_m[0] < moved_m[2] < moved_m[1]


def test_receivers_and_cameras_keep_their_own_time(here):
    _, log = here
    heard = np.array([[frame.wifi is not None for frame in frames] for _, frames in log])
    assert np.flatnonzero(heard[:, 0]).tolist() == list(range(0, 151, 7))
    assert heard[:, 1:].sum(axis=0).tolist() == [75, 76]
    read = [np.flatnonzero([len(frames[r].signs) > 0 for _, frames in log]) for r in (1, 2)]
    assert ((read[0] + 1) % 8 == 0).all() and ((read[1] + 2) % 5 == 0).all()


def test_a_list_of_equal_robots_is_the_same_as_none():
    plain, listed = (twc_env.parallel_env(config=own | {"max_cycles": 60}) for own in ({}, {"robot": [{}, {}, {}]}))
    for (first, _), (second, _) in zip(played(plain, 59), played(listed, 59), strict=True):
        for agent, blocks in first.items():
            assert all(np.array_equal(block, second[agent][key]) for key, block in blocks.items())


def test_recorded_frames_give_the_same_estimates_to_the_byte(here, tmp_path):
    env, log = here
    write_frame_log(tmp_path / "frames.npz", env.config, [frames for _, frames in log])
    config, steps = read_frame_log(tmp_path / "frames.npz")
    assert config == env.config
    engine = CooperativeSlam(config, 3)
    for step, frames in enumerate(steps):
        engine.track(frames)
        engine.absorb(step)
    for robot in range(3):
        told, live = engine.belief(robot), env.engine.belief(robot)
        assert np.array_equal(told.pose_map_robot, live.pose_map_robot)
        assert np.array_equal(told.grid.log_odds, live.grid.log_odds)


def test_a_snapshot_continues_to_the_byte():
    env = twc_env.parallel_env(config=MIXED | {"people.count": 4})
    played(env, 40)
    snapshot = pickle.loads(pickle.dumps(env.snapshot()))

    def go_on():
        seen = []
        for step in range(40, 80):
            seen.append(env.step({a: action(step, int(a[-1])) for a in env.agents})[0])
        return seen

    first = go_on()
    env.restore(snapshot)
    for one, two in zip(first, go_on(), strict=True):
        assert all(np.array_equal(block, two[a][key]) for a, blocks in one.items() for key, block in blocks.items())


@pytest.mark.filterwarnings(  # it is a Dict, and may differ between agents, which PettingZoo allows
    "ignore:Observation", "ignore:Agents have different observation space sizes"
)
@pytest.mark.parametrize("equal", [False, True])
def test_both_interfaces_keep_their_contracts(equal):
    settings = MIXED | {"max_cycles": 30, "observation.equal_shapes": equal, "observation.map": False}
    parallel_api_test(twc_env.parallel_env(config=settings), num_cycles=40)
    api_test(twc_env.env(config=settings), num_cycles=40)


def test_vectors_of_teams_need_equal_shapes():
    with pytest.raises(ConfigError, match=r"have 360, 400, 180 beams.*set observation\.equal_shapes = true"):
        VectorTeams(1, MIXED)
    teams = VectorTeams(1, MIXED | {"observation.equal_shapes": True})
    assert teams.reset(0)["lidar"].shape == (1, 3, 400)
    teams.close()


def test_stable_baselines3_takes_a_team_of_equal_shapes():
    pytest.importorskip("stable_baselines3")
    from twc_env.vector.sb3 import TeamVecEnv

    rows = TeamVecEnv(1, MIXED | {"observation.equal_shapes": True})
    assert rows.reset()["lidar"].shape == (3, 400)
    rows.close()
    with pytest.raises(ConfigError, match=r"observation\.equal_shapes = true"):
        TeamVecEnv(1, MIXED)


def test_the_engine_is_for_the_robots_that_are_listed():
    with pytest.raises(ConfigError, match="robot lists 3 robots, and the engine is for 2"):
        CooperativeSlam(override(EnvConfig(), MIXED), 2)
