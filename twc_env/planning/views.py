"""Views on an estimated map: how much unknown floor a scan from a place would show, and random trees in free space."""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.kernels.compiled import kernel
from twc_env.planning.terrain import UNKNOWN, WALL, Terrain

WALL_MARK, NO_MARK = -2, -1
"""In a map of marks: walls, and cells that never count. Unknown cells have the number of the scan that last saw them.
"""


@kernel
def _fill_marks(kind, margin, closes_walls, marks):
    """Fill marks (h, w) with the kinds of a map in its middle; with closes_walls, also the cells right of, below and
    diagonally below walls become walls."""
    height, width = kind.shape
    for r in range(height):
        for c in range(width):
            if kind[r, c] != UNKNOWN:
                marks[r + margin, c + margin] = WALL_MARK if kind[r, c] == WALL else NO_MARK
    if closes_walls:
        for r in range(height):
            for c in range(width):
                if kind[r, c] == WALL:
                    marks[r + margin : r + margin + 2, c + margin : c + margin + 2] = WALL_MARK


@kernel
def _count_unknown(marks, place_row, place_column, directions, reach, number):
    """Unknown cells on rays of length `reach` [cells] from a place, each once; rays end at walls.

    directions (beams, 2): down, right; the cells found are marked with the number, those marked `NO_MARK` do not count.
    """
    height, width = marks.shape
    found = 0
    for b in range(directions.shape[0]):
        dr, dc = directions[b, 0], directions[b, 1]
        for k in range(1, reach + 1):
            r, c = math.floor(place_row + k * dr), math.floor(place_column + k * dc)
            if r < 0 or c < 0 or r >= height or c >= width:
                break
            mark = marks[np.uint64(r), np.uint64(c)]
            if mark == WALL_MARK:
                break
            if mark != number and mark != NO_MARK:
                marks[np.uint64(r), np.uint64(c)] = number
                found += 1
    return found


@kernel
def _count_each(marks, cells, directions, reach, number, counts):
    """Fill counts (k,) with `_count_unknown` at cells (k, 2: row, column), by scans with numbers from `number` on."""
    for i in range(cells.shape[0]):
        counts[i] = _count_unknown(marks, cells[i, 0], cells[i, 1], directions, reach, number + i)


@lru_cache(maxsize=4)
def _directions(beams: int) -> Array:
    """(beams, 2) sine and cosine of the angles of beams all around."""
    angles = [2.0 * math.pi * b / beams for b in range(beams)]
    return np.array([(math.sin(angle), math.cos(angle)) for angle in angles])


class ViewGain:
    """Unknown area that scans from places would show; what is outside the known part of the map does not count.

    Unknown cells are taken for free, as no wall is known there (Burgard et al. 2005; Gonzalez-Banos and Latombe 2002).
    """

    def __init__(self, terrain: Terrain, range_m: float, beams: int = 90, closes_walls: bool = False):
        """closes_walls: rays do not pass between wall cells that touch at a corner, as those of walls that do not run
        along the grid do."""
        self._terrain, self._reach, self._directions = terrain, range_m / terrain.resolution_m, _directions(beams)
        self._margin = math.ceil(self._reach)
        height, width = terrain.kind.shape
        self._marks = np.zeros((height + 2 * self._margin, width + 2 * self._margin), np.int32)
        _fill_marks(terrain.kind, self._margin, closes_walls, self._marks)
        self._number = 0

    def claim(self, place_m: Array) -> None:
        """Do not count from now on what a scan from this place would show: another robot goes there."""
        row, column = self._terrain.to_cells(place_m) + self._margin
        _count_unknown(self._marks, row, column, self._directions, int(self._reach), NO_MARK)

    def area_m2(self, places_m: Array) -> Array:
        """(k,) unclaimed unknown area [m2] that a scan from each of places_m (k, 2) would show."""
        cells = np.ascontiguousarray(self._terrain.to_cells(places_m) + self._margin, dtype=float)
        counts = np.zeros(len(cells), np.int64)
        _count_each(self._marks, cells, self._directions, int(self._reach), self._number + 1, counts)
        self._number += len(cells)
        return counts * self._terrain.resolution_m**2


LANES = 16
"""Distances are compared so many at once."""


@kernel
def _grow(kind, nodes, count, samples, step):
    """Extend a tree by samples (k, 2) in the unit square; nodes (n, 2) [cells], of which `count` are valid.

    Each sample extends the nearest node by at most `step` cells in its direction. An extension that meets a wall is
    dropped, one that meets unknown cells gives a frontier point, one over free cells gives a node. Returns the new
    count, and the frontier points (k, 2).
    """
    height, width = kind.shape
    points, room = np.empty((samples.shape[0], 2)), nodes.shape[0] // LANES * LANES + LANES
    rows, columns, away, least = np.full(room, np.inf), np.full(room, np.inf), np.empty(room), np.empty(LANES)
    rows[:count], columns[:count] = nodes[:count, 0], nodes[:count, 1]
    found = 0
    for i in range(samples.shape[0]):
        row, column = samples[i, 0] * height, samples[i, 1] * width
        for k in range(count):
            away[k] = (rows[k] - row) ** 2 + (columns[k] - column) ** 2
        away[count : count + LANES] = np.inf
        least[:] = np.inf
        for k in range(0, count, LANES):
            for j in range(LANES):
                least[j] = away[k + j] if away[k + j] < least[j] else least[j]
        best, nearest = 0, least.min()
        while away[best] > nearest:
            best += 1
        length = math.sqrt(nearest)
        if length < 1e-6:
            continue
        reach = min(length, step)
        dr, dc = (row - nodes[best, 0]) / length, (column - nodes[best, 1]) / length
        is_free = True
        for k in range(1, int(2 * reach) + 1):
            r, c = nodes[best, 0] + 0.5 * k * dr, nodes[best, 1] + 0.5 * k * dc
            if r < 0 or c < 0 or r >= height or c >= width or kind[int(r), int(c)] == WALL:
                is_free = False
                break
            if kind[int(r), int(c)] == UNKNOWN:
                is_free = False
                points[found, 0], points[found, 1] = r, c
                found += 1
                break
        if is_free and count < nodes.shape[0]:
            nodes[count, 0], nodes[count, 1] = nodes[best, 0] + reach * dr, nodes[best, 1] + reach * dc
            rows[count], columns[count] = nodes[count, 0], nodes[count, 1]
            count += 1
    return count, points[:found]


class RandomTree:
    """A rapidly-exploring random tree over the free floor of a map (LaValle 1998); it reports where it meets the
    unknown."""

    NODES_MAX = 4000

    def __init__(self, root_m: Array):
        self._nodes_m = np.zeros((self.NODES_MAX, 2))
        self._nodes_m[0] = root_m
        self.count = 1

    def grow(self, terrain: Terrain, samples: Array, step_m: float) -> Array:
        """(k, 2) points [m] at which extensions towards samples (n, 2) in [0, 1) left the known floor."""
        nodes = np.ascontiguousarray(terrain.to_cells(self._nodes_m))
        step = step_m / terrain.resolution_m
        count, points = _grow(terrain.kind, nodes, self.count, samples, step)
        self._nodes_m[self.count : count] = terrain.to_metres(nodes[self.count : count])
        self.count = count
        return terrain.to_metres(points)
