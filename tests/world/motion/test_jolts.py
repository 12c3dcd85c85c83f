"""Bumps and slips of odometry: how many, how large, and where."""

import numpy as np
import pytest

from twc_env.config import EnvConfig, OdometryConfig, override
from twc_env.maps import load_map
from twc_env.world.motion.jolts import BUMP_RAD, Jolts
from twc_env.world.world import World

DOORWAY = np.array([[0.0, -0.5, 0.0, 0.5]])


def driven(steps=2000, way_m=0.1, **settings):
    """Errors (steps, 3) of a robot that drives to and fro along a line of 2 m through a doorway."""
    jolts, errors = Jolts([OdometryConfig(**settings)], DOORWAY, 0), []
    for k in range(steps):
        x = 1.0 - abs((way_m * k) % 4.0 - 2.0)
        odometry = np.array([[way_m, 0.0, 0.0]])
        jolts.apply(np.array([[x, 0.0, 0.0]]), odometry)
        errors.append(odometry[0] - [way_m, 0.0, 0.0])
    return np.array(errors[1:])


def test_bumps_come_at_their_rate_and_turn_the_robot_to_both_sides():
    errors = driven(bumps_per_m=0.5)
    bumps = np.flatnonzero(errors[:, 2])
    assert 70 <= len(bumps) <= 130  # 200 m
    assert np.allclose(np.abs(errors[bumps, 2]), BUMP_RAD) and abs(np.sign(errors[bumps, 2]).sum()) < 40
    assert not errors[:, :2].any()


@pytest.mark.parametrize(("bumps_per_m", "way_m"), [(10.0, 0.11), (1.0, 1.0), (5.0, 0.5)])
def test_robots_that_bump_in_every_step_bump_in_every_step(bumps_per_m, way_m):
    assert driven(200, way_m, bumps_per_m=bumps_per_m)[:, 2].astype(bool).mean() > 0.95


def test_long_steps_slip_too():
    assert np.count_nonzero(driven(400, 1.03, threshold_slip_m=0.05)[:, 0]) > 150  # 412 m


def test_a_carried_robot_neither_bumps_nor_slips_on_the_way():
    jolts = Jolts([OdometryConfig(bumps_per_m=10.0, threshold_slip_m=0.05)] * 2, DOORWAY, 0)
    errors = []
    for x in (-2.0, 2.0, 2.5):
        odometry = np.zeros((2, 3))
        jolts.apply(np.array([[x, 0.0, 0.0]] * 2), odometry)
        errors.append(odometry.any(axis=1).tolist())
        if x < 0.0:
            jolts.carried(0)
    assert errors == [[False, False], [False, True], [True, True]]


def test_wheels_slip_in_doorways_only():
    errors = driven(threshold_slip_m=0.05)
    slips = np.flatnonzero(errors[:, 0])
    assert len(slips) == pytest.approx(100, abs=2)  # 200 m, a doorway every 2 m
    assert (errors[slips, 0] > 0).all() and np.sqrt((errors[slips, 0] ** 2).mean()) == pytest.approx(0.05, rel=0.25)
    assert np.array_equal(np.flatnonzero(errors[:, 2]), slips)


def test_a_late_scan_shows_where_the_robot_was():
    def ranges(delay_s):
        config = {"lidar.delay_s": delay_s, "lidar.range_noise_std_m": 0.0, "lidar.mount_yaw_rad": 1e-9}
        world = World(override(EnvConfig(robots=1), config), load_map("twin-01"))
        world.reset(0)
        world.sense()
        return [world.tick(np.array([[0.3, 1.0]])).ranges_m[0] for _ in range(6)]

    late, now = ranges(0.1), ranges(0.0)
    assert np.allclose(late[5], now[4], atol=1e-6) and not np.allclose(late[5], now[5], atol=1e-3)


def test_bumps_change_odometry_alone():
    def odometry(**settings):
        world = World(override(EnvConfig(robots=1), settings), load_map("twin-01"))
        world.reset(0)
        world.sense()
        frames = [world.tick(np.array([[0.5, 0.3]])) for _ in range(30)]
        return [np.array([frame.odometry[0] for frame in frames]), np.array([frame.ranges_m[0] for frame in frames])]

    bumpy, smooth = odometry(**{"odometry.bumps_per_m": 5.0}), odometry()
    turned = np.abs(bumpy[0][:, 2] - smooth[0][:, 2])
    assert np.array_equal(bumpy[1], smooth[1]) and 1 <= np.count_nonzero(turned) < 25
    assert np.allclose(turned[turned > 0], BUMP_RAD)
