"""The errors of a log's odometry are found by its own scans."""

import dataclasses
from itertools import pairwise

import numpy as np
import pytest

from twc_env.datasets.logs.carmen_log import read_any_log
from twc_env.datasets.logs.scan_log import ScanLog
from twc_env.datasets.sample import sample_files
from twc_env.metrics import absolute_trajectory_error_m
from twc_env.records.geometry import between, compose, poses_along, wrap_angle
from twc_env.records.messages import SensorFrame
from twc_env.replaying.inputs import Asked, ReplayInput, input_of
from twc_env.replaying.odometry_errors import (
    MOTIONS_MIN,
    OdometryErrors,
    corrected,
    errors_of,
    fitted,
    with_errors_of_log,
)
from twc_env.replaying.run import run

SCALE, SKEW_RAD, CURL_RAD_M, TURN = 0.05, -0.03, 0.06, 0.1
POSITION_STD_M, TURN_STD_RAD = 0.04, 0.03


def first_log() -> ScanLog:
    return read_any_log(sample_files().logs[0])


def worse(log: ScanLog, seed: int, size: float = 1.0) -> ScanLog:
    """The log with errors of this size added to its motions."""
    motions = between(log.poses[:-1], log.poses[1:])
    ahead, turned = motions[:, 0], motions[:, 2]
    too_much = np.column_stack([SCALE * ahead, SKEW_RAD * ahead, CURL_RAD_M * ahead + TURN * turned])
    noise = np.random.default_rng(seed).normal(0.0, [POSITION_STD_M, POSITION_STD_M, TURN_STD_RAD], motions.shape)
    return dataclasses.replace(log, poses=compose(log.poses[0], poses_along(motions + size * (too_much + noise))))


def read(log: ScanLog) -> ReplayInput:
    return input_of([log], [np.zeros(3)], Asked())


def frames_of(log: ScanLog) -> list[SensorFrame]:
    return [frame for frames in read(log).steps for frame in frames]


def told(source: ReplayInput) -> tuple[float, float]:
    rule = with_errors_of_log(source).config.slam.odometry_filter
    return rule.position_std_m, rule.turn_std_rad


def test_constant_errors_and_noise_are_told_from_outliers():
    random = np.random.default_rng(0)
    matched = np.column_stack([random.uniform(0.2, 1.0, 300), np.zeros(300), random.normal(0.0, 0.4, 300)])
    made = OdometryErrors(0, SCALE, SKEW_RAD, CURL_RAD_M, TURN, 0.0, 0.0)
    ahead = matched[:, 0] / (1.0 - SCALE)
    read = np.column_stack([ahead, SKEW_RAD * ahead, (matched[:, 2] + CURL_RAD_M * ahead) / (1.0 - TURN)])
    assert made.taken_off(read) == pytest.approx(matched)
    noisy = read + random.normal(0.0, [POSITION_STD_M, POSITION_STD_M, TURN_STD_RAD], (300, 3))
    noisy[::30, 2] += 1.0
    found = fitted(noisy, matched, np.ones(300))
    assert (found.scale, found.skew_rad) == pytest.approx((SCALE, SKEW_RAD), abs=0.01)
    assert (found.curl_rad_m, found.turn) == pytest.approx((CURL_RAD_M, TURN), abs=0.02)
    assert POSITION_STD_M < 1.2 * found.position_std_m < 1.5 * POSITION_STD_M
    assert TURN_STD_RAD < found.turn_std_rad < 2.0 * TURN_STD_RAD  # the median alone would give 1.0 times


def test_noise_of_several_steps_is_that_of_one_times_the_root_of_their_number():
    random = np.random.default_rng(1)
    read = random.normal(0.0, 0.3, (400, 3))
    apart = np.repeat([1.0, 2.0], 200)[:, None] * random.normal(0.0, 0.05, (400, 3))
    found = fitted(read, read - apart, np.repeat([1, 4], 200))
    assert found.position_std_m == pytest.approx(0.05, rel=0.1)
    assert found.turn_std_rad == pytest.approx(0.05, rel=0.1)


def test_the_engine_is_told_more_noise_where_the_odometry_has_more():
    log = first_log()
    stds = np.array([told(read(worse(log, 0, size))) for size in (0.5, 1.0, 2.0)])
    assert (np.diff(stds, axis=0) > 0.0).all()
    assert stds[2] == pytest.approx([2 * POSITION_STD_M, 2 * TURN_STD_RAD], rel=0.35)


def test_a_log_with_constant_errors_ends_as_near_as_one_without():
    log = first_log()
    poor = read(worse(log, 3))
    better = with_errors_of_log(poor)
    assert "degrees per metre ahead" in better.notes[-1]
    odometry = poses_along(np.array([frame.odometry for frames in better.steps for frame in frames[:1]])[1:])
    raw = poses_along(np.array([frame.odometry for frames in poor.steps for frame in frames[:1]])[1:])
    goal = run(read(log), read(log).config).paths()[0].estimated
    assert absolute_trajectory_error_m(odometry, goal) < 0.5 * absolute_trajectory_error_m(raw, goal)
    path = run(better, better.config).paths()[0]
    assert absolute_trajectory_error_m(path.estimated, goal) < 0.2
    assert path.odometry == pytest.approx(raw, abs=1e-6), "what is written is the odometry of the log"


def test_gyros_and_short_logs_keep_what_is_assumed():
    log = first_log()
    with_gyro = dataclasses.replace(log, turned_rad=np.unwrap(log.poses[:, 2]) + 1e-3 * log.times_s)
    assumed = with_errors_of_log(read(with_gyro))
    assert assumed.config == read(with_gyro).config and "gyro" in assumed.notes[-1]
    source = read(log.at(slice(MOTIONS_MIN // 2)))
    kept = with_errors_of_log(source)
    assert kept.config == source.config and kept.steps is source.steps
    assert "noise is assumed" in kept.notes[-1]


def test_of_scans_that_are_close_together_nothing_is_told():
    log = first_log()
    between_scans = np.repeat(log.poses, 4, axis=0)
    between_scans[:-4] += np.tile(np.arange(4) / 4, len(log.poses) - 1)[:, None] * np.repeat(
        np.column_stack([np.diff(log.poses[:, :2], axis=0), wrap_angle(np.diff(log.poses[:, 2]))]), 4, axis=0
    )
    times_s = np.interp(np.arange(4 * len(log.times_s)) / 4, np.arange(len(log.times_s)), log.times_s)
    times_s[-4:] += np.arange(4)
    dense = dataclasses.replace(log, times_s=times_s, poses=between_scans, ranges_m=np.repeat(log.ranges_m, 4, axis=0))
    assert errors_of(frames_of(log), read(log).config) is not None
    assert errors_of(frames_of(dense), read(log).config) is None


def test_turn_rates_are_those_of_the_corrected_odometry():
    (frames,) = [[frame for frames in read(first_log()).steps for frame in frames]]
    found = corrected(frames, OdometryErrors(0, 0.0, 0.0, 0.0, 0.5, 0.0, 0.0))
    turns = [frame.turn_rate_rad_s * (frame.time_s - before.time_s) for before, frame in pairwise(found)]
    assert turns == pytest.approx([0.5 * frame.odometry[2] for frame in frames[1:]])
