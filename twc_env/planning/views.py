"""Views on an estimated map: how much unknown floor a scan from a place would show, and random trees in free space."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.kernels.compiled import kernel
from twc_env.planning.terrain import UNKNOWN, WALL, Terrain


@kernel
def _count_unknown(kind, is_claimed, place_row, place_column, reach, beams, stamp, number, claim):
    """Unknown cells on `beams` rays of length `reach` [cells] from a place, each once; rays end at walls.

    Cells of `is_claimed` do not count; with `claim`, the cells found are marked there. stamp (h, w) int32 is scratch:
    a cell with the value `number` was counted.
    """
    height, width = kind.shape
    found = 0
    for b in range(beams):
        angle = 2.0 * math.pi * b / beams
        dr, dc = math.sin(angle), math.cos(angle)
        for k in range(1, int(reach) + 1):
            r, c = math.floor(place_row + k * dr), math.floor(place_column + k * dc)
            if r < 0 or c < 0 or r >= height or c >= width or kind[r, c] == WALL:
                break
            if kind[r, c] == UNKNOWN and stamp[r, c] != number:
                stamp[r, c] = number
                if not is_claimed[r, c]:
                    found += 1
                    if claim:
                        is_claimed[r, c] = True
    return found


@kernel
def _count_each(kind, is_claimed, cells, reach, beams, stamp, counts):
    """Fill counts (k,) with `_count_unknown` at cells (k, 2: row, column)."""
    for i in range(cells.shape[0]):
        counts[i] = _count_unknown(kind, is_claimed, cells[i, 0], cells[i, 1], reach, beams, stamp, i + 1, False)


class ViewGain:
    """Unknown area that scans from places would show; what is outside the known part of the map does not count.

    Unknown cells are taken for free, as no wall is known there (Burgard et al. 2005; Gonzalez-Banos and Latombe 2002).
    """

    def __init__(self, terrain: Terrain, range_m: float, beams: int = 90, closes_walls: bool = False):
        """closes_walls: rays do not pass between wall cells that touch at a corner, as those of walls that do not run
        along the grid do."""
        self._terrain, self._reach, self._beams = terrain, range_m / terrain.resolution_m, beams
        margin = math.ceil(self._reach)
        self._kind = np.pad(terrain.kind, margin, constant_values=UNKNOWN)
        if closes_walls:
            is_wall = self._kind == WALL
            self._kind[1:][is_wall[:-1]] = self._kind[:, 1:][is_wall[:, :-1]] = WALL
            self._kind[1:, 1:][is_wall[:-1, :-1]] = WALL
        self._margin = margin
        self.is_claimed = np.zeros(self._kind.shape, np.bool_)
        """Unknown cells that do not count, of the terrain with a margin of the range."""
        self._stamp = np.zeros(self._kind.shape, np.int32)

    def claim(self, place_m: Array) -> None:
        """Do not count from now on what a scan from this place would show: another robot goes there."""
        row, column = self._terrain.to_cells(place_m) + self._margin
        self._stamp[:] = 0
        args = (row, column, self._reach, self._beams, self._stamp, 1, True)
        _count_unknown(self._kind, self.is_claimed, *args)

    def area_m2(self, places_m: Array) -> Array:
        """(k,) unclaimed unknown area [m2] that a scan from each of places_m (k, 2) would show."""
        cells = np.ascontiguousarray(self._terrain.to_cells(places_m) + self._margin, dtype=float)
        counts = np.zeros(len(cells), np.int64)
        self._stamp[:] = 0
        _count_each(self._kind, self.is_claimed, cells, self._reach, self._beams, self._stamp, counts)
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
