"""Laser logs with the odometry errors of the Intel Lab log, at its own or at another size.

Corrected logs hold no raw odometry. An error of the Intel robot is what its raw motion from scan to scan differs by
from the corrected one; each motion of another log gets that of one of the `NEIGHBOURS` motions most like it in length
and turn, drawn at random.
"""

from __future__ import annotations

import dataclasses
from functools import cache

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.datasets.logs.scan_log import ScanLog, spaced
from twc_env.metrics import absolute_trajectory_error_m
from twc_env.records.geometry import between, compose, poses_along, wrap_angle
from twc_env.records.random_streams import random_stream
from twc_env.reproduce.logs.intel import run_engine
from twc_env.reproduce.logs.laser_logs import corrected_log, intel_log

NEIGHBOURS = 10
LENGTH_M, TURN_RAD = 0.5, 0.5
"""Differences of length and of turn that make two motions equally unlike."""
INTEL = "intel"


def drive_again(name: str, size: float, seed: int, is_noise_told: bool = True) -> dict:
    """The engine on a log with `size` times the errors of Intel's odometry: distance of its path to the corrected one,
    and that of the odometry alone.

    is_noise_told: the engine goes by the errors that the log shows, as in `twc-env replay`; else by what it assumes of
    all logs.
    """
    log = _corrected(name)
    return _driven(log, resampled(log.poses, size, seed), is_noise_told)


def drive_intel() -> dict:
    """As `drive_again`, of Intel with its own raw odometry."""
    return _driven(_corrected(INTEL), intel_log().poses, True)


def _driven(log: ScanLog, raw: Array, is_noise_told: bool) -> dict:
    found = np.array(run_engine(dataclasses.replace(log, poses=raw), 1, is_noise_told)["poses"])
    turned_deg = np.degrees(np.abs(_errors(raw, log.poses)[:, 2]))
    return {
        "ate_m": absolute_trajectory_error_m(found, log.poses),
        "odometry_ate_m": absolute_trajectory_error_m(raw, log.poses),
        "turn_error_mean_deg": float(turned_deg.mean()),
        "turn_error_max_deg": float(turned_deg.max()),
    }


def resampled(poses: Array, size: float, seed: int) -> Array:
    """(n, 3) odometry of a robot on the path of poses (n, 3), with `size` times Intel's errors."""
    motions, errors = intel_errors()
    own = between(poses[:-1], poses[1:])
    random, kinds = random_stream(seed, "resampled odometry"), _kind(motions)
    for k, kind in enumerate(_kind(own)):
        nearest = np.argpartition(((kinds - kind) ** 2).sum(axis=1), NEIGHBOURS)[:NEIGHBOURS]
        own[k] += size * errors[random.choice(nearest)]
    return compose(poses[0], poses_along(own))


@cache
def intel_errors() -> tuple[Array, Array]:
    """Motions (909, 3) from scan to scan of the Intel log, corrected, and the errors (909, 3) of its odometry."""
    corrected = _corrected(INTEL).poses
    return between(corrected[:-1], corrected[1:]), _errors(intel_log().poses, corrected)


def _errors(raw: Array, true: Array) -> Array:
    errors = between(raw[:-1], raw[1:]) - between(true[:-1], true[1:])
    errors[:, 2] = wrap_angle(errors[:, 2])
    return errors


def _kind(motions: Array) -> Array:
    return np.column_stack([np.hypot(motions[:, 0], motions[:, 1]) / LENGTH_M, motions[:, 2] / TURN_RAD])


def _corrected(name: str) -> ScanLog:
    """The scans of a log that are used, at its corrected poses."""
    if name == INTEL:
        return intel_log(is_corrected=True)
    log = corrected_log(name)
    return log.at(spaced(log))
