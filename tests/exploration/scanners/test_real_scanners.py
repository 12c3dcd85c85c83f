"""Episodes with scanners that have the limits and errors of real ones: the guards of ground truth hold for them too."""

import pickle

import numpy as np
import pytest
from twc_env.agents.policy import make_policy

import twc_env
from twc_env.config import LIDAR_PRESETS, EnvConfig
from twc_env.datasets.logs.frame_log import read_frame_log, write_frame_log
from twc_env.exploration.observation.observations import ObservationBuilder
from twc_env.records.messages import SensorFrame
from twc_env.slam.engine import CooperativeSlam

EVERYTHING = {
    "lidar.beam_count": 240, "lidar.field_of_view_rad": 4.7, "lidar.is_clockwise": True, "lidar.mount_x_m": 0.1,
    "lidar.mount_yaw_rad": 0.2, "lidar.range_min_m": 0.15, "lidar.rate_hz": 5.0, "lidar.is_rolling": True,
    "lidar.range_noise_per_m": 0.005, "lidar.detection_range_m": 14.0, "lidar.dark_share": 0.05,
    "lidar.beam_divergence_rad": 0.005, "lidar.dropout_probability": 0.02, "lidar.glass_return_probability": 0.5,
    "lidar.mirror_probability": 0.8,
}  # fmt: skip
MOTION = np.array([37.3, -81.9, 1.1])


def action(step: int, robot: int) -> np.ndarray:
    return np.array([0.7, np.sin(0.11 * step + 2 * robot)], np.float32)


def make(robots=3, **arguments):
    return twc_env.parallel_env(**{"map": "twin-01", "robots": robots, "config": EVERYTHING} | arguments)


def played(env, steps: int, seed: int = 1):
    """Observations and frames of an episode."""
    observations, _ = env.reset(seed=seed)
    log = [(observations, env.frames)]
    for step in range(steps):
        observations = env.step({a: action(step, int(a[-1])) for a in env.agents})[0]
        log.append((observations, env.frames))
    return log


@pytest.fixture(scope="module")
def here():
    env = make()
    return env, played(env, 240)


def test_observations_do_not_depend_on_where_the_building_stands(here):
    env, log = here
    moved = make(floorplan=env.floorplan.moved(MOTION))
    for (first, _), (second, _) in zip(log, played(moved, 240), strict=True):
        for agent, blocks in first.items():
            for key, block in blocks.items():
                assert np.array_equal(block, second[agent][key]), key
    assert np.abs(env.state() - moved.state()).max() > 30


def test_replayed_frames_give_identical_estimates_and_observations(here):
    env, log = here
    engine, builder = CooperativeSlam(env.config, 3), ObservationBuilder(env.config)
    for observations, frames in log:
        frames = pickle.loads(pickle.dumps(list(frames)))
        engine.update(frames)
        builder.notice(frames, [engine.belief(robot) for robot in range(3)])
        for agent, built in zip(env.possible_agents, builder.build(), strict=True):
            assert all(np.array_equal(built[key], observations[agent][key]) for key in built)
    for robot in range(3):
        assert np.array_equal(engine.team.poses_of(robot), env.engine.team.poses_of(robot))
        assert np.array_equal(engine.belief(robot).ranges_m, env.belief(f"robot_{robot}").ranges_m)


def test_a_written_log_holds_the_scanners_and_the_frames_without_scan(here, tmp_path):
    env, log = here
    steps = [list(frames) for _, frames in log]
    write_frame_log(tmp_path / "frames.npz", env.config, steps)
    config, read = read_frame_log(tmp_path / "frames.npz")
    assert config == env.config
    for before, after in zip(steps, read, strict=True):
        for frame, again in zip(before, after, strict=True):
            assert again.scanner == frame.scanner == env.config.lidar.scanner
            assert np.array_equal(again.ranges_m, frame.ranges_m)
    assert {len(frame.ranges_m) for frames in read for frame in frames} == {0, 240}


def test_an_episode_continues_exactly_from_a_snapshot_between_two_scans():
    env, twin = make(robots=2), make(robots=2)
    played(env, 33)
    twin.reset(seed=5)
    twin.restore(pickle.loads(pickle.dumps(env.snapshot())))
    for step in range(40):
        actions = {a: action(step, int(a[-1])) for a in env.agents}
        first, second = env.step(actions)[0], twin.step(actions)[0]
        for agent, blocks in first.items():
            assert all(np.array_equal(block, second[agent][key]) for key, block in blocks.items())


@pytest.mark.parametrize("name", LIDAR_PRESETS)
def test_observations_of_every_preset_are_in_their_space(name):
    env = make(robots=1, config={"lidar.preset": name})
    for observations, _ in played(env, 5):
        for agent, blocks in observations.items():
            assert env.observation_space(agent).contains(blocks)
            assert blocks["lidar"].shape == (env.config.lidar.beam_count,)


def test_a_team_with_different_scanners_merges_into_one_map():
    """The same drives in three worlds, each with another scanner, of which one engine gets the frames of one robot."""
    frames, actions = explored(make(config={}), 700)
    teams = [frames]
    for name in ("rplidar-a1", "lms-200"):
        env = make(config={"lidar.preset": name})
        env.reset(seed=2)
        teams.append([list(env.frames), *(env.step(some) and list(env.frames) for some in actions)])
    engine = CooperativeSlam(EnvConfig(robots=3), 3)
    for step in zip(*teams, strict=True):
        engine.update([of_team[robot] for robot, of_team in enumerate(step)])
    assert len({of_team[0][robot].scanner for robot, of_team in enumerate(teams)}) == 3
    assert [group.robots for group in engine.team.groups] == [(0, 1, 2)]


def explored(env, steps: int) -> tuple[list[list[SensorFrame]], list[dict]]:
    """Frames and actions of a team that explores."""
    env.reset(seed=2)
    policy = make_policy("nearest-frontier", env.config)
    policy.reset(2, env.agents)
    frames, actions = [list(env.frames)], []
    for _ in range(steps):
        actions.append(policy.act({agent: env.belief(agent) for agent in env.agents}))
        env.step(actions[-1])
        frames.append(list(env.frames))
    return frames, actions


def test_rolling_scans_undone_by_odometry_cost_little():
    errors = {}
    for undoes in (True, False):
        settings = {"lidar.rate_hz": 5.0, "lidar.is_rolling": True, "slam.undoes_rolling": undoes}
        env = make(config=settings)
        explored(env, 400)
        errors[undoes] = env.result().figures["team_ate_m"]
    assert errors[True] < 0.08
    assert errors[False] > 3 * errors[True]
