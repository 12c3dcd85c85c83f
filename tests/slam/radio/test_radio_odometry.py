"""Online correction of odometry by radio: keyframes in the synthetic world of `test_radio_slam`."""

import numpy as np
import pytest

from tests.slam.radio.test_radio_slam import made_log
from twc_env.config import RadioSlamConfig
from twc_env.metrics.trajectory import absolute_trajectory_error_m
from twc_env.records.geometry import poses_along
from twc_env.records.messages import Fingerprint, Keyframe
from twc_env.slam.pose_graph.solver import Graph
from twc_env.slam.radio import radio_slam
from twc_env.slam.radio.radio_constraints import RadioConstraints
from twc_env.slam.radio.radio_odometry import GROWTH, RadioOdometry

SILENCE = Fingerprint(np.zeros(0, np.int64), np.zeros(0))


def keyframes(log) -> list[Keyframe]:
    motions = np.concatenate([np.zeros((1, 3)), log.motions])
    parts = zip(motions, log.odometry, log.travel_m, log.fingerprints, strict=True)
    return [
        Keyframe(0, k, k, float(k), pose, motion, np.eye(3), float(travel_m), np.zeros(0), (), heard)
        for k, (motion, pose, travel_m, heard) in enumerate(parts)
    ]


def tied(log, has_laser: bool, is_last: bool = False) -> np.ndarray:
    """Poses (n, 3) of one robot along a log, corrected whenever due."""
    ties, count = RadioConstraints(RadioSlamConfig(), 1, has_laser), len(log.fingerprints)
    chain = np.column_stack([np.arange(count - 1), np.arange(1, count)])
    information = np.tile(np.diag([400.0, 400.0, 1e4]), (count - 1, 1, 1))
    poses = log.odometry[:1]
    for k, keyframe in enumerate(keyframes(log)):
        if k:
            poses = np.concatenate([poses, log.odometry[k : k + 1]])
        if ties.add(keyframe) or k == count - 1:
            graph = Graph(chain[:k], log.motions[:k], information[:k], np.zeros(k, bool))
            poses = ties.fit((0,), graph, log.odometry[: k + 1], {(0, n): n for n in range(k + 1)}, 0, is_last)
    return poses


@pytest.fixture(scope="module")
def log_and_truth():
    return made_log()


def test_without_laser_radio_corrects_the_odometry(log_and_truth):
    log, truth = log_and_truth
    by_odometry, by_ties, right = (
        absolute_trajectory_error_m(poses, truth) for poses in (log.odometry, tied(log, True), tied(log, False))
    )
    assert by_odometry > 10.0 and by_ties > 0.5 * by_odometry
    assert right < 0.1 * by_odometry


def test_the_final_path_equals_that_of_offline_radio_slam(log_and_truth):
    log, _ = log_and_truth
    own = RadioOdometry(RadioSlamConfig())
    for keyframe in keyframes(log):
        own.add(keyframe)
    own.solve(is_last=True)
    solved = radio_slam.solve(log, RadioSlamConfig())
    assert own.is_corrected
    assert poses_along(own.motions) == pytest.approx(
        solved.poses, abs=1e-4
    )  # far below the steps at which the solver stops


def test_longer_paths_are_solved_less_often(log_and_truth, monkeypatch):
    log, _ = log_and_truth
    lengths_m = []
    solve = radio_slam.solve
    monkeypatch.setattr(radio_slam, "solve", lambda log, *rule: lengths_m.append(log.travel_m[-1]) or solve(log, *rule))
    own = RadioOdometry(RadioSlamConfig())
    for keyframe in keyframes(log):
        own.add(keyframe)
        if own.is_due:
            own.solve()
    assert 4 <= len(lengths_m) <= 10
    assert (np.diff(lengths_m) > 0.9 * (GROWTH - 1.0) * np.array(lengths_m[:-1])).all()


def test_without_readings_the_odometry_is_unchanged(log_and_truth):
    log, _ = log_and_truth
    silent = radio_slam.RadioLog(log.motions, log.turned_rad, [SILENCE] * len(log.fingerprints))
    assert tied(silent, False, is_last=True) == pytest.approx(log.odometry, abs=1e-9)
    own = RadioOdometry(RadioSlamConfig())
    for keyframe in keyframes(silent):
        own.add(keyframe)
    own.solve()
    assert not own.is_corrected and own.motions == pytest.approx(log.motions, abs=1e-9)


def test_of_paths_over_a_kilometre_only_the_end_is_solved(log_and_truth):
    log, _ = log_and_truth
    own = RadioOdometry(RadioSlamConfig())
    last = keyframes(log)[0]
    for k in range(3):
        far = Keyframe(0, k, k, float(k), last.pose_odom, last.motion, np.eye(3), 800.0 * k, np.zeros(0), (), SILENCE)
        own.add(far)
        assert own.is_due == (k == 1)
        if own.is_due:
            own.solve()
    assert not own.is_due
