"""Poses and times of a log in other units than metres, radians and seconds, told by what no robot does."""

from __future__ import annotations

import logging
from pathlib import Path

import numpy as np
from numpy.typing import NDArray as Array

SPEED_MAX_M_S = 10.0
"""Half of all movements are slower than this."""
TIME_BETWEEN_MAX_S, CLOCK_MAX_S = 60.0, 1e11
"""Half of all scans follow within this time; clocks of seconds since 1970 are below the second."""
_TIME_UNITS = {"milliseconds": 1e3, "microseconds": 1e6, "nanoseconds": 1e9}
_USUAL_S = 10.0
"""Time between scans up to which a unit is plausible."""
_TURNS_MAX_RAD = 6.6
"""Headings within a turn are below this, in radians."""
_AHEAD_MIN, _ASTRAY_MAX = 0.8, 0.5
"""Robots drive along their heading: mean resultant lengths in the right unit and in the wrong one."""
_WRAP_DEG, _WRAP_ERROR_DEG = 360.0, 30.0
_MOVED_M, _TIME_MIN_S, _MOVES_MIN = 0.01, 0.01, 3
_NO_CLOCK_S = 2e-3
"""No scanner or odometry of these logs is as fast; readers that need times to ascend put so much between equal ones."""
_LOG = logging.getLogger(__name__)


def name_odd_units(times_s: Array, poses: Array, path: str | Path) -> None:
    """Warn of times (k,), positions and headings (k, 3) that are hardly seconds, metres and radians."""
    if len(times_s) <= _MOVES_MIN:
        return
    between_s = np.abs(np.diff(times_s))
    ways = np.diff(poses[:, :2], axis=0)
    moved_m = np.hypot(*ways.T)
    usual_s = float(np.median(between_s))
    if usual_s > TIME_BETWEEN_MAX_S or np.abs(times_s).max() > CLOCK_MAX_S:
        fitting = (name for name, count in _TIME_UNITS.items() if usual_s <= _USUAL_S * count)
        unit = next(fitting, "nanoseconds")
        _LOG.warning(
            "%s: %.4g s from one pose to the next; times must be seconds: if they are %s, divide them by %.0e",
            path, usual_s, unit, _TIME_UNITS[unit],
        )  # fmt: skip
    if usual_s < _NO_CLOCK_S:
        _LOG.warning(
            "%s: %.2g s from one pose to the next is no clock: poses keep their order, but times that are written are "
            "made up", path, usual_s,
        )  # fmt: skip
    is_timed = between_s > _TIME_MIN_S
    is_move = is_timed & (moved_m > _MOVED_M)
    if is_timed.mean() > 0.5 and is_move.sum() >= _MOVES_MIN:
        speed_m_s = float(np.median(moved_m[is_move] / between_s[is_move]))
        if speed_m_s > SPEED_MAX_M_S:
            _LOG.warning(
                "%s: half of all movements are faster than %.4g m/s; positions must be metres: divide millimetres by "
                "1000, centimetres by 100", path, speed_m_s,
            )  # fmt: skip
    if _is_in_degrees(ways[moved_m > _MOVED_M], poses[:-1, 2][moved_m > _MOVED_M], poses[:, 2]):
        _LOG.warning(
            "%s: headings from %.4g to %.4g fit the path as degrees; they must be radians: divide them by 57.29578",
            path, poses[:, 2].min(), poses[:, 2].max(),
        )  # fmt: skip


def _is_in_degrees(ways: Array, headings_of_ways: Array, headings: Array) -> bool:
    """Whether headings beyond a turn fit the ways (k, 2) as degrees alone, or are wrapped at 180 or 360 degrees."""
    if np.abs(headings).max() <= _TURNS_MAX_RAD:
        return False
    jumps = np.abs(np.diff(headings))
    is_wrapped = np.abs(headings).max() <= _WRAP_DEG + 1.0 and (np.abs(jumps - _WRAP_DEG) < _WRAP_ERROR_DEG).any()
    if is_wrapped or len(ways) < _MOVES_MIN:
        return bool(is_wrapped)
    directions = np.arctan2(ways[:, 1], ways[:, 0])
    # Doubled angles: driving backwards is along the heading, too.
    in_radians, in_degrees = (
        abs(np.exp(2j * (directions - headings_of_ways * unit)).mean()) for unit in (1.0, np.pi / 180.0)
    )
    return bool(in_degrees > _AHEAD_MIN and in_radians < _ASTRAY_MAX)
