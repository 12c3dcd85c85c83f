"""Shortest paths on a `Terrain` to the cheapest of several goals: Dijkstra's algorithm with a bucket queue (Dial)."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.kernels.compiled import kernel
from twc_env.planning.terrain import OPEN_COST, Terrain

UNITS_PER_CELL = 10
"""Path costs are integers; a straight step over cells of `OPEN_COST` has this cost."""
STRAIGHT, DIAGONAL = 5, 7
"""Step costs per cost factor of the cell entered."""
COST_MAX = 140
"""Greatest cost factor of a cell."""
SHORTCUT_COST = 3
"""Shortcuts may cross cells up to this cost factor in any case."""
SHORTCUT_CELLS_MAX, SHORTCUT_FAILURES_MAX = 120, 12
"""Cells of the path ahead to which shortcuts are tried; consecutive failures after which the search stops."""
BUCKETS = 1024
"""More than the greatest edge cost, `DIAGONAL * COST_MAX`."""
FAR = np.int32(2**30)
"""Path cost of cells not reached."""


@dataclass(frozen=True, slots=True)
class Disc:
    """A disc in the map frame with an additional traversal cost: a teammate, or an obstacle that is not in the map."""

    x_m: float
    y_m: float
    radius_m: float
    extra: int
    """Added to the cost factor of its cells (`OPEN_COST` is the factor of open floor)."""


@kernel
def _add_discs(cost, discs, undo_cell, undo_cost):
    """Raise the cost of enterable cells inside discs (k, 4: row, column, radius, extra); returns the count changed.

    undo_cell, undo_cost (n,) receive the cells' flat indices and costs; if they are full, the other cells keep theirs.
    """
    height, width = cost.shape
    changed = 0
    for k in range(discs.shape[0]):
        row, column, radius = discs[k, 0], discs[k, 1], discs[k, 2]
        reach = int(radius) + 1
        for r in range(max(1, int(row) - reach), min(height - 1, int(row) + reach + 1)):
            for c in range(max(1, int(column) - reach), min(width - 1, int(column) + reach + 1)):
                if (r + 0.5 - row) ** 2 + (c + 0.5 - column) ** 2 > radius * radius or cost[r, c] == 0:
                    continue
                if changed >= undo_cell.shape[0]:
                    return changed
                undo_cell[changed] = r * width + c
                undo_cost[changed] = cost[r, c]
                changed += 1
                cost[r, c] = min(cost[r, c] + int(discs[k, 3]), COST_MAX)
    return changed


@kernel
def _restore_costs(cost, undo_cell, undo_cost, changed):
    """Restore the costs changed by `_add_discs`, last first."""
    width = cost.shape[1]
    for k in range(changed - 1, -1, -1):
        cost[undo_cell[k] // width, undo_cell[k] % width] = undo_cost[k]


@kernel
def _nearest_enterable(cost, row, column, reach):
    """Flat index of the enterable cell nearest to (row, column) within `reach` cells; -1 if there is none."""
    height, width = cost.shape
    best, nearest = -1, reach * reach + 1
    for r in range(max(1, row - reach), min(height - 1, row + reach + 1)):
        for c in range(max(1, column - reach), min(width - 1, column + reach + 1)):
            away = (r - row) ** 2 + (c - column) ** 2
            if cost[r, c] > 0 and away < nearest:
                best, nearest = r * width + c, away
    return best


@kernel
def _cheapest_goal(
    cost, labels, penalty, awaited, left, least_edge, start, spent, parent, following, preceding, opened, opened_count
):
    """Dijkstra with a bucket queue from flat cell `start` to the labelled cell of least path cost + penalty[label].

    It ends early once `left` of the labels for which `awaited` (labels,) is 1 were reached, and all cells as near; if
    left is 0, never. Labels reached become 0 there.

    cost, labels (h, w) have a closed border; `least_edge` is the least edge cost. The other arrays are flat scratch
    that persists between calls: `spent` must be FAR except at opened[:opened_count]. Returns (goal or -1, its path
    cost, count of cells opened).
    """
    width = cost.shape[1]
    flat, label_of = cost.reshape(-1), labels.reshape(-1)
    for k in range(opened_count):
        spent[opened[k]] = FAR
    steps = np.array([1, -1, width, -width, width + 1, width - 1, -width + 1, -width - 1], np.int64)
    head = np.full(BUCKETS, -1, np.int32)
    spent[start], parent[start], following[start], preceding[start] = 0, -1, -1, -1
    head[0], opened[0] = start, start
    count, waiting, now = 1, 1, 0
    best, best_total, last = -1, FAR, int(FAR)
    while waiting:
        cell = head[now % BUCKETS]
        if cell < 0:
            now += 1
            continue
        if now >= best_total or now > last:
            break
        head[now % BUCKETS] = following[cell]
        if following[cell] >= 0:
            preceding[following[cell]] = -1
        preceding[cell] = -2  # settled
        waiting -= 1
        label = label_of[cell]
        if label > 0 and now + penalty[label] < best_total:
            best, best_total = cell, now + penalty[label]
        if left > 0 and label > 0 and awaited[label]:
            awaited[label] = 0
            left -= 1
            if left == 0:
                last = now
        for k in range(8):
            neighbour = cell + steps[k]
            old = spent[neighbour]
            if old <= now + least_edge:
                continue
            factor = flat[neighbour]
            if factor == 0:
                continue
            if k >= 4:  # a diagonal step needs both adjacent cells enterable
                down = cell + (width if k < 6 else -width)
                side = neighbour - (down - cell)
                if flat[down] == 0 or flat[side] == 0:
                    continue
            through = now + (STRAIGHT if k < 4 else DIAGONAL) * factor
            if through >= old:
                continue
            if old == FAR:
                opened[count] = neighbour
                count += 1
                waiting += 1
            else:
                before, after = preceding[neighbour], following[neighbour]
                if before >= 0:
                    following[before] = after
                else:
                    head[old % BUCKETS] = after
                if after >= 0:
                    preceding[after] = before
            bucket = through % BUCKETS
            spent[neighbour], parent[neighbour] = through, cell
            following[neighbour], preceding[neighbour] = head[bucket], -1
            if head[bucket] >= 0:
                preceding[head[bucket]] = neighbour
            head[bucket] = neighbour
    return best, (spent[best] if best >= 0 else FAR), count


@kernel
def _backtrack(parent, goal, width):
    """Cells (k, 2) of the path from the start to `goal`."""
    length, cell = 0, goal
    while cell >= 0:
        length, cell = length + 1, parent[cell]
    path = np.empty((length, 2), np.int32)
    cell = goal
    for k in range(length - 1, -1, -1):
        path[k, 0], path[k, 1] = cell // width, cell % width
        cell = parent[cell]
    return path


@kernel
def _line_cost(cost, row_a, column_a, row_b, column_b):
    """Greatest cost factor on the line between two points [cells]; COST_MAX + 1 if a cell is closed."""
    height, width = cost.shape
    samples = max(1, int(2.0 * math.hypot(row_b - row_a, column_b - column_a)))
    highest = 0
    for k in range(1, samples + 1):
        t = k / samples
        r, c = int(row_a + t * (row_b - row_a)), int(column_a + t * (column_b - column_a))
        if r < 0 or c < 0 or r >= height or c >= width or cost[r, c] == 0:
            return COST_MAX + 1
        highest = max(highest, cost[r, c])
    return highest


@kernel
def _shortcut(path, cost):
    """Remove corners from path (k, 2) where the straight line crosses no cell of greater cost; (j, 2) cell centres."""
    count = path.shape[0]
    kept = np.empty((count, 2), np.float64)
    kept[0] = path[0] + 0.5
    size, anchor = 1, 0
    while anchor < count - 1:
        far, highest = anchor + 1, SHORTCUT_COST
        for k in range(anchor + 1, min(count, anchor + SHORTCUT_CELLS_MAX)):
            highest = max(highest, cost[path[k, 0], path[k, 1]])
            line = _line_cost(cost, path[anchor, 0] + 0.5, path[anchor, 1] + 0.5, path[k, 0] + 0.5, path[k, 1] + 0.5)
            if line <= highest:
                far = k
            elif k > far + SHORTCUT_FAILURES_MAX:
                break
        kept[size] = path[far] + 0.5
        size, anchor = size + 1, far
    return kept[:size]


@kernel
def _least_per_label(labels, spent, opened, opened_count, least, cell_of):
    """Fill `least` and `cell_of` (count + 1,): path cost to and flat index of the nearest opened cell of each label."""
    label_of = labels.reshape(-1)
    for k in range(opened_count):
        label = label_of[opened[k]]
        if 0 < label < least.shape[0] and spent[opened[k]] < least[label]:
            least[label], cell_of[label] = spent[opened[k]], opened[k]


@kernel
def _nearest_opened(row, column, width, opened, opened_count):
    """Flat index of the opened cell with the least Euclidean distance to (row, column); -1 if there is none."""
    best, nearest = -1, 1e18
    for k in range(opened_count):
        away = (opened[k] // width + 0.5 - row) ** 2 + (opened[k] % width + 0.5 - column) ** 2
        if away < nearest:
            best, nearest = opened[k], away
    return best


@dataclass(frozen=True, slots=True, eq=False)
class Plan:
    """A path to a goal."""

    path_m: Array
    """(k, 2) corners in the map frame, start first."""
    length_m: float
    """Path cost in metres of open floor: longer than the path where it passes walls or discs."""
    label: int
    """Label of the goal."""


class PathFinder:
    """Path search; its scratch memory is reused between searches."""

    START_REACH_M = 0.6
    """If the robot's cell is closed, the search starts at the nearest enterable one within this distance."""

    def __init__(self) -> None:
        self._capacity = 0
        self._opened_count = 0
        self._undo_cell, self._undo_cost = np.empty(200_000, np.int64), np.empty(200_000, np.int16)

    def cheapest(
        self,
        terrain: Terrain,
        start_m: Array,
        labels: Array,
        penalty_m: Array,
        discs: Iterable[Disc] = (),
        awaited: tuple[Array, int] = (np.zeros(0, np.int8), 0),
    ) -> Plan | None:
        """The path to the labelled cell of least path cost + penalty_m[label]; None if none can be reached.

        start_m (2,) in the map frame; labels (h, w) int32 over the terrain's cells, 0 for no goal; penalty_m (labels,),
        infinite to exclude a label. The costs of `discs` apply to this search only. awaited: labels (labels,) int8,
        and how many of them end the search once they are reached.
        """
        self._reserve(terrain.cost.size)
        cell = terrain.resolution_m
        row, column = np.floor(terrain.to_cells(start_m)).astype(int)
        start = _nearest_enterable(terrain.cost, row, column, round(self.START_REACH_M / cell))
        if start < 0:
            self._spent[self._opened[: self._opened_count]] = FAR
            self._opened_count = 0
            return None
        units = UNITS_PER_CELL / cell
        penalty = np.minimum(np.asarray(penalty_m, float) * units, float(FAR)).astype(np.int32)
        discs = tuple(discs)
        changed = self._raise_costs(terrain, discs) if discs else 0
        goal, spent, self._opened_count = _cheapest_goal(
            terrain.cost, labels, penalty, *awaited, STRAIGHT * OPEN_COST, start, self._spent, self._parent,
            self._following, self._preceding, self._opened, self._opened_count,
        )  # fmt: skip
        corners = np.empty((0, 2))
        if goal >= 0:
            corners = _shortcut(_backtrack(self._parent, goal, terrain.cost.shape[1]), terrain.cost)
        if changed:
            _restore_costs(terrain.cost, self._undo_cell, self._undo_cost, changed)
        if goal < 0:
            return None
        return Plan(terrain.to_metres(corners), spent / units, int(labels.reshape(-1)[goal]))

    def spread(self, terrain: Terrain, start_m: Array) -> bool:
        """Search all cells reachable from start_m (2,); False if there are none.

        `nearest_of_labels` and `nearest_to` read the result of the last search.
        """
        self.cheapest(terrain, start_m, np.zeros_like(terrain.labels), np.zeros(1))
        return self._opened_count > 0

    def spread_to_frontiers(self, terrain: Terrain, start_m: Array, is_wanted: Array, count_max: int) -> bool:
        """`spread` until the `count_max` nearest of the frontiers for which is_wanted (clusters + 1,) were found.

        Afterwards `nearest_of_labels` is right for these; others are further away than all of them, or not reached.
        """
        penalty_m = np.full(len(is_wanted), np.inf)  # no goal: the search goes on
        awaited = is_wanted.astype(np.int8), min(count_max, int(is_wanted.sum()))
        self.cheapest(terrain, start_m, terrain.labels, penalty_m, (), awaited)
        return self._opened_count > 0

    def nearest_of_labels(self, terrain: Terrain, labels: Array, count: int) -> tuple[Array, Array]:
        """(count + 1,) path cost [m] to the nearest cell of each label, infinite if there is none, and (count + 1, 2)
        its centre in the map frame."""
        least, cell_of = np.full(count + 1, FAR, np.int32), np.full(count + 1, -1, np.int64)
        _least_per_label(labels, self._spent, self._opened, self._opened_count, least, cell_of)
        lengths_m = np.where(cell_of >= 0, least * (terrain.resolution_m / UNITS_PER_CELL), np.inf)
        width = terrain.cost.shape[1]
        return lengths_m, terrain.to_metres(np.column_stack([cell_of // width, cell_of % width]) + 0.5)

    def ways_to(self, terrain: Terrain, cells: Array) -> Array:
        """(k,) path cost [m] to each of the cells (k, 2: row, column); infinite if it was not reached."""
        spent = self._spent[cells[:, 0] * terrain.cost.shape[1] + cells[:, 1]]
        return np.where(spent < FAR, spent * (terrain.resolution_m / UNITS_PER_CELL), np.inf)

    def nearest_to(self, terrain: Terrain, point_m: Array) -> Array | None:
        """(2,) centre of the reachable cell with the least Euclidean distance to a point; None if there is none."""
        row, column = terrain.to_cells(point_m)
        width = terrain.cost.shape[1]
        cell = _nearest_opened(row, column, width, self._opened, self._opened_count)
        return None if cell < 0 else terrain.to_metres(np.array([cell // width + 0.5, cell % width + 0.5]))

    def _raise_costs(self, terrain: Terrain, discs: tuple[Disc, ...]) -> int:
        values = np.array([[d.x_m, d.y_m, d.radius_m, d.extra] for d in discs])
        values[:, :2] = terrain.to_cells(values[:, :2])
        values[:, 2] /= terrain.resolution_m
        return _add_discs(terrain.cost, values, self._undo_cell, self._undo_cost)

    def _reserve(self, size: int) -> None:
        if size <= self._capacity:
            return
        self._capacity = size + size // 2
        self._spent = np.full(self._capacity, FAR, np.int32)
        self._parent, self._following, self._preceding, self._opened = np.empty((4, self._capacity), np.int32)
        self._opened_count = 0
