"""Along a corridor only odometry measures the distance; the view of its end corrects the odometry scale."""

import numpy as np
import pytest

from twc_env.config import EnvConfig, override
from twc_env.records.geometry import compose
from twc_env.records.messages import SensorFrame
from twc_env.slam.robot import FrontEnds
from twc_env.slam.team import TeamMapper

STEP_M, STEPS, LENGTH_M = 0.05, 200, 60.0


def _config(beams, noise_m):
    return override(EnvConfig(), {"robots": 1, "lidar.beam_count": beams, "lidar.range_noise_std_m": noise_m})


def _share(scan, corridor, beams, noise_m, seed):
    """Estimated path length as a share of the true length."""
    random, ends = np.random.default_rng(seed), FrontEnds(_config(beams, noise_m), 1)
    true, motion = np.zeros(3), np.array([STEP_M, 0.0, 0.0])
    for step in range(STEPS + 1):
        motion[2] = 0.02 * np.cos(0.1 * step)
        if step:
            true = compose(true, motion)
        read = (motion + random.normal(0, 1, 3) * (0.002, 0.001, 0.005)) * (step > 0)
        seen_m = scan(corridor, true, beams)
        seen_m[seen_m < 10.0] += random.normal(0, noise_m, np.count_nonzero(seen_m < 10.0))
        ends.update([SensorFrame(0, step, 0.1 * step, read, motion[2] / 0.1 * (step > 0), seen_m, None, ())])
    return np.hypot(*ends.poses_odom[0, :2]) / np.hypot(*true[:2])


@pytest.mark.parametrize(
    ("beams", "noise_m"),
    [(180, 0.01), (360, 0.01), (720, 0.01), (36, 0.05), (90, 0.03), (180, 0.03), (180, 0.05), (720, 0.05)],
)
@pytest.mark.parametrize("width_m", [1.2, 2.0])
def test_path_length_along_a_corridor_follows_the_odometry(scan, walls, width_m, beams, noise_m):
    half = 0.5 * width_m
    corridor = walls((-LENGTH_M, -half), (LENGTH_M, -half), (LENGTH_M, half), (-LENGTH_M, half))
    shares = [_share(scan, corridor, beams, noise_m, seed) for seed in range(6)]
    assert shares == pytest.approx(np.ones(6), abs=0.03)
    assert np.mean(shares) == pytest.approx(1.0, abs=0.007)


def _behind_a_teammate(scan, walls, seed, length_m=14.0):
    """Estimated path length along a corridor as a share of the true one, with another robot close ahead."""
    random, ends = np.random.default_rng(seed), FrontEnds(override(_config(180, 0.01), {"robots": 2}), 2)
    corridor = walls((-LENGTH_M, -1.0), (LENGTH_M, -1.0), (LENGTH_M, 1.0), (-LENGTH_M, 1.0))
    around = 0.2 * np.array([(np.cos(a), np.sin(a)) for a in np.arange(0.0, 2 * np.pi, np.pi / 12)])
    true = np.zeros(3)
    for step in range(round(length_m / STEP_M) + 1):
        motion = np.array([STEP_M, 0.0, 0.0]) * (step > 0)
        true = compose(true, motion)
        apart_m = max(2.0 - 0.02 * step, 0.5)
        teammate = walls(*(true[:2] + [apart_m, 0.0] + around).tolist())
        seen_m = scan(np.concatenate([corridor, teammate]), true)
        seen_m[seen_m < 10.0] += random.normal(0, 0.01, np.count_nonzero(seen_m < 10.0))
        read = motion + random.normal(0, 1, 3) * (0.002, 0.001, 0.005) * (step > 0)
        ends.update([SensorFrame(0, step, 0.1 * step, read, 0.0, seen_m, None, ())])
    return ends.poses_odom[0, 0] / length_m


def test_another_robot_does_not_shorten_the_path_along_a_corridor(scan, walls):
    assert [_behind_a_teammate(scan, walls, seed) for seed in range(4)] == pytest.approx(np.ones(4), abs=0.01)


def _driven(length_m, too_long, scan, walls, beams=180):
    """Keyframes and their true poses of a robot that drives to 1 m before the end of a corridor and 160 steps back."""
    corridor = walls((-LENGTH_M, -1.0), (length_m, -1.0), (length_m, 1.0), (-LENGTH_M, 1.0))
    random, ends, true = np.random.default_rng(5), FrontEnds(_config(beams, 0.01), 1), np.zeros(3)
    keyframes, way, count = [], [], round((length_m - 1.0) / STEP_M)
    for step in range(count + 1 + 160):
        motion = np.array([STEP_M if step <= count else -STEP_M, 0.0, 0.0]) * (step > 0)
        true = compose(true, motion)
        read = motion * (1.0 + too_long) + random.normal(0, 1, 3) * (0.002, 0.001, 0.005) * (step > 0)
        seen_m = scan(corridor, true, beams)
        seen_m[seen_m < 10.0] += random.normal(0, 0.01, np.count_nonzero(seen_m < 10.0))
        new = ends.update([SensorFrame(0, step, 0.1 * step, read, 0.0, seen_m, None, ())])
        keyframes += new
        way += [true.copy()] * len(new)
    return keyframes, np.array(way)


@pytest.mark.parametrize("too_long", [0.05, -0.04])
def test_the_end_of_a_corridor_corrects_the_odometry_scale_of_the_path(scan, walls, too_long):
    keyframes, way = _driven(40.0, too_long, scan, walls)
    farthest = int(way[:, 0].argmax())
    alone_m = sum(keyframe.by_odometry_m[0] for keyframe in keyframes[:farthest])
    assert alone_m == pytest.approx(30.0 * (1.0 + too_long), rel=0.08), "the end is seen from 10 m away"
    scale, std = keyframes[-1].odometry_scale
    assert scale == pytest.approx(too_long / (1.0 + too_long), abs=3.0 * std)
    mapper = TeamMapper(EnvConfig(), 1)
    for keyframe in keyframes:
        mapper.update(keyframe.step, [keyframe])
    mapper.finish()
    believed_m, true_m = mapper.poses_of(0)[farthest, 0], way[farthest, 0]
    assert abs(keyframes[farthest].pose_odom[0] - true_m) > 0.7 * abs(30.0 * too_long), "as it was believed"
    assert believed_m == pytest.approx(true_m, abs=0.35 * abs(30.0 * too_long))


def test_in_rooms_no_direction_depends_on_odometry_alone(scan, office):
    ends, motion, true = FrontEnds(_config(180, 0.01), 1), np.array([0.05, 0.0, 0.0]), np.zeros(3)
    keyframes = []
    for step in range(60):
        true = compose(true, motion * (step > 0))
        keyframes += ends.update(
            [SensorFrame(0, step, 0.1 * step, motion * (step > 0), 0.0, scan(office, true), None, ())]
        )
    assert len(keyframes) > 2
    assert all(k.by_odometry_m == k.odometry_scale == (0.0, 0.0) for k in keyframes)
