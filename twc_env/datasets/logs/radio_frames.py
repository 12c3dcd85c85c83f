"""Sensor frames of recordings without a laser: walks with phones, and a robot with WiFi."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.errors import DataError
from twc_env.records.array_validation import real_array, validated_rows
from twc_env.records.fingerprint_validation import validated_fingerprints
from twc_env.records.geometry import between, wrap_angle
from twc_env.records.messages import UNSEEN_M, Fingerprint, SensorFrame, WifiScan


def radio_frames(
    times_s: Array,
    reckoned: Array,
    turned_rad: Array,
    fingerprints: Sequence[Fingerprint],
    beam_count: int,
    robot: int = 0,
) -> list[SensorFrame]:
    """The sensor frames of a robot on the path of a recording, one frame per radio scan.

    Odometry is the motion between the dead-reckoned poses (n, 3) at times (n,); the turns (n - 1,), not wrapped,
    replace the gyro. All `beam_count` ranges are without information: use with `slam.cues.lidar` off. Raises DataError
    if lengths differ, times do not ascend, or a value is not finite.
    """
    times_s, turned_rad = real_array(times_s, "times"), real_array(turned_rad, "turns")
    reckoned = validated_rows(reckoned, (3,), "dead-reckoned poses")
    fingerprints = validated_fingerprints(fingerprints)
    elapsed_s = np.diff(times_s)
    if not len(times_s) == len(reckoned) == len(fingerprints) == len(turned_rad) + 1:
        raise DataError("times, poses and scans must be as many, and turns one fewer; take them from one recording")
    if not (elapsed_s > 0.0).all():
        raise DataError("the times of the scans do not ascend; sort them, or leave repeated ones out")
    if not all(np.isfinite(values).all() for values in (times_s, reckoned, turned_rad)):
        raise DataError("times, poses and turns must be finite; leave the scans of others out")
    poses = np.concatenate([reckoned[:1], reckoned])
    odometry = between(poses[:-1], poses[1:])
    odometry[1:, 2] = turned_rad + wrap_angle(odometry[1:, 2] - turned_rad)  # whole turns are taken from the gyro
    rates = np.concatenate([[0.0], turned_rad / elapsed_s])
    unseen = np.full(beam_count, UNSEEN_M)
    return [
        SensorFrame(
            robot, step, float(times_s[step] - times_s[0]), odometry[step], float(rates[step]), unseen,
            WifiScan(heard.macs, heard.rssi_dbm),
        )
        for step, heard in enumerate(fingerprints)
    ]  # fmt: skip
