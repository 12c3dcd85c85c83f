"""Views on an estimated map: how much unknown floor a scan from a place would show, and random trees in free space."""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.kernels.compiled import kernel
from twc_env.planning.terrain import FREE, UNKNOWN, WALL, Terrain


@kernel
def _count_from(kind, row, column, directions, reach, stamps, number):
    """Unknown cells on rays of length `reach` [cells] from any place, each once; rays end at walls.

    directions (beams, 2): down, right. stamps (2 reach + 3,) * 2 holds no such number; 0 makes the cells found free
    instead, so that they never count again.
    """
    height, width = kind.shape
    top, left = np.uint64(math.floor(row) - reach - 1), np.uint64(math.floor(column) - reach - 1)
    found = 0
    for b in range(directions.shape[0]):
        for k in range(1, reach + 1):
            r = np.uint64(math.floor(row + k * directions[b, 0]))
            c = np.uint64(math.floor(column + k * directions[b, 1]))
            if r >= height or c >= width or kind[r, c] == WALL:
                break
            if kind[r, c] == UNKNOWN:
                if number == 0:
                    kind[r, c] = FREE
                elif stamps[r - top, c - left] != number:
                    stamps[r - top, c - left] = number
                    found += 1
    return found


@kernel
def _count_from_middle(kind, middle, steps, behind, own, stamps, number):
    """As `_count_from`, from the middle of the cell with this flat index: a walk through a `_RayTree`."""
    found, i, end = 0, np.uint64(0), np.uint64(steps.shape[0])
    flat = kind.reshape(-1)
    while i < end:
        what = flat[np.uint64(middle + steps[i])]
        if what == WALL:
            i = np.uint64(behind[i])
            continue
        cell = np.uint64(own[i])
        if what == UNKNOWN and stamps[cell] != number:
            stamps[cell] = number
            found += 1
        i += np.uint64(1)
    return found


@kernel
def _count_each(kind, cells, directions, reach, stamps, number, counts):
    """Fill counts (k,) with `_count_from` cells (k, 2: row, column), by scans with numbers from `number` on."""
    for i in range(cells.shape[0]):
        counts[i] = _count_from(kind, cells[i, 0], cells[i, 1], directions, reach, stamps, number + i)


@kernel
def _best_of(kind, middles, steps, behind, own, stamps, number, cell_m2, least_m2, factors, worth, gains):
    """Index of the first place of the greatest worth, -1 if none has any; and the next number.

    worth (k,) holds gain times factor where gains (k,) [m2] is known, else, where that is negative, a bound of it:
    scans from middles (k,) are only computed while some bound is not below what is known. Less than `least_m2` is worth
    nothing.
    """
    while True:
        best, most = -1, 0.0
        for k in range(worth.shape[0]):
            if worth[k] > most:
                best, most = k, worth[k]
        if best < 0 or gains[best] >= 0.0:
            return best, number
        gains[best] = _count_from_middle(kind, middles[best], steps, behind, own, stamps, number) * cell_m2
        worth[best] = gains[best] * factors[best] if gains[best] >= least_m2 else 0.0
        number += 1


@lru_cache(maxsize=4)
def _directions(beams: int) -> Array:
    """(beams, 2) sine and cosine of the angles of beams all around."""
    angles = [2.0 * math.pi * b / beams for b in range(beams)]
    return np.array([(math.sin(angle), math.cos(angle)) for angle in angles])


class _RayTree:
    """The cells on rays all around from the middle of a cell; rays that begin alike share these cells.

    Nodes are in the order of a walk along the rays; behind a wall it goes on at the node `behind` it.
    """

    def __init__(self, beams: int, reach: int):
        rays = np.floor(0.5 + np.arange(1, reach + 1)[None, :, None] * _directions(beams)[:, None]).astype(np.int64)
        cells: list[tuple[int, int]] = []
        behind: list[int] = []
        open_nodes: list[int] = []  # those of the last ray, from its first cell on
        previous: list[tuple[int, int]] = []
        for ray in rays.tolist():
            own = list(dict.fromkeys((r, c) for r, c in ray))
            shared = next((k for k, (a, b) in enumerate(zip(own, previous, strict=False)) if a != b), None)
            shared = min(len(own), len(previous)) if shared is None else shared
            for node in open_nodes[shared:]:
                behind[node] = len(cells)
            del open_nodes[shared:]
            for cell in own[shared:]:
                open_nodes.append(len(cells))
                cells.append(cell)
                behind.append(-1)
            previous = own
        for node in open_nodes:
            behind[node] = len(cells)
        self.cells = np.array(cells, np.int64).reshape(-1, 2)
        """(nodes, 2) rows down and columns to the right."""
        self.behind = np.array(behind, np.int32)
        side = 2 * reach + 3
        self.own = ((self.cells[:, 0] + reach + 1) * side + self.cells[:, 1] + reach + 1).astype(np.int32)
        """(nodes,) index of each node's cell: that of a flat array of 2 reach + 3 squared."""


@lru_cache(maxsize=8)
def _ray_tree(beams: int, reach: int) -> _RayTree:
    return _RayTree(beams, reach)


class ViewGain:
    """Unknown area that scans from places would show; what is outside the known part of the map counts as unknown.

    Unknown cells are taken for free, as no wall is known there (Burgard et al. 2005; Gonzalez-Banos and Latombe 2002).
    """

    def __init__(self, terrain: Terrain, range_m: float, beams: int = 90, closes_walls: bool = False):
        """closes_walls: rays do not pass between wall cells that touch at a corner, as those of walls that do not run
        along the grid do."""
        self._terrain, self._directions = terrain, _directions(beams)
        reach = range_m / terrain.resolution_m
        self._reach, self._margin = int(reach), math.ceil(reach)
        self._kind, self._has_claims = terrain.padded_kind(self._margin, closes_walls), False
        self._stamps, self._number = np.zeros((2 * self._reach + 3,) * 2, np.int32), 1

    def claim(self, place_m: Array) -> None:
        """Do not count from now on what a scan from this place would show: another robot goes there."""
        if not self._has_claims:
            self._kind, self._has_claims = self._kind.copy(), True
        row, column = self._terrain.to_cells(place_m) + self._margin
        _count_from(self._kind, row, column, self._directions, self._reach, self._stamps, 0)

    def area_m2(self, places_m: Array) -> Array:
        """(k,) unclaimed unknown area [m2] that a scan from each of places_m (k, 2) would show."""
        cells = np.ascontiguousarray(self._terrain.to_cells(places_m) + self._margin, dtype=float)
        counts = np.zeros(len(cells), np.int64)
        _count_each(self._kind, cells, self._directions, self._reach, self._stamps, self._number, counts)
        self._number += len(cells)
        return counts * self._terrain.resolution_m**2

    def best(
        self, places_m: Array, factors: Array, least_m2: float, count_max: int, apart_m: float
    ) -> tuple[Array, Array]:
        """Indices (n,) of at most count_max of places_m (k, 2) and their areas [m2], those with the greatest product of
        area and factor (k,) first; places nearer than `apart_m` to a better one, and areas below `least_m2`, are left
        out. Places are in the middle of cells; those outside the map are left out.
        """
        terrain, tree = self._terrain, _ray_tree(len(self._directions), self._reach)
        cells, cell_m2 = np.floor(terrain.to_cells(places_m)).astype(np.int64), terrain.resolution_m**2
        gains, width = np.full(len(cells), -1.0), self._kind.shape[1]
        is_inside = ((cells >= 0) & (cells < terrain.kind.shape)).all(axis=1)
        worth = np.where(is_inside, len(tree.cells) * cell_m2 * factors, 0.0)
        middles = (cells + self._margin) @ np.array([width, 1])
        steps, stamps = tree.cells @ np.array([width, 1]), self._stamps.reshape(-1)
        chosen: list[int] = []
        while len(chosen) < count_max:
            best, self._number = _best_of(
                self._kind, middles, steps, tree.behind, tree.own, stamps, self._number, cell_m2, least_m2, factors,
                worth, gains,
            )  # fmt: skip
            if best < 0:
                break
            chosen.append(best)
            worth[np.hypot(*(places_m - places_m[best]).T) < apart_m] = 0.0
        return np.array(chosen, np.int64), gains[chosen]


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
    rows, columns, away, least = np.empty(room), np.empty(room), np.empty(room), np.empty(LANES)
    rows[:], columns[:] = np.inf, np.inf
    for k in range(count):
        rows[k], columns[k] = nodes[k, 0], nodes[k, 1]
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
