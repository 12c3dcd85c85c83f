from dataclasses import replace

import numpy as np

from twc_env.geometry import between, compose
from twc_env.slam.scan_alignment import aligned

WAY = [(-2.5, -2.0, 0.0), (-1.5, -2.0, 0.1), (-0.3, -2.1, 0.3), (0.7, -2.0, 0.9), (0.6, -0.8, 1.6), (0.3, 0.4, 2.2)]
WAY += [
    (-0.7, 1.0, 2.9),
    (-1.8, 1.2, -2.8),
    (-2.9, 0.5, -2.0),
    (-3.2, -0.6, -1.5),
    (-2.9, -1.6, -0.7),
    (-2.0, -2.1, 0.0),
]


def walked(walls, path_of, motion_std):
    """Keyframes of a loop with noisy motions, its true poses from the first, and what noisy odometry says of them."""
    random = np.random.default_rng(4)
    keyframes = path_of(0, walls, WAY)
    truth = np.array([k.pose_odom for k in keyframes])
    motions = between(truth[:-1], truth[1:]) + random.normal(size=(len(WAY) - 1, 3)) * motion_std
    reckoned = [np.zeros(3)]
    for motion in motions:
        reckoned.append(compose(reckoned[-1], motion))
    covariance = np.diag(np.square(motion_std))
    kept = [keyframes[0]]
    kept += [replace(k, motion=m, motion_covariance=covariance) for k, m in zip(keyframes[1:], motions, strict=True)]
    return kept, truth, np.array(reckoned)


def test_neighbouring_scans_put_a_loop_right_to_millimetres(office, path_of):
    keyframes, truth, reckoned = walked(office, path_of, (0.03, 0.03, 0.01))
    poses = aligned(keyframes, reckoned, 10.0)
    before, after = between(truth, reckoned), between(truth, poses)
    assert np.hypot(*before[:, :2].T).max() > 0.04
    assert np.hypot(*after[:, :2].T).max() < 0.006
    assert np.abs(after[:, 2]).max() < 0.002


def test_scans_without_returns_leave_the_odometry_alone(path_of):
    keyframes, _, reckoned = walked(np.array([[(50.0, 50.0), (51.0, 50.0)]]), path_of, (0.03, 0.03, 0.01))
    np.testing.assert_allclose(aligned(keyframes, reckoned, 10.0), reckoned, atol=1e-9)
