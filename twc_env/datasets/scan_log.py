"""Logs of one robot's laser scans with poses, and hand-verified relations between them (Freiburg SLAM benchmark).

A log is JSON {"map": {"<unix seconds>": {"range": [metres], "x": m, "y": m, "theta": rad}}}; relations are text lines
`t1 t2 dx dy dz roll pitch yaw`: the pose at t2 in the frame of the pose at t1. Both may be gzipped.
"""

from __future__ import annotations

import gzip
import json
import zlib
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from twc_env.errors import DataError

Array = NDArray

TIME_TOLERANCE_S = 0.02
"""A relation belongs to a scan that was taken this close to its time."""


@dataclass(frozen=True, slots=True, eq=False)
class ScanLog:
    """Scans in the order they were taken."""

    times_s: Array
    """(scans,) unix time, ascending."""
    poses: Array
    """(scans, 3) x, y [m] and heading [rad] that the log holds: raw odometry or corrected."""
    ranges_m: Array
    """(scans, beams)."""


@dataclass(frozen=True, slots=True, eq=False)
class Relations:
    """Measured poses between pairs of scans."""

    first: Array
    """(relations,) scan numbers."""
    second: Array
    """(relations,) scan numbers, of other scans."""
    pose_first_second: Array
    """(relations, 3)."""


def read_scan_log(path: str | Path) -> ScanLog:
    """Read a log. Raises DataError for files that are missing, cut off, or hold something else."""
    try:
        scans = json.loads(_text(path))["map"]
        times = sorted(scans, key=float)
        return ScanLog(
            times_s=np.array(times, float),
            poses=np.array([[scans[t][key] for key in ("x", "y", "theta")] for t in times], float).reshape(-1, 3),
            ranges_m=np.array([scans[t]["range"] for t in times], float),
        )
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise DataError(
            f"{path} is no scan log: {_short(error)}; expected map -> time -> range, x, y, theta"
        ) from error


def read_relations(path: str | Path, log: ScanLog, tolerance_s: float = TIME_TOLERANCE_S) -> Relations:
    """The relations between two different scans of the log. Raises DataError for anything but lines of 8 numbers."""
    try:
        rows = np.array([line.split() for line in _text(path).splitlines() if line.strip()], float)
        times, values = rows[:, :2], rows[:, [2, 3, 7]]
    except (ValueError, IndexError) as error:
        raise DataError(f"{path} holds no relations: {_short(error)}; expected lines of 8 numbers") from error
    scans = np.stack([_nearest(log.times_s, times[:, end]) for end in (0, 1)])
    found = np.all(np.abs(log.times_s[scans] - times.T) <= tolerance_s, axis=0) & (scans[0] != scans[1])
    if not found.any():
        raise DataError(
            f"none of the {len(rows)} relations of {path} belongs to a scan of the log; wrong pair of files"
        )
    return Relations(scans[0][found], scans[1][found], values[found])


def _nearest(times_s: Array, wanted_s: Array) -> Array:
    after = np.clip(np.searchsorted(times_s, wanted_s), 1, len(times_s) - 1)
    return np.where(wanted_s - times_s[after - 1] < times_s[after] - wanted_s, after - 1, after)


def _text(path: str | Path) -> str:
    try:
        raw = Path(path).read_bytes()
        return (gzip.decompress(raw) if Path(path).suffix == ".gz" else raw).decode()
    except (OSError, EOFError, zlib.error, UnicodeDecodeError) as error:
        raise DataError(f"cannot read {path}: {_short(error)}; check the path or fetch the file again") from error


def _short(error: Exception) -> str:
    return str(getattr(error, "strerror", None) or error)[:120]
