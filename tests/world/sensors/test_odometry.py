from itertools import pairwise

import numpy as np
import pytest

from twc_env.config import OdometryConfig
from twc_env.records.geometry import compose
from twc_env.world.sensors.odometry import PRESETS, Odometry


def loop(steps: int = 1000, speed_m: float = 0.06) -> np.ndarray:
    """A path of 9 m segments with quarter turns between them."""
    poses = [np.zeros(3)]
    for step in range(steps):
        turning = (step // 25) % 7 == 6
        side = 1 if (step // 175) % 2 else -1
        poses.append(compose(poses[-1], [0.0 if turning else speed_m, 0.0, side * 0.0628 if turning else 0.0]))
    return np.array(poses)


def dead_reckoning(path: np.ndarray, platform: str = "wheeled", drift: float = 1.0, seed: int = 0) -> np.ndarray:
    odometry = Odometry(OdometryConfig(platform=platform, drift=drift), 0.1, 1, seed)
    pose = path[:1]
    for before, now in pairwise(path):
        pose = compose(pose, odometry.measure(before[None], now[None])[0])
    return pose[0]


@pytest.mark.parametrize("platform", ["wheeled", "legged", "handheld"])
def test_without_drift_odometry_and_gyro_are_exact(platform):
    path = loop()
    assert dead_reckoning(path, platform, drift=0.0) == pytest.approx(path[-1], abs=1e-9)
    odometry = Odometry(OdometryConfig(platform=platform, drift=0.0), 0.1, 1, 0)
    _, turn_rate = odometry.measure(np.array([[0.0, 0.0, 3.1]]), np.array([[0.1, 0.0, -3.1]]))
    assert turn_rate[0] == pytest.approx((2 * np.pi - 6.2) / 0.1)


def test_errors_grow_from_wheeled_to_legged_to_handheld():
    path = loop()
    errors = {
        platform: np.median([np.hypot(*(dead_reckoning(path, platform, seed=s) - path[-1])[:2]) for s in range(40)])
        for platform in ("wheeled", "legged", "handheld")
    }
    assert errors["wheeled"] < errors["legged"] < errors["handheld"]


def test_wheeled_dead_reckoning_is_metres_off_after_sixty_metres():
    path = loop(1200)
    length_m = np.linalg.norm(np.diff(path[:, :2], axis=0), axis=1).sum()
    errors = [np.hypot(*(dead_reckoning(path, seed=s) - path[-1])[:2]) for s in range(60)]
    assert 1.5 < np.median(errors) * 60 / length_m < 5.5


def test_a_robot_at_rest_reports_no_motion_but_its_gyro_drifts():
    odometry = Odometry(OdometryConfig(), 0.1, 1, 3)
    pose = np.array([[1.0, 2.0, 0.5]])
    motions, rates = zip(*(odometry.measure(pose, pose) for _ in range(500)), strict=True)
    assert np.abs(motions).max() == 0.0
    assert np.std(rates) == pytest.approx(0.02, rel=0.15)
    assert abs(np.mean(rates)) > 1e-4


def test_errors_of_a_robot_do_not_depend_on_other_robots():
    path = loop(100)
    one, three = (Odometry(OdometryConfig(), 0.1, n, 5) for n in (1, 3))
    for before, now in pairwise(path):
        alone, _ = one.measure(before[None], now[None])
        team, _ = three.measure(np.tile(before, (3, 1)), np.tile(now, (3, 1)))
        assert np.array_equal(alone[0], team[0])
    assert not np.array_equal(team[0], team[1])


def test_the_drift_setting_scales_the_error():
    path = loop(300)
    errors = [
        np.median([np.hypot(*(dead_reckoning(path, drift=d, seed=s) - path[-1])[:2]) for s in range(30)])
        for d in (0.0, 0.5, 1.0, 2.0, 4.0)
    ]
    assert errors[0] == pytest.approx(0.0, abs=1e-9)
    assert all(low < high for low, high in pairwise(errors))
    assert errors[1] / errors[2] == pytest.approx(0.5, abs=0.1)
    assert errors[3] / errors[2] == pytest.approx(2.0, abs=0.4)


def test_the_intel_platform_has_its_heading_and_scale_bias_in_every_episode():
    straight = np.column_stack([np.arange(0, 20, 0.1), np.zeros(200), np.zeros(200)])
    ends = np.array([dead_reckoning(straight, "pioneer-intel", seed=s) for s in range(20)])
    headings = np.unwrap(ends[:, 2])
    assert np.mean(headings) == pytest.approx(-0.0645 * 19.9, abs=0.1)
    one_leap = straight[[0, 100]]
    lengths = [np.hypot(*dead_reckoning(one_leap, "pioneer-intel", seed=s)[:2]) for s in range(40)]
    assert np.mean(lengths) == pytest.approx(10.0 * 1.012, abs=0.1)


def test_position_variance_grows_with_distance_as_stated():
    preset, steps, start = PRESETS["wheeled"], 4000, np.zeros((1, 3))
    odometry = Odometry(OdometryConfig(), 0.1, 1, 3)
    for length_m in (0.1, 0.9):
        moved = np.array([odometry.measure(start, np.array([[length_m, 0.0, 0.0]]))[0][0] for _ in range(steps)])
        # Sideways there is half the noise, and no slip.
        assert np.std(moved[:, 1]) == pytest.approx(0.5 * preset.position_std_m * np.sqrt(length_m), rel=0.05)


def test_heading_variance_grows_with_distance_and_turn_as_stated():
    preset, steps = PRESETS["wheeled"], 4000
    odometry = Odometry(OdometryConfig(), 0.1, 1, 2)
    start = np.zeros((1, 3))
    for motion, expected in (
        ([0.4, 0.0, 0.0], preset.heading_std_rad * np.sqrt(0.4)),
        ([0.0, 0.0, 0.9], preset.turn_std_rad * np.sqrt(0.9)),
    ):
        turns = [odometry.measure(start, np.array([motion]))[0][0, 2] for _ in range(steps)]
        assert np.std(turns) == pytest.approx(expected, rel=0.05)


def test_systematic_errors_come_and_go_by_the_share_that_varies():
    straight = np.column_stack([0.1 * np.arange(6001.0), np.zeros((6001, 2))])

    def scale_errors(variation, seed):
        config = OdometryConfig(platform="skid-steer", variation=variation)
        odometry = Odometry(config, 0.1, 1, seed)
        read_m = np.array([odometry.measure(a[None], b[None])[0][0, 0] for a, b in pairwise(straight)])
        return read_m.reshape(-1, 200).mean(axis=1) / 0.1 - 1.0  # of 20 s each

    steady, varying = (np.array([scale_errors(share, seed) for seed in range(8)]) for share in (0.0, 1.0))
    noise = 0.03 * np.sqrt(0.1 / 200) / 0.1
    assert steady.std(axis=1).mean() == pytest.approx(noise, rel=0.3)
    assert varying.std(axis=1).mean() > 2 * noise
    assert (varying**2).mean() == pytest.approx(PRESETS["skid-steer"].scale_std ** 2, rel=0.6)
