from dataclasses import replace

import numpy as np
import pytest

from twc_env.records.geometry import between, compose
from twc_env.slam.matching.scan_alignment import FITS, STEPS_BACK, _pairs, aligned
from twc_env.slam.pose_graph import solver as pose_graph

WAY = [(-2.5, -2.0, 0.0), (-1.5, -2.0, 0.1), (-0.3, -2.1, 0.3), (0.7, -2.0, 0.9), (0.6, -0.8, 1.6), (0.3, 0.4, 2.2)]
WAY += [(-0.7, 1.0, 2.9), (-1.8, 1.2, -2.8), (-2.9, 0.5, -2.0), (-3.2, -0.6, -1.5), (-2.9, -1.6, -0.7), (-2.0, -2.1, 0)]


def walked(walls, path_of, motion_std):
    """Keyframes of a loop with noisy motions, true poses relative to the first, and dead-reckoned poses."""
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


def test_neighbouring_scans_correct_a_loop_to_millimetres(office, path_of):
    keyframes, truth, reckoned = walked(office, path_of, (0.03, 0.03, 0.01))
    poses = aligned(keyframes, reckoned, 10.0)
    before, after = between(truth, reckoned), between(truth, poses)
    assert np.hypot(*before[:, :2].T).max() > 0.04
    assert np.hypot(*after[:, :2].T).max() < 0.006
    assert np.abs(after[:, 2]).max() < 0.002


def test_in_a_small_loop_no_pair_of_scans_is_matched_twice():
    travel_m = np.arange(30.0)
    turn = travel_m * (2 * np.pi / 8)  # one scan per metre on a circle with a circumference of 8 m
    poses = np.column_stack([4 / np.pi * np.cos(turn), 4 / np.pi * np.sin(turn), turn])
    pairs = _pairs(poses, travel_m)
    assert len(np.unique(pairs, axis=0)) == len(pairs)
    assert {tuple(pair) for pair in pairs.tolist()} >= {(k - back, k) for back in STEPS_BACK for k in range(back, 30)}


def test_scans_without_returns_do_not_change_the_odometry(path_of):
    keyframes, _, reckoned = walked(np.array([[(50.0, 50.0), (51.0, 50.0)]]), path_of, (0.03, 0.03, 0.01))
    np.testing.assert_allclose(aligned(keyframes, reckoned, 10.0), reckoned, atol=1e-9)


@pytest.mark.parametrize("seed", [0, 2, 4])
def test_one_wrong_match_in_six_does_not_bend_a_corridor(seed):
    random = np.random.default_rng(seed)
    truth = np.column_stack([0.5 * np.arange(60.0), np.zeros(60), np.zeros(60)])
    chain = np.array([(k - 1, k) for k in range(1, 60)])
    pairs = np.array([(k - back, k) for k in range(60) for back in STEPS_BACK if back <= k])
    motions = between(truth[chain[:, 0]], truth[chain[:, 1]]) + random.normal(size=(59, 3)) * (0.06, 0.03, 0.003)
    matches = between(truth[pairs[:, 0]], truth[pairs[:, 1]]) + random.normal(size=(len(pairs), 3)) * 0.001
    wrong = random.random(len(pairs)) < 1 / 6
    matches[wrong, 0] += random.uniform(0.0, 0.2, wrong.sum())
    known = np.tile(np.diag(1.0 / np.square([0.03, 0.03, 0.005])), (59, 1, 1))
    claimed = np.tile(np.diag(1.0 / np.square([0.005, 0.003, 0.0006])), (len(pairs), 1, 1))
    poses = truth + random.normal(size=(60, 3)) * (0.05, 0.01, 0.001) * (np.arange(60) > 0)[:, None]
    for fit in FITS:
        poses = pose_graph.optimise(
            poses, np.concatenate([chain, pairs]), np.concatenate([motions, matches]), np.concatenate([known, claimed]),
            np.arange(59 + len(pairs)) >= 59, fit,
        )  # fmt: skip
    assert np.abs(poses[:, 0] - truth[:, 0]).max() < 0.01
