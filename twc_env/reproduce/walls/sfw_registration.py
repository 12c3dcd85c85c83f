"""Registration of a LiDAR picture and a walk: the similarity transform that places the path in free space near
walls."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray as Array
from scipy.ndimage import binary_dilation, distance_transform_edt, map_coordinates
from scipy.optimize import minimize
from scipy.spatial import cKDTree

_OUTSIDE_WEIGHT = 4.0
"""Weight of the distance of path points outside free space, relative to that of wall points from the path."""
_WALL_POINTS = 400
_BODY_PX = 12.0


@dataclass(frozen=True, slots=True, eq=False)
class Registration:
    """Transform from walk pixels to picture pixels: scale * rotation(angle) * p + shift."""

    scale: float
    angle_rad: float
    shift_px: Array
    free_share: float
    """Share of the path in free space."""
    wall_gap_px: float
    """Mean distance from the boundary of free space to the path, in picture pixels."""

    def apply(self, points: Array) -> Array:
        """(n, 2) walk pixels -> picture pixels (x, y)."""
        return _transform((self.scale, self.angle_rad, *self.shift_px), points)


def register(path_px: Array, free: Array) -> Registration:
    """Fit a path (n, 2) to free pixels (rows, columns), both with y running down.

    Minimises the distance of the path from free space and that of the boundary of free space from the path; the first
    alone would shrink the path. Starts from the extents of both, at several scales and angles.
    """
    # Distance outside of free space, or by which a point is closer to a wall than the centre of a robot can be.
    outside = distance_transform_edt(~free) + np.maximum(_BODY_PX - distance_transform_edt(free), 0.0)
    rim = np.argwhere(binary_dilation(~free) & free)[:, ::-1].astype(float)
    rim = rim[:: max(len(rim) // _WALL_POINTS, 1)]
    path = path_px[:: max(len(path_px) // 600, 1)]
    low, high = np.percentile(rim, [1, 99], axis=0)
    base = float(np.mean((high - low) / np.ptp(path, axis=0)))

    def cost(transform: Array) -> float:
        placed = _transform(transform, path)
        away = map_coordinates(outside, placed.T[::-1], order=1, mode="nearest")
        away += np.linalg.norm(placed - np.clip(placed, 0, np.array(free.shape)[::-1] - 1), axis=1)
        gaps = cKDTree(placed).query(rim)[0]
        return float(_OUTSIDE_WEIGHT * away.mean() + np.minimum(gaps, 100.0).mean())

    found_all = []
    for factor in (0.85, 0.92, 1.0):
        for angle in np.deg2rad([-8.0, 0.0, 8.0]):
            start = np.array([factor * base, angle, 0.0, 0.0])
            start[2:] = rim.mean(axis=0) - _transform(start, path).mean(axis=0)
            simplex = start + np.vstack([np.zeros(4), np.diag([0.05 * base, 0.05, 15.0, 15.0])])
            options = {"initial_simplex": simplex, "maxiter": 400, "xatol": 1e-3, "fatol": 1e-3}
            found = minimize(cost, start, method="Nelder-Mead", options=options)
            found_all.append(found)
    best = min(found_all, key=lambda found: found.fun)
    placed = _transform(best.x, path_px)
    at = np.clip(np.floor(placed).astype(int), 0, np.array(free.shape)[::-1] - 1)
    gap = float(cKDTree(placed).query(rim)[0].mean())
    share = float(free[at[:, 1], at[:, 0]].mean())
    return Registration(float(best.x[0]), float(best.x[1]), best.x[2:], share, gap)


def _transform(transform, points: Array) -> Array:
    scale, angle, x, y = transform
    c, s = np.cos(angle), np.sin(angle)
    return scale * points @ np.array([[c, s], [-s, c]]) + np.array([x, y])
