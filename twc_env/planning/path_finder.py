"""Shortest paths on a `Terrain` to the cheapest of several goals: Dijkstra's algorithm with a bucket queue (Dial)."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from weakref import ReferenceType, ref

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.kernels.compiled import kernel
from twc_env.planning.terrain import Terrain
from twc_env.records.growing_arrays import lazy_zeros

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
NOWHERE = 8
"""The step by which a search came to its start."""
LOW_BITS = (1 << 15) - 1
WAITING = 1 << 16
"""Entries of the queue at first; open floor of 2,000 m2 needs some 3,000."""
UNDO_MAX = 200_000
"""Cells whose costs discs may raise."""
_NOW, _ENTRIES, _OPENED, _SETTLED, _USED, _FREE = range(6)
"""State of a search between calls: path cost, entries in the queue, cells opened and settled, entries of the queue that
were ever used, and the first that is free again."""


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
def _begin(start, spent, came, opened, head, waiting, counts):
    """Reset a search to flat cell `start`; the arrays are those of `_cheapest_goal`, which the last one has used."""
    for k in range(counts[_OPENED]):
        spent[opened[k]] = FAR
    head[:] = -1
    spent[start], came[start], opened[0] = 0, NOWHERE, start
    waiting[0, 0], waiting[0, 1], head[0] = start, -1, 0
    counts[_NOW], counts[_ENTRIES], counts[_OPENED], counts[_SETTLED] = 0, 1, 1, 0
    counts[_USED], counts[_FREE] = 1, -1


@kernel
def _cheapest_goal(
    cost, labels, penalty, awaited, left, has_goals, spent, came, opened, settled, head, waiting, counts
):  # fmt: skip
    """Dijkstra with a bucket queue to the labelled cell of least path cost + penalty[label].

    It ends early once `left` of the labels for which `awaited` (labels,) is 1 were reached, and all cells as near; if
    left is 0, never. Without `has_goals` it goes on to the end. cost, labels (h, w) have a closed border.

    A search goes on where the last one of the same costs and start has ended, after a look at the cells that were
    settled then. Flat arrays keep its state: `spent` (FAR at cells not opened), `came` (the step by which each was
    reached), opened and settled cells in this order, the queue `waiting` (n, 2: cell, next entry of its bucket) from
    `head`, and `counts`. Entries of cells that have become cheaper stay in the queue and are skipped. Returns (goal or
    -1, whether `waiting` is full: then the call has to be repeated with a longer one).
    """
    best, best_total, last = np.int64(-1), np.int64(FAR), np.int64(FAR)
    is_awaited = awaited.copy()
    flat, label_of = cost.reshape(-1), labels.reshape(-1)
    for k in range(counts[_SETTLED] if has_goals else 0):
        seen, now = np.int64(settled[k]), np.int64(spent[settled[k]])
        if now >= best_total or now > last:
            return best, False
        label = label_of[seen]
        if label > 0:
            if now + penalty[label] < best_total:
                best, best_total = seen, now + penalty[label]
            if left > 0 and is_awaited[label]:
                is_awaited[label] = 0
                left -= 1
                if left == 0:
                    last = now
    now, entries, used, free = counts[_NOW], counts[_ENTRIES], counts[_USED], counts[_FREE]
    opened_count, settled_count = np.uint64(counts[_OPENED]), np.uint64(counts[_SETTLED])
    one, width = np.uint64(1), np.uint64(cost.shape[1])
    steps = np.array([one, -one, width, -width, width + one, width - one, one - width, -width - one], np.uint64)
    prices = np.zeros(8, np.int64)
    room, is_full = waiting.shape[0] - 8, False
    while entries > 0:
        bucket = np.uint64(now & (BUCKETS - 1))
        first = head[bucket]
        if first < 0:
            now += 1
            continue
        if now >= best_total or now > last:
            break
        if used > room:
            is_full = True
            break
        cell = np.uint64(waiting[np.uint64(first), 0])
        head[bucket], waiting[np.uint64(first), 1], free = waiting[np.uint64(first), 1], free, np.int64(first)
        entries -= 1
        if spent[cell] != now:
            continue
        settled[settled_count] = cell
        settled_count += one
        if has_goals:
            label = label_of[cell]
            if label > 0:
                if now + penalty[label] < best_total:
                    best, best_total = np.int64(cell), now + penalty[label]
                if left > 0 and is_awaited[label]:
                    is_awaited[label] = 0
                    left -= 1
                    if left == 0:
                        last = now
        # A diagonal step is the sum of two straight ones, and needs both of their cells enterable.
        for k in range(4):
            prices[k] = STRAIGHT * np.int64(flat[cell + steps[k]])
        for k in range(4, 8):
            is_open = prices[2 + (k - 4) // 2] != 0 and prices[k % 2] != 0
            prices[k] = DIAGONAL * np.int64(flat[cell + steps[k]]) if is_open else 0
        for k in range(8):
            neighbour, through = cell + steps[k], now + prices[k]
            old = spent[neighbour]
            if prices[k] == 0 or through >= old:
                continue
            if old == FAR:
                opened[opened_count] = neighbour
                opened_count += one
            entry = free
            if free >= 0:
                free = np.int64(waiting[np.uint64(free), 1])
            else:
                entry = used
                used += 1
            bucket = np.uint64(through & (BUCKETS - 1))
            spent[neighbour], came[neighbour] = through, k
            waiting[np.uint64(entry), 0], waiting[np.uint64(entry), 1] = neighbour, head[bucket]
            head[bucket] = entry
            entries += 1
    counts[_NOW], counts[_ENTRIES], counts[_USED], counts[_FREE] = now, entries, used, free
    counts[_OPENED], counts[_SETTLED] = opened_count, settled_count
    return best, is_full


@kernel
def _backtrack(came, goal, width):
    """Cells (k, 2) of the path from the start to `goal`."""
    steps = np.array([1, -1, width, -width, width + 1, width - 1, -width + 1, -width - 1], np.int64)
    length, cell = 1, goal
    while came[cell] != NOWHERE:
        length, cell = length + 1, cell - steps[came[cell]]
    path = np.empty((length, 2), np.int32)
    cell = goal
    for k in range(length - 1, -1, -1):
        path[k, 0], path[k, 1] = cell // width, cell % width
        cell -= steps[came[cell]] if k > 0 else 0
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
def _least_per_label(labels, cells, spent, opened, opened_count, least, cell_of):
    """Fill `least` and `cell_of` (count + 1,): path cost to and flat index of the nearest opened cell of each label, or
    of several as near, the first opened. cells (k,): flat indices of the labelled ones."""
    label_of = labels.reshape(-1)
    is_tied, tied = np.zeros(least.shape[0], np.bool_), 0
    for k in range(cells.shape[0]):
        cell = cells[k]
        label, cost = label_of[cell], spent[cell]
        if label >= least.shape[0] or cost > least[label] or cost == FAR:
            continue
        tied -= is_tied[label]
        is_tied[label] = cost == least[label]
        tied += is_tied[label]
        least[label], cell_of[label] = cost, cell
    if tied == 0:
        return
    is_marked = np.zeros(LOW_BITS + 1, np.bool_)  # by the low bits of a cell, to look at few of those opened
    for k in range(cells.shape[0]):
        label = label_of[cells[k]]
        if label < least.shape[0] and is_tied[label] and spent[cells[k]] == least[label]:
            is_marked[cells[k] & LOW_BITS] = True
    for k in range(opened_count):
        if is_marked[opened[k] & LOW_BITS]:
            cell = opened[k]
            label = label_of[cell]
            if 0 < label < least.shape[0] and is_tied[label] and spent[cell] == least[label]:
                is_tied[label], cell_of[label] = False, cell
                tied -= 1
                if tied == 0:
                    return


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
    """Path search; its scratch memory is reused between searches.

    A search from the same place of the same terrain around the same discs as the last one goes on where that ended.
    """

    START_REACH_M = 0.6
    """If the robot's cell is closed, the search starts at the nearest enterable one within this distance."""

    def __init__(self) -> None:
        self._spent, self._came = np.zeros(0, np.int32), np.zeros(0, np.uint8)
        self._opened, self._settled = np.zeros((2, 0), np.int32)
        self._head, self._waiting = np.empty(BUCKETS, np.int32), lazy_zeros((WAITING, 2), np.int32)
        self._counts = np.zeros(6, np.int64)
        self._begun: tuple[ReferenceType[Array], int, tuple[Disc, ...]] | None = None
        """Costs, start and discs of the last search."""
        self._undo_cell, self._undo_cost = lazy_zeros((UNDO_MAX,), np.int64), lazy_zeros((UNDO_MAX,), np.uint8)

    def __reduce__(self) -> tuple[type[PathFinder], tuple[()]]:
        return PathFinder, ()

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
        start, discs = self._start(terrain, start_m), tuple(discs)
        self._begin(terrain, start, discs)
        if start < 0:
            return None
        units = UNITS_PER_CELL / terrain.resolution_m
        penalty = np.minimum(np.asarray(penalty_m, float) * units, float(FAR)).astype(np.int32)
        has_goals = awaited[1] > 0 or bool((penalty < FAR).any())
        changed = self._raise_costs(terrain, discs) if discs else 0
        goal, is_full = -1, True
        while is_full:
            goal, is_full = _cheapest_goal(
                terrain.cost, labels, penalty, *awaited, has_goals, self._spent, self._came, self._opened,
                self._settled, self._head, self._waiting, self._counts,
            )  # fmt: skip
            if is_full:
                self._waiting = np.vstack([self._waiting, np.empty_like(self._waiting)])
        corners = np.empty((0, 2))
        if goal >= 0:
            corners = _shortcut(_backtrack(self._came, goal, terrain.cost.shape[1]), terrain.cost)
        if changed:
            _restore_costs(terrain.cost, self._undo_cell, self._undo_cost, changed)
        if goal < 0:
            return None
        return Plan(terrain.to_metres(corners), int(self._spent[goal]) / units, int(labels.reshape(-1)[goal]))

    def spread(self, terrain: Terrain, start_m: Array, discs: Iterable[Disc] = ()) -> bool:
        """Search all cells reachable from start_m (2,); False if there are none.

        `nearest_of_labels` and `nearest_to` read the result of the last search.
        """
        self.cheapest(terrain, start_m, terrain.no_labels(), np.full(1, np.inf), discs)
        return self._begun is not None

    def spread_to_frontiers(
        self, terrain: Terrain, start_m: Array, is_wanted: Array, count_max: int, discs: Iterable[Disc] = ()
    ) -> bool:
        """`spread` until the `count_max` nearest of the frontiers for which is_wanted (clusters + 1,) were found.

        Afterwards `nearest_of_labels` is right for these; others are further away than all of them, or not reached.
        """
        penalty_m = np.full(len(is_wanted), np.inf)  # no goal: the search goes on
        awaited = is_wanted.astype(np.int8), min(count_max, int(is_wanted.sum()))
        self.cheapest(terrain, start_m, terrain.labels, penalty_m, discs, awaited)
        return self._begun is not None

    def lengths_to_frontiers_m(self, terrain: Terrain, start_m: Array) -> Array | None:
        """(clusters + 1,) path cost [m] from a place to each frontier, infinite to those out of reach; None if the
        place is closed. A terrain remembers them: robots of a group ask for the same."""
        start = self._start(terrain, start_m)
        if start not in terrain.lengths_from:
            is_open = self.spread(terrain, start_m)
            found = self.nearest_of_labels(terrain, terrain.labels, len(terrain.clusters) - 1)[0]
            terrain.lengths_from[start] = found if is_open else None
        return terrain.lengths_from[start]

    def nearest_of_labels(self, terrain: Terrain, labels: Array, count: int) -> tuple[Array, Array]:
        """(count + 1,) path cost [m] to the nearest cell of each label, infinite if there is none, and (count + 1, 2)
        its centre in the map frame."""
        least, cell_of = np.full(count + 1, FAR, np.int32), np.full(count + 1, -1, np.int64)
        cells = terrain.frontier_cells if labels is terrain.labels else np.flatnonzero(labels)
        _least_per_label(
            labels, cells.astype(np.int32, copy=False), self._spent, self._opened, self._counts[_OPENED], least, cell_of
        )
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
        cell = _nearest_opened(row, column, width, self._opened, self._counts[_OPENED])
        return None if cell < 0 else terrain.to_metres(np.array([cell // width + 0.5, cell % width + 0.5]))

    def _start(self, terrain: Terrain, start_m: Array) -> int:
        row, column = np.floor(terrain.to_cells(start_m)).astype(int)
        return int(_nearest_enterable(terrain.cost, row, column, round(self.START_REACH_M / terrain.resolution_m)))

    def _raise_costs(self, terrain: Terrain, discs: tuple[Disc, ...]) -> int:
        values = np.array([[d.x_m, d.y_m, d.radius_m, d.extra] for d in discs])
        values[:, :2] = terrain.to_cells(values[:, :2])
        values[:, 2] /= terrain.resolution_m
        return _add_discs(terrain.cost, values, self._undo_cell, self._undo_cost)

    def _begin(self, terrain: Terrain, start: int, discs: tuple[Disc, ...]) -> None:
        """Begin a search at flat cell `start`, unless the last one began alike; a negative one is no search."""
        begun, size = self._begun, terrain.cost.size
        if begun is not None and begun[0]() is terrain.cost and begun[1:] == (start, discs):
            return
        if size > len(self._spent):
            room = size + size // 8
            self._spent, self._came = np.full(room, FAR, np.int32), np.empty(room, np.uint8)
            if room > len(self._settled):  # the part of it that no search reaches takes no memory
                self._opened, self._settled = lazy_zeros((2, 4 * room), np.int32)
            self._counts[_OPENED] = 0
        self._begun = None if start < 0 else (ref(terrain.cost), start, discs)
        if start < 0:
            self._spent[self._opened[: self._counts[_OPENED]]] = FAR
            self._counts[_OPENED] = 0
        else:
            own = self._spent, self._came, self._opened, self._head, self._waiting, self._counts
            _begin(start, *own)
