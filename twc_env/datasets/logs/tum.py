"""Trajectories in the TUM format: `time x y z qx qy qz qw` per line, as evo and most SLAM tools read it."""

from __future__ import annotations

import logging
import math
from pathlib import Path

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.datasets.logs.odd_units import name_odd_units
from twc_env.datasets.logs.text_file import TextLines
from twc_env.errors import DataError
from twc_env.records.geometry import wrap_angle
from twc_env.records.whole_file import whole_file

FAR_M = 1000.0
"""Coordinates from here on (UTM) are written with fifteen digits instead of nine: to less than a micrometre."""
LEVEL_M, LEVEL_DEG = 0.5, 15.0
"""Poses within this height and tilt are taken for those of one floor: ramps and vibration stay below."""
_LOG = logging.getLogger(__name__)


def write_tum(path: str | Path, times_s: Array, poses: Array) -> None:
    """Write poses (k, 3) at times_s (k,); height, roll and pitch are 0. A name that ends in .gz is compressed.

    Raises DataError for inconsistent shapes and non-finite values.
    """
    times_s, poses = np.asarray(times_s, float), np.asarray(poses, float)
    if times_s.ndim != 1 or poses.shape != (len(times_s), 3):
        raise DataError(f"times must be (k,) and poses (k, 3); got {times_s.shape} and {poses.shape}")
    is_whole = np.isfinite(times_s) & np.isfinite(poses).all(axis=1)
    if not is_whole.all():
        raise DataError(f"times and poses must be finite; row {int(np.argmin(is_whole))} is not: remove it")
    half = poses[:, 2] / 2
    zeros = np.zeros(len(poses))
    columns = [times_s, poses[:, 0], poses[:, 1], zeros, zeros, zeros, np.sin(half), np.cos(half)]
    place = "%.9g" if np.abs(poses[:, :2]).max(initial=0.0) < FAR_M else "%.15g"
    # unix times have ten digits before the point
    with whole_file(path) as beside:
        np.savetxt(beside, np.column_stack(columns), fmt=["%.15g", place, place] + 5 * ["%.9g"])


def read_tum(path: str | Path) -> tuple[Array, Array]:
    """Times (k,) [s] and poses (k, 3) of a file; height, roll and pitch are dropped.

    Raises DataError naming the first line that is not eight numbers or whose quaternion is zero.
    """
    rows = []
    for number, line in enumerate(TextLines(path), 1):
        words = line.split("#", 1)[0].replace(",", " ").split()
        if words:
            rows.append(_row(words, path, number))
    values = np.array(rows).reshape(-1, 8)
    _name_what_is_dropped(values, path)
    turns = values[:, 4:]
    qx, qy, qz, qw = (turns / np.abs(turns).max(axis=1, initial=0.0, keepdims=True)).T  # no product overflows
    heading = np.arctan2(
        2 * (qw * qz + qx * qy), qw * qw + qx * qx - qy * qy - qz * qz
    )  # the quaternion need not be normalised
    poses = np.column_stack([values[:, 1:3], wrap_angle(heading)])
    name_odd_units(values[:, 0], poses, path)
    return values[:, 0], poses


def _name_what_is_dropped(values: Array, path: str | Path) -> None:
    """Warn of poses (k, 8) that are not in one plane."""
    heights_m = np.ptp(values[:, 3]) if len(values) else 0.0
    x, y, z, w = (values[:, 4:] / np.abs(values[:, 4:]).max(axis=1, initial=0.0, keepdims=True)).T
    tilts_rad = np.arccos(np.clip(1.0 - 2.0 * (x * x + y * y) / (x * x + y * y + z * z + w * w), -1.0, 1.0))
    tilt_deg = float(np.degrees(tilts_rad.max(initial=0.0)))
    if heights_m > LEVEL_M or tilt_deg > LEVEL_DEG:
        _LOG.warning(
            "%s: heights over %.2f m and tilts up to %.0f degrees are dropped; positions are x and y of the file",
            path, heights_m, tilt_deg,
        )  # fmt: skip


def _row(words: list[str], path: str | Path, number: int) -> list[float]:
    try:
        values = [float(word) for word in words]
    except ValueError:
        values = []
    if len(values) != 8 or not all(map(math.isfinite, values)):
        raise DataError(f"{path}, line {number}: expected 8 numbers 'time x y z qx qy qz qw'; got {' '.join(words)!r}")
    if not any(values[4:]):
        raise DataError(
            f"{path}, line {number}: the quaternion qx qy qz qw is zero, which is no rotation; remove the line"
        )
    return values
