"""Directions of walls, from points on them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray as Array


def wall_axes(points: Array, neighbours: int) -> tuple[Array, Array]:
    """(n,) main axis of each point's nearest neighbours, in [0, pi), and how straight they lie along it [0, 1].

    points: (n, 2) [m], in any order.
    """
    from scipy.spatial import cKDTree  # slow to import, and localisation, which needs this, is rare

    _, near = cKDTree(points).query(points, min(neighbours, len(points)))
    around = points[near.reshape(len(points), -1)]
    away = around - around.mean(axis=1, keepdims=True)
    xx, yy, xy = (away[..., 0] ** 2).sum(1), (away[..., 1] ** 2).sum(1), (away[..., 0] * away[..., 1]).sum(1)
    straight = np.hypot(xx - yy, 2 * xy) / np.maximum(xx + yy, 1e-12)
    return np.asarray(0.5 * np.arctan2(2 * xy, xx - yy) % np.pi), straight
