"""Validation of sensor frames from callers; the kernels behind it check nothing."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.errors import UNFIT, DataError
from twc_env.records.fingerprint_validation import fault_of_readings
from twc_env.records.messages import SensorFrame, SignReading, WifiScan
from twc_env.records.scanner import Scanner

JUMP_MAX_M = 1000.0
"""Largest motion between two frames; larger values are in millimetres, or positions instead of motions."""
TIME_MAX_S = 1e11
"""Three thousand years; larger values are in fractions of a second."""


def check_frames(frames: Sequence[SensorFrame], times_s: Array, beam_count: int) -> None:
    """Raise DataError for invalid frames. A range may be infinite: no return.

    times_s (robots,): time of each robot's previous frame, minus infinity before the first.
    """
    robot_count = len(times_s)
    if not isinstance(frames, Sequence) or not all(isinstance(frame, SensorFrame) for frame in frames):
        raise DataError(f"give a list of SensorFrame, one for each robot; got {_kind(frames)}")
    if not frames:
        raise DataError("no frames given: pass those of at least one robot")
    robots = [frame.robot for frame in frames]
    if len(set(robots)) < len(robots) or not all(_is_whole(k) and 0 <= k < robot_count for k in robots):
        raise DataError(f"frames of one step are of different robots 0 to {robot_count - 1}; got robots {robots}")
    for frame in frames:
        try:
            fault = _fault(frame, beam_count) or _fault_of_time(frame, float(times_s[frame.robot]))
        except UNFIT as error:
            fault = f"holds values of another kind: {error}"
        if fault:
            raise DataError(f"the frame of robot {frame.robot} in step {frame.step} {fault}")


def _kind(value: object) -> str:
    """Type of a wrong argument, for the error message; its repr could be very long."""
    held = {type(each).__name__: None for each in value} if isinstance(value, (list, tuple)) else {}
    return f"a {type(value).__name__}{' of ' + ', '.join(held) if held else ''}"


def _is_whole(value: object) -> bool:
    return isinstance(value, (int, np.integer))


def _fault(frame: SensorFrame, beam_count: int) -> str | None:
    if not _is_whole(frame.step):
        return "has a step that is not a whole number"
    if fault := _fault_of_ranges(frame, beam_count):
        return fault
    if np.shape(frame.odometry) != (3,) or not (np.abs(frame.odometry) <= JUMP_MAX_M).all():
        return f"has odometry {frame.odometry!r}: give the motion since the last frame, x [m], y [m] and turn [rad]"
    if not math.isfinite(frame.turn_rate_rad_s) or not math.isfinite(frame.time_s):
        return f"has turn rate {frame.turn_rate_rad_s!r} at time {frame.time_s!r}: both must be finite"
    if abs(frame.time_s) > TIME_MAX_S:
        return f"is of {frame.time_s:g} s, which no clock shows: times are in seconds"
    for sign in frame.signs:
        if not isinstance(sign, SignReading):
            return f"holds {sign!r} as a sign: give SignReading(text, bearing_rad, range_m)"
        if not isinstance(sign.text, str) or not math.isfinite(sign.bearing_rad) or not 0.0 <= sign.range_m < math.inf:
            return f"holds {sign!r}: give a text, a finite bearing, and a finite, non-negative range"
        if not sign.text.isascii() and any("\ud800" <= letter <= "\udfff" for letter in sign.text):
            return f"holds {sign!r}: its text has surrogates, which stand for no character; decode it anew"
    return None if frame.wifi is None else _fault_of_scan(frame.wifi)


def _fault_of_ranges(frame: SensorFrame, beam_count: int) -> str | None:
    """Error of ranges that are not as `SensorFrame` or the frame's `scanner` says."""
    beams, scanner = np.shape(frame.ranges_m), frame.scanner
    if beams == (0,):
        return None
    ranges_m = np.asarray(frame.ranges_m)
    if scanner is None:
        if beams != (beam_count,):
            return f"has ranges of shape {beams}, but lidar.beam_count is {beam_count}: set it to that of the scanner"
        if not ((ranges_m > -np.inf) & (ranges_m != 0.0)).all():
            return (
                "has ranges that are 0 or no numbers: a beam without return reads the maximum, an unseen one UNSEEN_M"
            )
        return None
    if not isinstance(scanner, Scanner):
        return f"has {scanner!r} as scanner: give a twc_env.records.scanner.Scanner"
    if len(beams) != 1 or ranges_m.dtype.kind not in "iuf":
        return f"has ranges of shape {beams} and type {ranges_m.dtype}: give one number per beam"
    turn_rad = abs(scanner.step_rad) * (beams[0] - 1)
    if not 0.0 < turn_rad <= 2.0 * math.pi + 1e-6 and beams[0] > 1:
        return (
            f"has {beams[0]} beams {scanner.step_rad:g} rad apart: they must be on one circle; give step_rad in radians"
        )
    numbers = (scanner.first_rad, *scanner.mount, scanner.range_min_m, scanner.sweep_s)
    if (
        not all(map(math.isfinite, numbers))
        or not (scanner.free_m >= 0.0 and scanner.range_max_m > 0.0)
        or len(scanner.mount) != 3
        or scanner.sweep_s < 0.0
    ):
        return f"has {scanner!r}: give finite numbers, a pose as mount, and a time above 0 as sweep_s"
    return None


def _fault_of_time(frame: SensorFrame, last_s: float) -> str | None:
    """Error if time does not advance between frames with motion: the filter would ignore that motion."""
    if frame.time_s < last_s or (frame.time_s == last_s and np.any(frame.odometry)):
        return f"is of {frame.time_s:g} s and its last one of {last_s:g} s: give frames in order, each with its time"
    return None


def _fault_of_scan(scan: WifiScan) -> str | None:
    if not isinstance(scan, WifiScan):
        return f"has {type(scan).__name__} as WiFi: give WifiScan(macs, rssi_dbm)"
    if fault := fault_of_readings(scan.macs, scan.rssi_dbm):
        return f"has a WiFi scan with {fault}"
    ages_s = scan.age_s
    if ages_s is not None and not (np.shape(ages_s) == np.shape(scan.macs) and np.isfinite(ages_s).all()):
        return f"has a WiFi scan with ages {ages_s!r}: readings have one age each [s], or none of them has"
    return None
