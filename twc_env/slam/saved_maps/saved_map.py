"""A saved occupancy grid, and what of it is compared with others: points on walls, free floor, distance to walls."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray as Array
from scipy import ndimage

from twc_env.errors import MapError
from twc_env.slam.saved_maps.wall_axes import wall_axes

CELL_M = 0.1
"""Cell of the comparison; maps of coarser cells are compared at theirs."""
CELLS_MAX = 4_000_000
"""Larger maps are compared at coarser cells."""
FREE_SHARE_MIN = 0.5
"""A cell of the comparison is free if this share of the saved cells in it is, and none of them is a wall."""
WALL_POINTS_MIN = 30
"""Maps with fewer points on walls cannot be compared."""
NEIGHBOURS = 7
"""Nearest points of which a wall's direction is the main axis."""
THING_M = 0.6
"""Smaller shapes that stand free are no walls: furniture and people, which another run finds elsewhere."""


@dataclass(frozen=True, slots=True, eq=False)
class SavedMap:
    """An occupancy grid as it was saved; row 0 is the lowest y."""

    name: str
    free: Array
    """(rows, columns) bool."""
    walls: Array
    """(rows, columns) bool; cells that are neither are unknown."""
    resolution_m: float
    origin: Array = field(default_factory=lambda: np.zeros(3))
    """(3,) pose of the grid's lower left corner in the frame of the map."""


@dataclass(frozen=True, slots=True, eq=False)
class ComparedMap:
    """A saved map in its grid's frame, whose origin is the lower left corner, at the cell of the comparison."""

    cell_m: float
    free: Array
    """(rows, columns) bool."""
    wall_distance_m: Array
    """(rows, columns) float32, to the nearest point on a wall."""
    nearest: Array
    """(rows, columns) int32, the index of that point."""
    anything_m: Array
    """(rows, columns) float32, distance to the nearest occupied cell, also of what is too small for a wall."""
    points: Array
    """(n, 2) [m] on walls next to free floor, one per cell at most."""
    directions_rad: Array
    """(n,) of the wall at each point; free floor is on its left."""
    is_thin: Array
    """(n,) bool: there is free floor on both sides of the wall."""

    @property
    def centre_m(self) -> Array:
        """(2,) mean of the wall points."""
        return np.asarray(self.points.mean(axis=0))

    @property
    def free_points(self) -> Array:
        """(k, 2) centres of the free cells [m]."""
        return (np.argwhere(self.free)[:, ::-1] + 0.5) * self.cell_m

    def cells_of(self, points: Array) -> tuple[Array, Array, Array]:
        """Rows and columns (n,) of points (n, 2), clipped to the grid, and whether they lie in it."""
        column, row = np.floor(points / self.cell_m).astype(np.int64).T
        rows, columns = self.free.shape
        is_inside = (row >= 0) & (row < rows) & (column >= 0) & (column < columns)
        return np.clip(row, 0, rows - 1), np.clip(column, 0, columns - 1), is_inside


def cell_of(maps: list[SavedMap]) -> float:
    """Cell [m] at which these maps are compared: that of the coarsest, at least CELL_M."""
    largest_m2 = max(saved.free.size * saved.resolution_m**2 for saved in maps)
    return max(CELL_M, *(saved.resolution_m for saved in maps), float(np.sqrt(largest_m2 / CELLS_MAX)))


@lru_cache(maxsize=16)
def compared(saved: SavedMap, cell_m: float) -> ComparedMap:
    """The map at cells of `cell_m`, which is at least its resolution. Raises MapError for a map with hardly a wall."""
    # A wall's surface, whatever the thickness it is drawn with: its cells beside free floor.
    walls = saved.walls & ~_things(saved.walls, saved.resolution_m)
    surface = walls & ndimage.binary_dilation(saved.free, np.ones((3, 3)))
    rows, columns = (int(np.ceil(n * saved.resolution_m / cell_m - 1e-9)) for n in saved.free.shape)
    points = _thinned((np.argwhere(surface)[:, ::-1] + 0.5) * saved.resolution_m, cell_m)
    if len(points) < WALL_POINTS_MIN:
        raise MapError(
            f"{saved.name} shows {len(points) * cell_m:.1f} m of wall beside free floor, too little to be compared; "
            "check its thresholds, or map more of the building"
        )
    free_count, wall_count = (_binned(mask, saved.resolution_m / cell_m, rows, columns) for mask in
                              (saved.free, saved.walls))  # fmt: skip
    per_cell = (cell_m / saved.resolution_m) ** 2
    free = (free_count >= FREE_SHARE_MIN * per_cell) & (wall_count == 0)
    holds_point = np.zeros((rows, columns), bool)
    column, row = np.minimum((points / cell_m).astype(np.int64), [columns - 1, rows - 1]).T
    holds_point[row, column] = True
    owner = np.zeros((rows, columns), np.int32)
    owner[row, column] = np.arange(len(points))
    directions, is_thin = _facing(points, wall_axes(points, NEIGHBOURS)[0], free, cell_m)
    distance, (near_row, near_column) = ndimage.distance_transform_edt(~holds_point, return_indices=True)
    return ComparedMap(
        cell_m=cell_m,
        free=free,
        wall_distance_m=(distance * cell_m).astype(np.float32),
        nearest=owner[near_row, near_column],
        anything_m=(ndimage.distance_transform_edt(wall_count == 0) * cell_m).astype(np.float32),
        points=points,
        directions_rad=directions,
        is_thin=is_thin,
    )


def _things(walls: Array, resolution_m: float) -> Array:
    """(rows, columns) bool: cells of shapes up to THING_M that touch no others, even over a gap of two cells."""
    labels, count = ndimage.label(ndimage.binary_dilation(walls, np.ones((3, 3))), np.ones((3, 3)))
    is_small = np.zeros(count + 1, bool)
    for number, box in enumerate(ndimage.find_objects(labels), 1):
        is_small[number] = max(side.stop - side.start for side in box) * resolution_m <= THING_M + 2 * resolution_m
    return np.asarray(walls & is_small[labels])


def _binned(mask: Array, ratio: float, rows: int, columns: int) -> Array:
    """(rows, columns) counts of the cells of a finer grid; ratio: of its cells to the new ones."""
    row, column = np.floor((np.argwhere(mask) + 0.5) * ratio).astype(np.int64).T
    return np.bincount(row * columns + column, minlength=rows * columns).reshape(rows, columns)


def _thinned(points: Array, cell_m: float) -> Array:
    """The mean of the points (n, 2) of each cell."""
    if not len(points):
        return points
    _, cell, count = np.unique(np.floor(points / cell_m), axis=0, return_inverse=True, return_counts=True)
    cell = cell.ravel()
    return np.column_stack([np.bincount(cell, points[:, axis]) / count for axis in range(2)])


def _facing(points: Array, directions_rad: Array, free: Array, cell_m: float) -> tuple[Array, Array]:
    """Directions (n,) with the free floor on their left, and whether it is on both sides."""
    normal = np.column_stack([-np.sin(directions_rad), np.cos(directions_rad)])
    counts = []
    for side in (1, -1):
        count = np.zeros(len(points), np.int64)
        for step in (1.0, 1.5, 2.0):
            column, row = np.floor((points + side * step * cell_m * normal) / cell_m).astype(np.int64).T
            is_inside = (row >= 0) & (row < free.shape[0]) & (column >= 0) & (column < free.shape[1])
            count += is_inside & free[np.clip(row, 0, free.shape[0] - 1), np.clip(column, 0, free.shape[1] - 1)]
        counts.append(count)
    return np.where(counts[0] >= counts[1], directions_rad, directions_rad - np.pi), np.minimum(*counts) >= 2
