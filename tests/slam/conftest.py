"""Hand-made rooms, noise-free scans in them, and keyframes with these scans."""

import numpy as np
import pytest

from twc_env.config import EnvConfig
from twc_env.maps import load_map
from twc_env.records.geometry import between
from twc_env.records.messages import Fingerprint, Keyframe, SensorFrame
from twc_env.world.world import World

RANGE_MAX_M = 10.0


def polygon_walls(*corners: tuple[float, float]) -> np.ndarray:
    """(k, 2, 2) walls of a closed polygon."""
    points = np.array(corners, float)
    return np.stack([points, np.roll(points, -1, axis=0)], axis=1)


def exact_scan(walls: np.ndarray, pose, beams: int = 180, range_max_m: float = RANGE_MAX_M) -> np.ndarray:
    """(beams,) noise-free scan [m]: distance to the nearest wall along each beam; range_max_m if there is none."""
    angles = pose[2] + np.arange(beams) * 2 * np.pi / beams
    direction = np.stack([np.cos(angles), np.sin(angles)], axis=1)[:, None]  # (beams, 1, 2)
    start, along = walls[:, 0] - np.asarray(pose)[:2], walls[:, 1] - walls[:, 0]  # (walls, 2)
    cross = direction[..., 0] * along[:, 1] - direction[..., 1] * along[:, 0]  # (beams, walls)
    with np.errstate(divide="ignore", invalid="ignore"):
        distance = (start[:, 0] * along[:, 1] - start[:, 1] * along[:, 0]) / cross
        share = (start[:, 0] * direction[..., 1] - start[:, 1] * direction[..., 0]) / cross
        hit = (distance > 0) & (share >= 0) & (share <= 1)
    return np.minimum(np.where(hit, distance, range_max_m).min(axis=1), range_max_m)


def make_keyframe(robot=0, index=0, pose=(0.0, 0.0, 0.0), travel_m=0.0, ranges_m=None, signs=(), macs=(), rssi_dbm=()):
    """A keyframe with defaults for everything that the test does not set."""
    return Keyframe(
        robot=robot,
        index=index,
        step=10 * index,
        time_s=float(index),
        pose_odom=np.asarray(pose, float),
        motion=np.zeros(3),
        motion_covariance=np.diag([1e-4, 1e-4, 1e-5]),
        travel_m=travel_m,
        ranges_m=np.full(8, RANGE_MAX_M) if ranges_m is None else ranges_m,
        signs=tuple(signs),
        fingerprint=Fingerprint(np.array(macs, np.int64), np.array(rssi_dbm, float)),
    )


@pytest.fixture(scope="session")
def scan():
    return exact_scan


@pytest.fixture(scope="session")
def walls():
    return polygon_walls


@pytest.fixture(scope="session")
def keyframe():
    return make_keyframe


@pytest.fixture(scope="session")
def path_of():
    """Keyframes of one robot along poses in the building; its odom frame starts at the first of them."""

    def make(robot: int, walls: np.ndarray, poses: np.ndarray) -> list[Keyframe]:
        poses = np.asarray(poses, float)
        steps = np.hypot(*np.diff(poses[:, :2], axis=0).T)
        travel = np.concatenate([[0.0], np.cumsum(steps)])
        return [
            make_keyframe(robot, i, between(poses[0], pose), travel[i], exact_scan(walls, pose))
            for i, pose in enumerate(poses)
        ]

    return make


@pytest.fixture(scope="session")
def office():
    """(w, 2, 2) walls of an asymmetric room: no two walls or corners are alike."""
    return np.concatenate(
        [
            polygon_walls((-4, -3), (3.5, -3), (3.5, 1), (5, 1), (5, 3.2), (-1, 3.2), (-1, 2.4), (-4, 2.4)),
            polygon_walls((1.0, -1.2), (1.6, -1.2), (1.6, -0.5), (1.0, -0.5)),
            polygon_walls((-2.6, 0.4), (-2.2, 0.4), (-2.2, 0.9), (-2.6, 0.9)),
        ]
    )


@pytest.fixture(scope="session")
def hall():
    """(w, 2, 2) walls of a room of another shape."""
    return np.concatenate(
        [
            polygon_walls((-6, -1.6), (6.5, -1.6), (6.5, 4.5), (2, 4.5), (2, 6), (-3, 6), (-3, 4), (-6, 4)),
            polygon_walls((3.0, 1.0), (3.5, 1.0), (3.5, 1.6), (3.0, 1.6)),
        ]
    )


Frames = list[tuple[SensorFrame, ...]]


def record_frames(config: EnvConfig, wander, steps: int, seed: int = 0) -> tuple[Frames, np.ndarray]:
    """Frames of every step of a team with a reactive policy, and its true poses (steps + 1, robots, 3)."""
    world = World(config, load_map(config.map))
    world.reset(seed, "map")
    frames, poses = [world.sense()], [world.poses]
    maxima = (config.dynamics.speed_max_m_s, config.dynamics.turn_rate_max_rad_s)
    for step in range(steps):
        actions = [wander(frame.ranges_m, step, frame.robot) for frame in frames[-1]]
        world.step(np.array(actions, float) * maxima)
        frames.append(world.sense())
        poses.append(world.poses)
    return frames, np.array(poses)


@pytest.fixture(scope="session")
def record(wander):
    return lambda config, steps, seed=0: record_frames(config, wander, steps, seed)


@pytest.fixture(scope="session")
def recorded(record):
    """A team of three in twin-01 for 500 steps: config, frames, true poses."""
    config = EnvConfig(map="twin-01", robots=3)
    return config, *record(config, 500)
