"""What part of the plane pictures show: the building, and beside it the maps that lie askew, but none far away."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.records.geometry import transform_points
from twc_env.records.messages import GridMap

BESIDE_MAX = 0.3
"""Of the building's size is shown beside it at most, on each side."""
STEPS = 3
"""A view that grows does so in so many steps on each side, as one that follows every cell would never rest."""


def extent_m(building_m: Array, points_m: Array) -> Array:
    """(2, 2) lower left and upper right corner [m] of what is shown of a building and of (n, 2) points.

    building_m: its own corners, likewise. Points at NaN are left out.
    """
    beside_m = BESIDE_MAX * np.ptp(building_m, axis=0)
    points_m = np.vstack([building_m, points_m])
    low, high = np.nanmin(points_m, axis=0), np.nanmax(points_m, axis=0)
    return np.array([np.maximum(low, building_m[0] - beside_m), np.minimum(high, building_m[1] + beside_m)])


def grown_extent_m(building_m: Array, shown_m: Array, points_m: Array) -> Array:
    """The corners of `extent_m`, for a view that shows so much already: it grows in `STEPS`, and never shrinks."""
    step_m = BESIDE_MAX / STEPS * np.ptp(building_m, axis=0)
    outside_m = np.abs(extent_m(building_m, points_m) - building_m)
    beside_m = np.ceil(outside_m / step_m - 1e-9) * step_m
    return np.array([np.minimum(shown_m[0], building_m[0] - beside_m[0]),
                     np.maximum(shown_m[1], building_m[1] + beside_m[1])])  # fmt: skip


def wall_points_m(grid: GridMap, pose_building_map: Array) -> Array:
    """(n, 2) centres of the wall cells of a map, in the building frame."""
    return transform_points(np.asarray(pose_building_map, float), grid.centre_of(np.argwhere(grid.log_odds > 0)))
