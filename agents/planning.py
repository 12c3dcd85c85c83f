"""Find frontiers and paths on an estimated occupancy grid (compiled kernels).

A `Terrain` is one grid read for robots of a given radius: which cells a robot's centre may enter, at what cost, and
where the known part ends. A `PathFinder` then finds for one robot the cheapest goal and the path to it.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from twc_env.messages import GridMap

Array = NDArray

UNKNOWN, FREE, WALL = 0, 1, 2
UNITS_PER_CELL = 10
"""Path costs are integers: one step to a side in the open costs this much."""
OPEN_COST = 2
"""Cost factor of a cell far from walls; others cost more, 0 is closed."""
STRAIGHT, DIAGONAL = 5, 7
COST_MAX = 140
COMFORT_COST = 3
"""A shortcut may always cross cells up to this cost factor."""
LOOK_CELLS, GIVE_UP_CELLS = 120, 12
"""How far ahead shortcuts are tried, and after how many failures in a row no further."""
BUCKETS = 1024
"""More than the dearest edge, `DIAGONAL * COST_MAX`."""
FAR = np.int32(2**30)


@dataclass(frozen=True, slots=True)
class Disc:
    """A round place that costs extra to cross: a mate, or something the map does not show."""

    x_m: float
    y_m: float
    radius_m: float
    extra: int
    """Added to the cost factor of its cells (`OPEN_COST` is the factor of open floor)."""


@njit(cache=True, error_model="numpy")
def _known_box(log_odds):
    """Rows and columns (first, last + 1) that hold anything known; all zero when nothing is."""
    height, width = log_odds.shape
    in_column = np.zeros(width, np.int16)
    row_low, row_high = height, 0
    for r in range(height):
        row = log_odds[r]
        seen = np.int16(0)
        for c in range(width):
            seen |= row[c]
            in_column[c] |= row[c]
        if seen != 0:
            row_low, row_high = min(row_low, r), r + 1
    if row_high == 0:
        return 0, 0, 0, 0
    columns = np.flatnonzero(in_column)
    return row_low, row_high, columns[0], columns[-1] + 1


@njit(cache=True, error_model="numpy")
def _classify(log_odds, row_low, column_low, free_below, wall_above, kind):
    """Fill kind (h, w) from the cells whose [0, 0] lies one cell outside the known box."""
    height, width = kind.shape
    for r in range(1, height - 1):
        for c in range(1, width - 1):
            value = log_odds[row_low + r - 1, column_low + c - 1]
            kind[r, c] = WALL if value > wall_above else (FREE if value < free_below else UNKNOWN)


@njit(cache=True, error_model="numpy")
def _free_discs(kind, discs):
    """A robot stands on each of discs (k, 3: row, column, radius in cells), so no wall is there."""
    height, width = kind.shape
    for k in range(discs.shape[0]):
        row, column, radius = discs[k]
        reach = int(radius) + 1
        for r in range(max(1, int(row) - reach), min(height - 1, int(row) + reach + 1)):
            for c in range(max(1, int(column) - reach), min(width - 1, int(column) + reach + 1)):
                if (r + 0.5 - row) ** 2 + (c + 0.5 - column) ** 2 <= radius * radius:
                    kind[r, c] = FREE


@njit(cache=True, error_model="numpy")
def _squared_clearance(kind, reach, across, squared):
    """Squared distance in cells to the nearest wall, exact up to `reach`; both outputs (h, w) float32."""
    height, width = kind.shape
    far = np.float32(2 * reach * reach)
    base = np.empty(width, np.float32)
    for r in range(height):
        line, source, has_wall = across[r], kind[r], False
        for c in range(width):
            base[c] = np.float32(0.0) if source[c] == WALL else far
            has_wall |= source[c] == WALL
            line[c] = base[c]
        for d in range(1, reach + 1 if has_wall else 0):
            d2 = np.float32(d * d)
            low, high = line[: width - d], line[d:]
            right, left = base[d:], base[: width - d]
            for c in range(width - d):
                low[c] = min(low[c], right[c] + d2)
            for c in range(width - d):
                high[c] = min(high[c], left[c] + d2)
    for r in range(height):
        out, line = squared[r], across[r]
        for c in range(width):
            out[c] = line[c]
        for d in range(1, reach + 1):
            d2 = np.float32(d * d)
            above, below = across[max(r - d, 0)], across[min(r + d, height - 1)]
            for c in range(width):
                out[c] = min(out[c], min(above[c], below[c]) + d2)


@njit(cache=True, error_model="numpy")
def _price(kind, squared, price_of_squared, cost):
    """Cost factor of each cell: 0 where a robot's centre may not be."""
    height, width = kind.shape
    top = price_of_squared.shape[0] - 1
    for r in range(height):
        for c in range(width):
            cost[r, c] = price_of_squared[min(int(squared[r, c]), top)] if kind[r, c] == FREE else 0


@njit(cache=True, error_model="numpy")
def _frontiers(kind, cost, labels, cells):
    """Label clusters (8-neighbours) of free cells beside unknown ones; only cells a robot may enter keep their label.

    labels (h, w) int32 must come zeroed; cells (k, 2) is scratch. Returns per cluster its size, and mean row and mean
    column of its enterable cells, shape (clusters + 1, 3), index 0 unused. Clusters without any are left out.
    """
    height, width = kind.shape
    found = 0
    for r in range(1, height - 1):
        for c in range(1, width - 1):
            if kind[r, c] == FREE and (
                kind[r - 1, c] == UNKNOWN
                or kind[r + 1, c] == UNKNOWN
                or kind[r, c - 1] == UNKNOWN
                or kind[r, c + 1] == UNKNOWN
            ):
                if found == cells.shape[0]:
                    break
                labels[r, c] = -1
                cells[found, 0], cells[found, 1] = r, c
                found += 1
    clusters = np.zeros((found + 1, 3))
    count = 0
    for k in range(found):
        if labels[cells[k, 0], cells[k, 1]] != -1 or cost[cells[k, 0], cells[k, 1]] == 0:
            continue
        count += 1
        _gather(cost, labels, cells[k, 0], cells[k, 1], count, clusters)
    for k in range(found):
        if cost[cells[k, 0], cells[k, 1]] == 0:
            labels[cells[k, 0], cells[k, 1]] = 0
    return clusters[: count + 1]


@njit(cache=True, error_model="numpy")
def _gather(cost, labels, row, column, label, clusters):
    """Flood one cluster of cells labelled -1 from (row, column) and sum it up in clusters[label]."""
    height, width = labels.shape
    stack = [(row, column)]
    labels[row, column] = label
    enterable = 0
    while stack:
        r, c = stack.pop()
        clusters[label, 0] += 1
        if cost[r, c] > 0:
            enterable += 1
            clusters[label, 1] += r
            clusters[label, 2] += c
        for i in range(max(r - 1, 0), min(r + 2, height)):
            for j in range(max(c - 1, 0), min(c + 2, width)):
                if labels[i, j] == -1:
                    labels[i, j] = label
                    stack.append((i, j))
    clusters[label, 1] /= enterable
    clusters[label, 2] /= enterable


@njit(cache=True, error_model="numpy")
def _add_discs(cost, discs, undo_cell, undo_cost):
    """Raise the cost of open cells inside discs (k, 4: row, column, radius, extra); returns how many to undo."""
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


@njit(cache=True, error_model="numpy")
def _undo(cost, undo_cell, undo_cost, changed):
    """Give back the costs `_add_discs` changed, in reverse order."""
    width = cost.shape[1]
    for k in range(changed - 1, -1, -1):
        cost[undo_cell[k] // width, undo_cell[k] % width] = undo_cost[k]


@njit(cache=True, error_model="numpy")
def _nearest_open(cost, row, column, reach):
    """The enterable cell nearest to (row, column) within `reach` cells, as flat index; -1 if there is none."""
    height, width = cost.shape
    best, nearest = -1, reach * reach + 1
    for r in range(max(1, row - reach), min(height - 1, row + reach + 1)):
        for c in range(max(1, column - reach), min(width - 1, column + reach + 1)):
            away = (r - row) ** 2 + (c - column) ** 2
            if cost[r, c] > 0 and away < nearest:
                best, nearest = r * width + c, away
    return best


@njit(cache=True, error_model="numpy")
def _cheapest_goal(cost, labels, penalty, start, spent, parent, following, preceding, opened, opened_count):
    """Dijkstra with a bucket queue from flat cell `start` to the labelled cell of least path cost + penalty[label].

    cost, labels (h, w) with a closed border; spent, parent, following, preceding, opened are flat scratch arrays that
    persist between calls: `spent` must be FAR except at opened[:opened_count]. Returns (goal or -1, its path cost,
    cells opened).
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
    best, best_total = -1, FAR
    while waiting:
        cell = head[now % BUCKETS]
        if cell < 0:
            now += 1
            continue
        if now >= best_total:
            break
        head[now % BUCKETS] = following[cell]
        if following[cell] >= 0:
            preceding[following[cell]] = -1
        preceding[cell] = -2  # settled
        waiting -= 1
        label = label_of[cell]
        if label > 0 and now + penalty[label] < best_total:
            best, best_total = cell, now + penalty[label]
        for k in range(8):
            neighbour = cell + steps[k]
            old = spent[neighbour]
            if old <= now + STRAIGHT * OPEN_COST:
                continue
            factor = flat[neighbour]
            if factor == 0:
                continue
            if k >= 4:  # no cutting of corners
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


@njit(cache=True, error_model="numpy")
def _trace(parent, goal, width):
    """The cells (k, 2) from the start to `goal`."""
    length, cell = 0, goal
    while cell >= 0:
        length, cell = length + 1, parent[cell]
    path = np.empty((length, 2), np.int32)
    cell = goal
    for k in range(length - 1, -1, -1):
        path[k, 0], path[k, 1] = cell // width, cell % width
        cell = parent[cell]
    return path


@njit(cache=True, error_model="numpy")
def _line_cost(cost, row_a, column_a, row_b, column_b):
    """Highest cost factor on the straight line between two points (in cells); COST_MAX + 1 if one is closed."""
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


@njit(cache=True, error_model="numpy")
def _shortcut(path, cost):
    """Straighten path (k, 2): keep a corner only where the straight line would cross dearer cells (nearer to a wall).

    Returns (j, 2) float cell centres.
    """
    count = path.shape[0]
    kept = np.empty((count, 2), np.float64)
    kept[0] = path[0] + 0.5
    size, anchor = 1, 0
    while anchor < count - 1:
        far, highest = anchor + 1, COMFORT_COST
        for k in range(anchor + 1, min(count, anchor + LOOK_CELLS)):
            highest = max(highest, cost[path[k, 0], path[k, 1]])
            line = _line_cost(cost, path[anchor, 0] + 0.5, path[anchor, 1] + 0.5, path[k, 0] + 0.5, path[k, 1] + 0.5)
            if line <= highest:
                far = k
            elif k > far + GIVE_UP_CELLS:
                break
        kept[size] = path[far] + 0.5
        size, anchor = size + 1, far
    return kept[:size]


@njit(cache=True, error_model="numpy")
def _blocked(log_odds, rows, columns, wall_above, reach):
    """Whether a wall cell lies within `reach` cells of any of the points (in cells)."""
    height, width = log_odds.shape
    limit = reach * reach
    span = int(reach) + 1
    for k in range(rows.shape[0]):
        row, column = math.floor(rows[k]), math.floor(columns[k])
        for r in range(max(0, row - span), min(height, row + span + 1)):
            for c in range(max(0, column - span), min(width, column + span + 1)):
                if log_odds[r, c] > wall_above and (r + 0.5 - rows[k]) ** 2 + (c + 0.5 - columns[k]) ** 2 < limit:
                    return True
    return False


@njit(cache=True, error_model="numpy")
def _any_frontier(log_odds, row, column, reach, free_below):
    """Whether a free cell within `reach` of (row, column) has an unknown neighbour."""
    height, width = log_odds.shape
    for r in range(max(1, row - reach), min(height - 1, row + reach + 1)):
        for c in range(max(1, column - reach), min(width - 1, column + reach + 1)):
            if log_odds[r, c] < free_below and (
                log_odds[r - 1, c] == 0 or log_odds[r + 1, c] == 0 or log_odds[r, c - 1] == 0 or log_odds[r, c + 1] == 0
            ):
                return True
    return False


class Terrain:
    """One estimated grid, read for robots of one radius. Row 0, column 0 is a closed border cell."""

    FREE_BELOW = 0
    WALL_ABOVE = 0
    MARGIN_M = 0.03
    """Added to the radius: nearer to a wall than this no path is planned."""
    COMFORT_M = 0.6
    """Beyond this clearance open floor costs no more."""
    WALL_PRICE = 20
    """Cost factor right at the nearest allowed clearance."""

    def __init__(self, grid: GridMap, robot_radius_m: float, robots_m: Array | None = None):
        """Read `grid`; robots_m (k, 2) are places where robots stand, so walls there are ghosts."""
        self.resolution_m = cell = float(grid.resolution_m)
        row_low, row_high, column_low, column_high = _known_box(grid.log_odds)
        self.origin_m = np.asarray(grid.origin_m, float) + (np.array([column_low, row_low]) - 1) * cell
        shape = (row_high - row_low + 2, column_high - column_low + 2)
        self.kind = np.zeros(shape, np.int8)
        _classify(grid.log_odds, row_low, column_low, self.FREE_BELOW, self.WALL_ABOVE, self.kind)
        if robots_m is not None and len(robots_m):
            discs = np.column_stack([self.to_cells(robots_m), np.full(len(robots_m), 1.2 * robot_radius_m / cell)])
            _free_discs(self.kind, discs)
        reach = math.ceil(self.COMFORT_M / cell)
        squared = np.empty(shape, np.float32)
        _squared_clearance(self.kind, reach, np.empty(shape, np.float32), squared)
        self.cost = np.empty(shape, np.int16)
        limit = (robot_radius_m + self.MARGIN_M) / cell
        _price(self.kind, squared, _prices(limit, reach), self.cost)
        self.labels = np.zeros(shape, np.int32)
        self.clusters = _frontiers(self.kind, self.cost, self.labels, np.empty((self.kind.size // 2 + 1, 2), np.int32))

    @property
    def frontier_sizes(self) -> Array:
        """(clusters + 1,) cells of each frontier; label 0 is none."""
        return self.clusters[:, 0]

    @property
    def frontier_centres_m(self) -> Array:
        """(clusters + 1, 2) mean position of each frontier in the map frame."""
        return self.to_metres(self.clusters[:, 1:] + 0.5)

    def to_cells(self, points_m: Array) -> Array:
        """(..., 2) points in the map frame -> (..., 2) fractional (row, column)."""
        return ((np.asarray(points_m, float) - self.origin_m) / self.resolution_m)[..., ::-1]

    def to_metres(self, cells: Array) -> Array:
        """(..., 2) fractional (row, column) -> (..., 2) points in the map frame."""
        return self.origin_m + np.asarray(cells, float)[..., ::-1] * self.resolution_m

    def patch(self, point_m: Array, reach_m: float) -> tuple[slice, slice]:
        """The rows and columns within `reach_m` (a square) of a point."""
        reach = round(reach_m / self.resolution_m)
        row, column = (math.floor(v) for v in self.to_cells(point_m))
        rows = slice(max(row - reach, 0), max(row + reach + 1, 0))
        return rows, slice(max(column - reach, 0), max(column + reach + 1, 0))

    def label_near(self, point_m: Array, reach_m: float) -> int:
        """The frontier that has a cell within `reach_m` (a square) of a point; 0 if none."""
        patch = self.labels[self.patch(point_m, reach_m)]
        found = patch[patch > 0]
        return int(np.bincount(found).argmax()) if len(found) else 0

    def is_open(self, points_m: Array) -> Array:
        """(k,) whether a robot's centre may be at each of points_m (k, 2)."""
        cells = np.floor(self.to_cells(points_m)).astype(int)
        inside = np.all((cells >= 0) & (cells < self.cost.shape), axis=1)
        r, c = np.where(inside[:, None], cells, 0).T
        return inside & (self.cost[r, c] > 0)


@dataclass(frozen=True, slots=True, eq=False)
class Plan:
    """A way to a goal."""

    path_m: Array
    """(k, 2) corners in the map frame, start first."""
    length_m: float
    """Length it feels like: stretches near walls and discs count more."""
    label: int
    """Label of the goal."""


class PathFinder:
    """Cheapest-goal search with scratch memory that lives on between searches."""

    START_REACH_M = 0.6
    """A robot whose own cell is closed starts from an open one within this distance."""

    def __init__(self) -> None:
        self._capacity = 0
        self._opened_count = 0
        self._undo_cell, self._undo_cost = np.empty(200_000, np.int64), np.empty(200_000, np.int16)

    def cheapest(
        self, terrain: Terrain, start_m: Array, labels: Array, penalty_m: Array, discs: Iterable[Disc] = ()
    ) -> Plan | None:
        """The best labelled cell: least path length plus penalty_m[label]; None when no labelled cell can be reached.

        labels (h, w) int32 over the terrain's cells, 0 for no goal. A penalty of infinity bans a label.
        """
        self._reserve(terrain.cost.size)
        cell = terrain.resolution_m
        row, column = np.floor(terrain.to_cells(start_m)).astype(int)
        start = _nearest_open(terrain.cost, row, column, round(self.START_REACH_M / cell))
        if start < 0:
            return None
        units = UNITS_PER_CELL / cell
        penalty = np.minimum(np.asarray(penalty_m, float) * units, float(FAR)).astype(np.int32)
        discs = tuple(discs)
        changed = self._raise(terrain, discs) if discs else 0
        goal, spent, self._opened_count = _cheapest_goal(
            terrain.cost, labels, penalty, start, self._spent, self._parent, self._following, self._preceding,
            self._opened, self._opened_count,
        )  # fmt: skip
        corners = np.empty((0, 2))
        if goal >= 0:
            corners = _shortcut(_trace(self._parent, goal, terrain.cost.shape[1]), terrain.cost)
        if changed:
            _undo(terrain.cost, self._undo_cell, self._undo_cost, changed)
        if goal < 0:
            return None
        return Plan(terrain.to_metres(corners), spent / units, int(labels.reshape(-1)[goal]))

    def _raise(self, terrain: Terrain, discs: tuple[Disc, ...]) -> int:
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


def path_is_blocked(grid: GridMap, points_m: Array, robot_radius_m: float) -> bool:
    """Whether the newest grid shows a wall nearer than the robot's radius to any of points_m (k, 2)."""
    columns, rows = ((np.asarray(points_m) - grid.origin_m) / grid.resolution_m).T
    reach = robot_radius_m / grid.resolution_m
    return bool(_blocked(grid.log_odds, rows.copy(), columns.copy(), Terrain.WALL_ABOVE, reach))


def is_frontier(grid: GridMap, point_m: Array, reach_m: float) -> bool:
    """Whether the newest grid still has a frontier within `reach_m` (a square) of a point."""
    column, row = (math.floor(v) for v in (np.asarray(point_m) - grid.origin_m) / grid.resolution_m)
    return bool(_any_frontier(grid.log_odds, row, column, round(reach_m / grid.resolution_m), Terrain.FREE_BELOW))


def _prices(limit_cells: float, reach_cells: int) -> Array:
    """Cost factor by squared clearance in cells: 0 below the limit, falling to OPEN_COST at the reach."""
    distance = np.sqrt(np.arange(reach_cells * reach_cells + 1))
    near = np.clip((reach_cells - distance) / max(reach_cells - limit_cells, 1e-9), 0.0, 1.0)
    price = OPEN_COST + (Terrain.WALL_PRICE - OPEN_COST) * near**3
    return np.where(distance < limit_cells, 0, np.round(price)).astype(np.int16)
