"""Pedestrian dead reckoning with a phone: steps from the accelerometer, headings from the rotation vector.

A step is a peak of the smoothed acceleration; its length is proportional to the fourth root of the vertical swing
(Weinberg 2002). The heading is the direction of the upper edge of the phone in the frame of its compass: it is
absolute, but affected by magnetic disturbance and by the angle at which the phone is held.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray as Array
from scipy.ndimage import uniform_filter1d
from scipy.signal import find_peaks

from twc_env.datasets.surveys import phone_hearing
from twc_env.datasets.surveys.indoor20 import numbers_in, trace_paths, trace_rows
from twc_env.errors import DataError
from twc_env.records.geometry import wrap_angle
from twc_env.records.messages import Fingerprint

SMOOTHING_S = 0.16
STEP_PERIOD_MIN_S = 0.33
SWING_MIN_M_S2 = 1.2
"""Minimum prominence of a peak that counts as a step."""
WEINBERG_FACTOR = 0.38
"""Step length [m] over the fourth root of the swing [m/s2], for a phone held in front; varies by 10 % between people.
Its mean was set on floor site1_B1 of indoor20."""


@dataclass(frozen=True, slots=True, eq=False)
class WalkerTrace:
    """One recording: scans (n) with dead-reckoned poses in the walker's own frame, and surveyed positions for
    scoring."""

    name: str
    time_s: Array
    """(n,) unix time in the middle of each scan."""
    reckoned: Array
    """(n, 3) poses from the origin; x points east according to the compass."""
    turned_rad: Array
    """(n - 1,) turn between scans, not wrapped."""
    fingerprints: tuple[Fingerprint, ...]
    surveyed_m: Array
    """(n, 2) interpolated between the surveyed waypoints."""


def steps(time_s: Array, acceleration: Array) -> tuple[Array, Array]:
    """Times (s,) and lengths [m] (s,) of the steps in acceleration (k, 3) [m/s2] at times (k,) [s].

    Raises DataError if times do not ascend.
    """
    size = np.linalg.norm(acceleration, axis=1)
    period_s = float(np.median(np.diff(time_s)))
    if not period_s > 0.0:
        raise DataError("the times of the acceleration do not ascend; record it again")
    smooth = uniform_filter1d(size, max(1, round(SMOOTHING_S / period_s)))
    peaks, _ = find_peaks(smooth, distance=max(1, round(STEP_PERIOD_MIN_S / period_s)), prominence=SWING_MIN_M_S2)
    if not len(peaks):
        return np.zeros(0), np.zeros(0)
    edges = np.concatenate([[0], (peaks[1:] + peaks[:-1]) // 2, [len(smooth)]])
    swing = np.array([smooth[p] - smooth[a:b].min() for p, a, b in zip(peaks, edges, edges[1:], strict=False)])
    return time_s[peaks], WEINBERG_FACTOR * swing**0.25


def headings_rad(rotation_vector: Array) -> Array:
    """(k,) horizontal direction of the upper edge of the phone, 0 is east, from rotation vectors (k, 3)."""
    x, y, z = np.asarray(rotation_vector, float).T
    w = np.sqrt(np.maximum(0.0, 1.0 - x * x - y * y - z * z))
    return np.arctan2(1.0 - 2.0 * (x * x + z * z), 2.0 * (x * y - z * w))


def dead_reckoning(
    step_time_s: Array, step_length_m: Array, time_s: Array, heading_rad: Array, at_s: Array
) -> tuple[Array, Array]:
    """Poses (n, 3) at times (n,), and turns between them (n - 1,) not wrapped.

    Positions are interpolated within each step. Headings (k,) belong to times (k,).
    """
    unwrapped = np.unwrap(heading_rad)
    at_step = np.interp(step_time_s, time_s, unwrapped)
    moved = step_length_m[:, None] * np.column_stack([np.cos(at_step), np.sin(at_step)])
    path = np.concatenate([np.zeros((1, 2)), np.cumsum(moved, axis=0)])
    times = np.concatenate([[min([time_s[0], *step_time_s[:1]])], step_time_s])
    position = np.column_stack([np.interp(at_s, times, path[:, k]) for k in (0, 1)])
    heading = np.interp(at_s, time_s, unwrapped)
    return np.column_stack([position, wrap_angle(heading)]), np.diff(heading)


def read_walks(folder: str | Path, traces_max: int | None = None) -> list[WalkerTrace]:
    """All traces of one floor of indoor20 with at least two scans. Numbers of radios are common to all traces.

    Raises DataError for a folder without traces and for invalid lines.
    """
    traces = [trace for path in trace_paths(folder, traces_max) if (trace := _read_walk(path)) is not None]
    if not traces:
        raise DataError(f"{folder} holds no trace with two scans; check the path")
    return traces


def _read_walk(path: Path) -> WalkerTrace | None:
    marks, heard, accelerations, rotations = trace_rows(path, "WAYPOINT", "WIFI", "ACCELEROMETER", "ROTATION_VECTOR")
    waypoints = numbers_in(path, marks, 0, 2, 3)
    acceleration, rotation = numbers_in(path, accelerations, 0, 2, 3, 4), numbers_in(path, rotations, 0, 2, 3, 4)
    numbers_in(path, heard, 0, 4, 5, 6)
    try:
        at_s, prints = phone_hearing.fingerprints(heard)
    except (ValueError, IndexError, OverflowError) as error:
        raise DataError(f"{path}: {error}; fetch the trace again") from error
    if len(waypoints) < 2 or len(acceleration) < 10 or len(rotation) < 2:
        return None
    for table in (waypoints, acceleration, rotation):
        table[:, 0] /= 1000  # unix time in milliseconds
    inside = (at_s >= waypoints[0, 0]) & (at_s <= waypoints[-1, 0])
    at_s, prints = at_s[inside], [p for p, keep in zip(prints, inside, strict=True) if keep]
    if len(at_s) < 2:
        return None
    step_time, step_length = steps(acceleration[:, 0], acceleration[:, 1:])
    heading = headings_rad(rotation[:, 1:])
    reckoned, turned = dead_reckoning(step_time, step_length, rotation[:, 0], heading, at_s)
    surveyed = np.column_stack([np.interp(at_s, waypoints[:, 0], waypoints[:, k]) for k in (1, 2)])
    return WalkerTrace(path.name.split(".")[0], at_s, reckoned, turned, tuple(prints), surveyed)
