"""Odometry that begins anew in the middle of a log, as after a restart of its driver."""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.datasets.logs.odd_units import SPEED_MAX_M_S
from twc_env.datasets.logs.scan_log import ScanLog
from twc_env.records.geometry import between, compose

JUMP_MIN_M = 2.0
"""No robot moves so far between two scans, faster than `SPEED_MAX_M_S`."""
_CLOCK_MIN_S = 0.01
"""Half of all scans are further apart, or the log has no clock to tell speeds by."""


def restarts_of(log: ScanLog) -> Array:
    """Numbers of the scans to which the poses jump; none where poses are no metres or times no seconds."""
    if len(log.times_s) < 2:
        return np.zeros(0, int)
    between_s, moved_m = np.diff(log.times_s), np.hypot(*np.diff(log.poses[:, :2], axis=0).T)
    is_fast = moved_m > SPEED_MAX_M_S * between_s
    if np.median(between_s) < _CLOCK_MIN_S or is_fast.mean() > 0.5:
        return np.zeros(0, int)
    return np.flatnonzero(is_fast & (moved_m > JUMP_MIN_M)) + 1


def rejoined(log: ScanLog, restarts: Array) -> ScanLog:
    """The log with its path in one piece: at each jump the robot moves as it did just before."""
    motions = between(log.poses[:-1], log.poses[1:])
    motions[restarts - 1] = 0.0
    for restart in restarts[restarts > 1]:
        motions[restart - 1] = motions[restart - 2]
    poses = log.poses.copy()
    for first, last in zip(restarts, [*restarts[1:], len(poses)], strict=True):
        begin = compose(poses[first - 1], motions[first - 1])
        poses[first:last] = compose(begin, between(log.poses[first], log.poses[first:last]))
    return dataclasses.replace(log, poses=poses)
