import numpy as np
import pytest

from twc_env.records.geometry import beam_directions, between, compose
from twc_env.records.messages import SensorFrame
from twc_env.slam.front_end.particle_filter import ParticleFilter, ParticleFilterSettings, map_frames

BEAMS, RANGE_MAX_M = 180, 12.0
HALF_M = np.array([4.0, 2.5])
"""Half the side lengths of a room centred at (0, 0)."""
SETTINGS = ParticleFilterSettings(particles=8, size_m=20.0)


def scan_of_the_room(pose):
    """Ranges from a pose in the room, which an alcove makes asymmetric."""
    directions = beam_directions(BEAMS)
    c, s = np.cos(pose[2]), np.sin(pose[2])
    ray = np.stack([c * directions[:, 0] - s * directions[:, 1], s * directions[:, 0] + c * directions[:, 1]], axis=1)
    with np.errstate(divide="ignore"):
        ahead = np.where(ray > 0, HALF_M - pose[:2], -HALF_M - pose[:2]) / ray
    return ahead.min(axis=1)


@pytest.fixture(scope="module")
def drive():
    """A loop through the room with odometry whose turns are 5 % too large."""
    angles = np.linspace(0.0, 2 * np.pi, 60)
    truth = np.stack([2.0 * np.cos(angles), 1.2 * np.sin(angles), angles + np.pi / 2], axis=1)
    frames = []
    for k, pose in enumerate(truth):
        odometry = between(truth[max(k - 1, 0)], pose) * [1.0, 1.0, 1.05]
        frames.append(SensorFrame(0, k, 0.5 * k, odometry, 0.0, scan_of_the_room(pose)))
    return frames, between(truth[0], truth)


def test_the_path_follows_the_scans_and_not_the_drift(drive):
    frames, truth = drive
    path, grid = map_frames(frames, SETTINGS, RANGE_MAX_M, seed=0)
    dead_reckoned = np.zeros(3)
    for frame in frames:
        dead_reckoned = compose(dead_reckoned, frame.odometry)
    assert np.hypot(*(dead_reckoned - truth[-1])[:2]) > 0.25
    assert np.linalg.norm(path[:, :2] - truth[:, :2], axis=1).max() < 0.1
    walls_m2 = (grid.log_odds > 0).sum() * 0.01
    assert walls_m2 < 2 * 0.1 * 4 * HALF_M.sum(), "walls are about one cell thick"
    assert (grid.log_odds < 0).sum() * 0.01 == pytest.approx(4 * HALF_M.prod(), rel=0.08)


def test_after_resampling_a_path_follows_one_ancestor(drive):
    frames, _ = drive
    particles = ParticleFilter(SETTINGS, RANGE_MAX_M, np.random.default_rng(1))
    for frame in frames:
        particles.update(frame)
    steps = np.linalg.norm(np.diff(particles.path()[:, :2], axis=0), axis=1)
    told = np.array([np.hypot(*frame.odometry[:2]) for frame in frames[1:]])
    assert any((parents != np.arange(len(parents))).any() for parents in particles._parents)
    assert np.abs(steps - told).max() < 0.15


def test_a_robot_at_rest_stays_on_free_floor():
    pose = np.array([0.05, 0.05, 0.0])
    frames = [SensorFrame(0, k, 0.1 * k, np.zeros(3), 0.0, scan_of_the_room(pose)) for k in range(800)]
    settings = ParticleFilterSettings(particles=1, samples=1, size_m=12.0)
    _, grid = map_frames(frames, settings, RANGE_MAX_M, seed=0)
    middle = len(grid.log_odds) // 2
    assert (grid.log_odds[middle - 5 : middle + 6, middle - 5 : middle + 6] < 0).all()


def test_the_same_seed_gives_the_same_path(drive):
    frames = drive[0][:15]
    paths = [map_frames(frames, SETTINGS, RANGE_MAX_M, seed=seed)[0] for seed in (3, 3, 4)]
    assert np.array_equal(paths[0], paths[1]) and not np.array_equal(paths[0], paths[2])
