"""Rasterisation of a floor plan into free and wall cells."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.errors import MapError
from twc_env.kernels.compiled import kernel

CELLS_MAX = 25_000_000
"""Maximum cells of a raster: 500 x 500 m at 0.1 m."""


@dataclass(frozen=True, slots=True, eq=False)
class Cells:
    """Raster of a building; row 0 has the least y. A cell is free, wall or neither (outside)."""

    free: Array
    """(rows, columns) bool: not wall and connected to an interior point."""
    wall: Array
    """(rows, columns) bool: the centre lies within half a cell of a wall."""
    origin_m: Array
    """(2,) lower left corner of cell [0, 0]."""
    resolution_m: float
    unscored: Array | None = None
    """(rows, columns) bool: floor covered by what the plan does not have, taken out of `free`; None: nothing."""

    def centre_of(self, cells: Array) -> Array:
        """(..., 2) integer (row, column) -> (..., 2) cell centres [m]."""
        return self.origin_m + (np.asarray(cells)[..., ::-1] + 0.5) * self.resolution_m

    def is_free(self, points_m: Array) -> Array:
        """(..., 2) points [m] -> (...) bool; False outside the raster."""
        at = np.floor((np.asarray(points_m, float) - self.origin_m) / self.resolution_m)
        inside = np.all((at >= 0) & (at < self.free.shape[::-1]), axis=-1)
        column, row = (np.where(inside, at[..., axis], 0).astype(np.int64) for axis in (0, 1))
        return inside & self.free[row, column]


def rasterise(name: str, walls_m: Array, interior_m: Array, resolution_m: float) -> Cells:
    """The raster of walls_m (walls, 2, 2); cells connected to the interior points (k, 2) are free.

    Raises MapError if the map (`name`) is too large or not closed.
    """
    ends = walls_m.reshape(-1, 2)
    (low_x, low_y), (high_x, high_y) = ends.min(axis=0), ends.max(axis=0)
    # The outermost walls, and all walls at a multiple of the cell size from them, pass through cell centres.
    origin = np.array([low_x, low_y]) - 1.5 * resolution_m
    columns, rows = (np.round((np.array([high_x, high_y]) - origin) / resolution_m + 2.0).astype(int)).tolist()
    if rows * columns > CELLS_MAX:
        raise MapError(
            f"map {name!r} spans {high_x - low_x:.0f} x {high_y - low_y:.0f} m, too large for cells of "
            f"{resolution_m:g} m ({CELLS_MAX} at most); check its unit, or use larger cells"
        )
    wall = np.zeros((rows, columns), np.bool_)
    _draw_walls(walls_m.reshape(-1, 4), origin, resolution_m, wall)
    free = np.zeros((rows, columns), np.bool_)
    seeds = np.floor((interior_m - origin) / resolution_m).astype(np.int64)
    leaks = _flood_fill(wall, seeds, free)
    if leaks:
        raise MapError(
            f"map {name!r} is not closed: its free space reaches the edge of the drawing; "
            "close the outer wall, or move the interior points inside"
        )
    for array in (wall, free):
        array.flags.writeable = False
    return Cells(free, wall, origin, resolution_m)


@kernel
def _draw_walls(walls, origin, resolution, wall):
    """Mark the cells of wall (rows, columns) whose centre lies within half a cell of a wall (walls, 4)."""
    rows, columns = wall.shape
    reach = 0.5 * resolution * (1.0 + 1e-6)
    for w in range(walls.shape[0]):
        ax, ay = walls[w, 0] - origin[0], walls[w, 1] - origin[1]
        bx, by = walls[w, 2] - origin[0], walls[w, 3] - origin[1]
        ex, ey = bx - ax, by - ay
        length2 = ex * ex + ey * ey
        r0 = max(int((min(ay, by) - reach) / resolution), 0)
        r1 = min(int((max(ay, by) + reach) / resolution), rows - 1)
        for r in range(r0, r1 + 1):
            y = (r + 0.5) * resolution
            # Columns near the part of the wall that lies in this row.
            t0, t1 = 0.0, 1.0
            if abs(ey) > 1e-9:
                ta, tb = (y - resolution - ay) / ey, (y + resolution - ay) / ey
                t0, t1 = max(t0, min(ta, tb)), min(t1, max(ta, tb))
                if t1 < t0:
                    continue
            xa, xb = ax + t0 * ex, ax + t1 * ex
            c0 = max(int((min(xa, xb) - resolution) / resolution), 0)
            c1 = min(int((max(xa, xb) + resolution) / resolution), columns - 1)
            for c in range(c0, c1 + 1):
                x = (c + 0.5) * resolution
                t = min(max(((x - ax) * ex + (y - ay) * ey) / length2, 0.0), 1.0)
                dx, dy = x - ax - t * ex, y - ay - t * ey
                if dx * dx + dy * dy <= reach * reach:
                    wall[r, c] = True


@kernel
def _flood_fill(wall, seeds, free):
    """Flood-fill `free` from seeds (k, 2: column, row); whether it reaches the edge of the raster."""
    rows, columns = wall.shape
    stack = np.empty(rows * columns, np.int32)
    leaks = False
    for k in range(seeds.shape[0]):
        c, r = seeds[k, 0], seeds[k, 1]
        if r < 0 or r >= rows or c < 0 or c >= columns or wall[r, c] or free[r, c]:
            continue
        free[r, c] = True
        stack[0] = r * columns + c
        size = 1
        while size > 0:
            size -= 1
            r, c = stack[size] // columns, stack[size] % columns
            if r == 0 or c == 0 or r == rows - 1 or c == columns - 1:
                leaks = True
                continue
            for step in range(4):
                nr = r + (step == 0) - (step == 1)
                nc = c + (step == 2) - (step == 3)
                if not wall[nr, nc] and not free[nr, nc]:
                    free[nr, nc] = True
                    stack[size] = nr * columns + nc
                    size += 1
    return leaks
