"""A robot that slips in one step is localised again by scan matching."""

import numpy as np
import pytest

from twc_env.config import EnvConfig, override
from twc_env.records.geometry import between, compose
from twc_env.records.messages import SensorFrame
from twc_env.slam.robot import FrontEnds

STEP_M, STEP_RAD, BEFORE, AFTER = 0.05, 0.02, 50, 10
HALL = [(-4, -3), (4, -3), (4, 3), (-4, 3)]
TWO_ROOMS = [(-2, -2), (2, -2), (2, -0.5), (5, -0.5), (5, 2.5), (2, 2.5), (2, 0.5), (1.8, 0.5), (1.8, 2), (-2, 2)]
ROUND_A_CORNER = [(-2, -1), (6, -1), (6, 8), (4, 8), (4, 1), (-2, 1)]
"""An L-shaped corridor, in which few beams constrain the position along it."""
ROOMS = [HALL, TWO_ROOMS, ROUND_A_CORNER]
SLIPS_M = [-0.5, -0.3, -0.2, -0.15, -0.1, 0.1, 0.15, 0.2, 0.3, 0.5]


def off_after(scan, corners, slip, seed=0, backend="compiled"):
    """Pose error (m, m, rad) of a robot some steps after odometry with an additional motion (3,)."""
    random, room = np.random.default_rng(seed), np.array(corners, float)
    walls = np.stack([room, np.roll(room, -1, axis=0)], axis=1)
    ends = FrontEnds(override(EnvConfig(), {"robots": 1, "slam.odometry_filter.backend": backend}), 1)
    true = start = np.array([-1.5, 0.0, 0.0])
    motion = np.array([STEP_M, 0.0, 0.0])
    for step in range(BEFORE + AFTER + 1):
        if step:
            motion[2] = STEP_RAD * np.sin(0.2 * step)
            true = compose(true, motion)
        read = motion * (step > 0) + (slip if step == BEFORE else 0.0)
        read_too = read + random.normal(0, 1, 3) * (0.002, 0.001, 0.005) * (step > 0)
        seen_m = scan(walls, true) + random.normal(0, 0.01, 180)
        ends.update([SensorFrame(0, step, 0.1 * step, read_too, read[2] / 0.1, seen_m, None, ())])
    return between(between(start, true), ends.poses_odom[0])


@pytest.mark.parametrize("seed", [0, 1])
@pytest.mark.parametrize(
    ("corners", "slip_m"), [(r, s) for r in ROOMS for s in SLIPS_M if r is not ROUND_A_CORNER or abs(s) < 0.5]
)
def test_wheel_slip_is_corrected_within_a_second(scan, corners, slip_m, seed):
    for slip in ([slip_m, 0.0, 0.0], [0.0, slip_m, 0.0]):
        off = off_after(scan, corners, np.array(slip), seed)
        assert np.hypot(off[0], off[1]) < 0.05 and abs(off[2]) < np.deg2rad(1.0)


@pytest.mark.parametrize("seed", [0, 1])
@pytest.mark.parametrize("corners", ROOMS)
@pytest.mark.parametrize("turn_deg", [-15, -10, -5, 5, 10, 15])
def test_an_external_rotation_is_corrected_within_a_second(scan, corners, turn_deg, seed):
    off = off_after(scan, corners, np.array([0.0, 0.0, np.deg2rad(turn_deg)]), seed)
    assert np.hypot(off[0], off[1]) < 0.05 and abs(off[2]) < np.deg2rad(1.0)


@pytest.mark.parametrize("slip", [[0.3, 0.0, 0.0], [0.0, 0.5, 0.0], [0.0, 0.0, 0.2]])
def test_both_filters_handle_slips_equally(scan, slip):
    compiled, filterpy = [off_after(scan, TWO_ROOMS, np.array(slip), 2, kind) for kind in ("compiled", "filterpy")]
    assert compiled == pytest.approx(filterpy, abs=1e-9)
