"""Places between which people walk, and the way to each from everywhere."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.kernels.compiled import kernel
from twc_env.world.building.floorplan import Floorplan
from twc_env.world.motion.starts import start_places

_COUNT = 16
"""Places per building."""
_CELL_M = 0.2
_CLEARANCE_M = 0.27
"""Least distance of the ways to walls ..."""
_LEAF_M = 0.15
"""... and to open door leaves, so that nobody walks into the pocket behind one."""
_NEIGHBOURS = np.array([[0, 1], [1, 0], [0, -1], [-1, 0], [1, 1], [1, -1], [-1, 1], [-1, -1]])


@dataclass(frozen=True, slots=True, eq=False)
class Destinations:
    """The places of a building, in its home frame."""

    distances_m: Array
    """(places, rows, columns) float32 length of the shortest way from each cell to each place; infinite where there is
    none."""
    origin_m: Array
    """(2,) lower left corner of cell [0, 0]."""
    cell_m: float
    places_m: Array
    """(places, 2)."""


@lru_cache(maxsize=8)
def destinations_of(home: Floorplan, leaves: tuple[tuple[float, ...], ...] = ()) -> Destinations:
    """Places spread over the building, each as far as possible from those before it, and the ways to them.

    leaves: ends x, y, x, y [m] of the open doors."""
    candidates = start_places(home)
    if len(candidates) == 0:
        return Destinations(np.zeros((0, 1, 1), np.float32), np.zeros(2), _CELL_M, np.zeros((0, 2)))
    chosen = [candidates[0]]
    away_m = np.hypot(*(candidates - chosen[0]).T)
    while len(chosen) < min(_COUNT, len(candidates)):
        chosen.append(candidates[int(np.argmax(away_m))])
        away_m = np.minimum(away_m, np.hypot(*(candidates - chosen[-1]).T))
    low, high = home.bounds_m[:2], home.bounds_m[2:]
    columns, rows = (np.ceil((high - low) / _CELL_M).astype(int) + 1).tolist()
    row, column = np.divmod(np.arange(rows * columns), columns)
    centres = low + (np.stack([column, row], axis=1) + 0.5) * _CELL_M
    is_open = home.cells().is_free(centres) & (home.wall_index.distance_m(centres, _CLEARANCE_M) >= _CLEARANCE_M)
    for leaf in leaves:
        is_open &= _away_m(np.array(leaf), centres) > _LEAF_M
    distances = np.full((len(chosen), rows, columns), np.inf, np.float32)
    is_open = is_open.reshape(rows, columns)
    for place, field in zip(chosen, distances, strict=True):
        column, row = np.floor((place - low) / _CELL_M).astype(int).tolist()
        is_open[row, column] = True
        _spread(is_open, row, column, _CELL_M, _NEIGHBOURS, field)
    return Destinations(distances, low.copy(), _CELL_M, np.array(chosen))


def _away_m(segment: Array, points: Array) -> Array:
    """(k,) distances of points (k, 2) to a segment (4,)."""
    extent = segment[2:] - segment[:2]
    along = np.clip((points - segment[:2]) @ extent / (extent @ extent), 0.0, 1.0)
    return np.hypot(*(points - segment[:2] - along[:, None] * extent).T)


@kernel
def _spread(is_open, row, column, cell, neighbours, distances):
    """Fill distances (rows, columns) of the open cells to a cell, by label correction with a queue."""
    rows, columns = is_open.shape
    queue = np.empty(rows * columns, np.int64)
    is_queued = np.zeros(rows * columns, np.bool_)
    queue[0], first, count = row * columns + column, 0, 1
    distances[row, column] = 0.0
    while count > 0:
        at = queue[first]
        first, count = (first + 1) % queue.shape[0], count - 1
        is_queued[at] = False
        r, c = at // columns, at % columns
        for k in range(neighbours.shape[0]):
            nr, nc = r + neighbours[k, 0], c + neighbours[k, 1]
            if nr < 0 or nc < 0 or nr >= rows or nc >= columns or not is_open[nr, nc]:
                continue
            if k >= 4 and not (is_open[r, nc] and is_open[nr, c]):
                continue
            way = distances[r, c] + np.float32(cell if k < 4 else cell * math.sqrt(2.0))
            if way < distances[nr, nc] - np.float32(1e-4):
                distances[nr, nc] = way
                if not is_queued[nr * columns + nc]:
                    is_queued[nr * columns + nc] = True
                    queue[(first + count) % queue.shape[0]] = nr * columns + nc
                    count += 1
