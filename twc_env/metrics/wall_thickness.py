"""Thickness of the walls of a map, which ghost walls increase."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.errors import DataError
from twc_env.metrics.mapping import validated_grid
from twc_env.records.array_validation import real_array
from twc_env.records.geometry import transform_points

STRETCH_M, SAMPLE_M = 0.25, 0.05
"""Length of the segments by which walls are known or not, and the spacing of samples on walls."""


def wall_thickness_m(
    log_odds: Array, origin_m: Array, resolution_m: float, pose_building_map: Array, walls_m: Array,
    reach_m: float = 1.0, wall_above: int = 0,
) -> float:  # fmt: skip
    """Mean thickness of the walls that a map shows; ghost walls increase it (papers.md T21).

    Each occupied cell belongs to the nearest true wall within `reach_m`; the area of these cells is divided by the
    length of all wall segments (STRETCH_M) that own a cell. walls_m (k, 2, 2) in the building frame; other arguments as
    in `score_map`. A sharp map of thin walls gives one to two cells. NaN if no wall is shown. Raises
    DataError for other shapes.
    """
    from scipy.spatial import cKDTree  # slow to import, needed only here

    walls_m, log_odds = real_array(walls_m, "walls_m"), validated_grid(log_odds, "log_odds")
    if walls_m.ndim != 3 or walls_m.shape[1:] != (2, 2):
        raise DataError(f"walls_m must have shape (walls, 2, 2), both ends of each; got {walls_m.shape}")
    samples, stretches, spacings_m = _sampled_walls(walls_m)
    rows, columns = np.nonzero(log_odds > wall_above)
    if not len(rows) or not len(samples):
        return float("nan")
    centres = np.asarray(origin_m) + (np.stack([columns, rows], axis=1) + 0.5) * resolution_m
    away, nearest = cKDTree(samples).query(transform_points(pose_building_map, centres), distance_upper_bound=reach_m)
    owned = np.isfinite(away)
    known_m = float(spacings_m[np.isin(stretches, stretches[nearest[owned]])].sum())
    return float(owned.sum()) * resolution_m**2 / known_m if known_m else float("nan")


def _sampled_walls(walls_m: Array) -> tuple[Array, Array, Array]:
    """Points along all walls (n, 2), the segment number of each (n,), and the wall length it represents (n,)."""
    begin, along = walls_m[:, 0], walls_m[:, 1] - walls_m[:, 0]
    length = np.hypot(along[:, 0], along[:, 1])
    counts = np.maximum(np.round(length / SAMPLE_M).astype(np.int64), 1)
    wall = np.repeat(np.arange(len(walls_m)), counts)
    share = (np.arange(len(wall)) - (np.cumsum(counts) - counts)[wall] + 0.5) / counts[wall]
    stretch = (share * length[wall] / STRETCH_M).astype(np.int64)
    is_new = np.append(True, (np.diff(wall) != 0) | (np.diff(stretch) != 0))[: len(wall)]
    return begin[wall] + share[:, None] * along[wall], np.cumsum(is_new), (length / counts)[wall]
