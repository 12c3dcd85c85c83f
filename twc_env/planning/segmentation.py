"""The known floor cut into segments at the critical points of its Voronoi graph: where the clearance has a local
minimum, as in doors (Thrun 1998; Wurm, Stachniss and Burgard, IROS 2008)."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray as Array
from scipy.ndimage import distance_transform_edt, label

from twc_env.kernels.compiled import kernel
from twc_env.planning.terrain import FREE, WALL, Terrain

DOOR_MIN_M, DOOR_MAX_M = 0.75, 1.6
"""Width of a passage that separates two segments; narrower ones are corners, too coarse in cells to tell apart."""
APART_MIN_M = 0.6
"""Cells belong to the Voronoi graph where neighbours have nearest walls at least this far apart ..."""
OPPOSITE = 1.75
"""... and this many times the clearance: on opposite sides, unlike in the corner of a room, where it is 1.4."""
WINDOW_M = 1.2
"""A critical point is the narrowest place of the graph in a square of this side."""


def segmented(terrain: Terrain) -> Array:
    """(h, w) int: the segment of each free cell of the terrain, 0 for all others."""
    cell_m, is_free = terrain.resolution_m, terrain.kind == FREE
    is_wall = terrain.kind == WALL
    if not is_wall.any():
        return label(is_free)[0]
    nearest = distance_transform_edt(~is_wall, return_distances=False, return_indices=True)
    narrow = np.full(is_free.shape, np.inf)
    _fill_graph(is_free, nearest, cell_m, narrow)
    is_cut = is_free.copy()
    _cut(narrow, nearest, max(3, round(WINDOW_M / cell_m)), is_cut)
    parts, _ = label(is_cut)
    rows, columns = distance_transform_edt(parts == 0, return_distances=False, return_indices=True)
    return np.where(is_free, parts[rows, columns], 0)


@kernel
def _fill_graph(is_free, nearest, cell_m, narrow):
    """Fill narrow (h, w) with the clearance [cells] where the Voronoi graph runs through a passage; nearest (2, h, w):
    row and column of the nearest wall of each cell."""
    height, width = narrow.shape
    for r in range(height - 1):
        for c in range(width - 1):
            clearance = _clearance(nearest, r, c)
            if not is_free[r, c] or not DOOR_MIN_M / 2 <= clearance * cell_m <= DOOR_MAX_M / 2:
                continue
            for i, j in ((r + 1, c), (r, c + 1)):
                apart = math.hypot(nearest[0, i, j] - nearest[0, r, c], nearest[1, i, j] - nearest[1, r, c])
                near_walls = min(clearance, _clearance(nearest, i, j))
                if apart >= max(APART_MIN_M / cell_m, OPPOSITE * near_walls):
                    narrow[r, c] = clearance


@kernel
def _clearance(nearest, r, c):
    return math.sqrt((nearest[0, r, c] - r) ** 2 + (nearest[1, r, c] - c) ** 2)


@kernel
def _cut(narrow, nearest, window, is_cut):
    """Take out of is_cut (h, w) the lines from each critical point to each of its nearest walls."""
    height, width = narrow.shape
    for row in range(height - 1):
        for column in range(width - 1):
            if narrow[row, column] == np.inf:
                continue
            rows = range(max(row - window // 2, 0), min(row - window // 2 + window, height))
            columns = slice(max(column - window // 2, 0), column - window // 2 + window)
            least = np.inf
            for r in rows:
                least = min(least, narrow[r, columns].min())
            if least < narrow[row, column]:
                continue
            for i, j in ((row, column), (row, column + 1), (row + 1, column), (row + 1, column + 1)):
                down, right = nearest[0, i, j] - row, nearest[1, i, j] - column
                last = 2 * max(abs(down), abs(right)) + 1
                for k in range(last + 1):
                    part = 1.0 if k == last else k * (1.0 / last)
                    r, c = int(np.rint(row + part * down)), int(np.rint(column + part * right))
                    is_cut[r, c] = is_cut[r, min(c + 1, width - 1)] = False
