"""Walls along a narrow corridor do not hold a robot back that drives past them."""

import numpy as np
import pytest

from twc_env.config import EnvConfig, override
from twc_env.geometry import compose
from twc_env.messages import SensorFrame
from twc_env.slam.robot import FrontEnds

STEP_M, STEPS, LENGTH_M = 0.05, 200, 60.0


def _config(beams, noise_m):
    return override(EnvConfig(), {"robots": 1, "lidar.beam_count": beams, "lidar.range_noise_std_m": noise_m})


def _share(scan, corridor, beams, noise_m, seed):
    """How long a way seems to be, as a share of its length."""
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
def test_a_way_along_a_corridor_is_as_long_as_odometry_reads_it(scan, walls, width_m, beams, noise_m):
    half = 0.5 * width_m
    corridor = walls((-LENGTH_M, -half), (LENGTH_M, -half), (LENGTH_M, half), (-LENGTH_M, half))
    shares = [_share(scan, corridor, beams, noise_m, seed) for seed in range(6)]
    assert shares == pytest.approx(np.ones(6), abs=0.03)
    assert np.mean(shares) == pytest.approx(1.0, abs=0.007)
