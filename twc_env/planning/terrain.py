"""Traversal costs and frontiers of an estimated occupancy grid, for robots of one radius."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.kernels.compiled import kernel
from twc_env.records.messages import Belief, GridMap

UNKNOWN, FREE, WALL = 0, 1, 2
OPEN_COST = 2
"""Cost factor of cells far from walls; cells near walls have a greater one, closed cells 0."""


@kernel
def _known_bounds(log_odds):
    """Bounds of the known cells: first and last + 1 row, then column; all zero if no cell is known."""
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


@kernel
def _classify(log_odds, row_low, column_low, free_below, wall_above, kind):
    """Fill the interior of kind (h, w) with UNKNOWN, FREE or WALL; kind[1, 1] is cell (row_low, column_low)."""
    height, width = kind.shape
    for r in range(1, height - 1):
        for c in range(1, width - 1):
            value = log_odds[row_low + r - 1, column_low + c - 1]
            kind[r, c] = WALL if value > wall_above else (FREE if value < free_below else UNKNOWN)


@kernel
def _clear_discs(kind, discs):
    """Mark the cells in discs (k, 3: row, column, radius in cells) as free: robots stand there."""
    height, width = kind.shape
    for k in range(discs.shape[0]):
        row, column, radius = discs[k]
        reach = int(radius) + 1
        for r in range(max(1, int(row) - reach), min(height - 1, int(row) + reach + 1)):
            for c in range(max(1, int(column) - reach), min(width - 1, int(column) + reach + 1)):
                if (r + 0.5 - row) ** 2 + (c + 0.5 - column) ** 2 <= radius * radius:
                    kind[r, c] = FREE


@kernel
def _squared_clearance(kind, reach, across, squared):
    """Fill squared (h, w) with the squared distance [cells^2] to the nearest wall, exact up to `reach`.

    Separable Euclidean distance transform, along rows into across (h, w), then along columns.
    """
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


@kernel
def _fill_cost(kind, squared, cost_of_squared, cost):
    """Fill cost (h, w) with the cost factors; 0 for cells that no robot's centre may enter."""
    height, width = kind.shape
    top = cost_of_squared.shape[0] - 1
    for r in range(height):
        for c in range(width):
            cost[r, c] = cost_of_squared[min(int(squared[r, c]), top)] if kind[r, c] == FREE else 0


@kernel
def _frontiers(kind, cost, labels, cells):
    """Label the clusters (8-connected) of free cells beside unknown ones; only enterable cells keep their label.

    labels (h, w) int32 must be zero; cells (k, 2) is scratch. Returns (clusters + 1, 3): size, mean row and mean column
    of the enterable cells; row 0 is unused; and the flat indices (n,) int32 of these cells. Clusters without enterable
    cells are omitted.
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
        _flood_fill(cost, labels, cells[k, 0], cells[k, 1], count, clusters)
    enterable, size = np.empty(found, np.int32), 0
    for k in range(found):
        if cost[cells[k, 0], cells[k, 1]] == 0:
            labels[cells[k, 0], cells[k, 1]] = 0
        else:
            enterable[size] = cells[k, 0] * width + cells[k, 1]
            size += 1
    return clusters[: count + 1], enterable[:size].copy()


@kernel
def _flood_fill(cost, labels, row, column, label, clusters):
    """Label the cluster of cells labelled -1 around (row, column) and fill clusters[label]."""
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


@kernel
def is_wall_near(log_odds, row, column, wall_above, reach):
    """Whether the centre of a wall cell lies within `reach` cells of the point (row, column) [cells]."""
    height, width = log_odds.shape
    limit = reach * reach
    span = int(reach) + 1
    middle_row, middle_column = math.floor(row), math.floor(column)
    for r in range(max(0, middle_row - span), min(height, middle_row + span + 1)):
        for c in range(max(0, middle_column - span), min(width, middle_column + span + 1)):
            if log_odds[r, c] > wall_above and (r + 0.5 - row) ** 2 + (c + 0.5 - column) ** 2 < limit:
                return True
    return False


@kernel
def _has_wall_near(log_odds, rows, columns, wall_above, reach):
    """Whether `is_wall_near` holds for any of the points (rows, columns) [cells]."""
    found, k = False, 0
    while k < rows.shape[0] and not found:
        found, k = is_wall_near(log_odds, rows[k], columns[k], wall_above, reach), k + 1
    return found


@kernel
def has_frontier_near(log_odds, row, column, reach, free_below):
    """Whether a free cell within `reach` cells of (row, column) has an unknown neighbour."""
    height, width = log_odds.shape
    for r in range(max(1, row - reach), min(height - 1, row + reach + 1)):
        for c in range(max(1, column - reach), min(width - 1, column + reach + 1)):
            if log_odds[r, c] < free_below and (
                log_odds[r - 1, c] == 0 or log_odds[r + 1, c] == 0 or log_odds[r, c - 1] == 0 or log_odds[r, c + 1] == 0
            ):
                return True
    return False


class Terrain:
    """The known part of an estimated grid with a closed border of one cell, for robots of one radius."""

    FREE_BELOW = 0
    WALL_ABOVE = 0
    MARGIN_M = 0.03
    """Added to the radius for the least clearance."""
    COMFORT_M = 0.6
    """Clearance from which the cost factor is `OPEN_COST` ..."""
    EASE_M = 0.2
    """... or this plus the radius, if that is more."""
    WALL_PRICE = 20
    """Cost factor at the least clearance."""

    def __init__(self, grid: GridMap, robot_radius_m: float, robots_m: Array | None = None):
        """robots_m (k, 2): positions of robots in the map frame, where walls of `grid` are ignored."""
        self.resolution_m = cell = float(grid.resolution_m)
        row_low, row_high, column_low, column_high = _known_bounds(grid.log_odds)
        self.origin_m = np.asarray(grid.origin_m, float) + (np.array([column_low, row_low]) - 1) * cell
        shape = (row_high - row_low + 2, column_high - column_low + 2)
        self.kind = np.zeros(shape, np.int8)
        _classify(grid.log_odds, row_low, column_low, self.FREE_BELOW, self.WALL_ABOVE, self.kind)
        if robots_m is not None and len(robots_m):
            discs = np.column_stack([self.to_cells(robots_m), np.full(len(robots_m), 1.2 * robot_radius_m / cell)])
            _clear_discs(self.kind, discs)
        reach = math.ceil(max(self.COMFORT_M, robot_radius_m + self.EASE_M) / cell)
        squared = np.empty(shape, np.float32)
        _squared_clearance(self.kind, reach, np.empty(shape, np.float32), squared)
        self.cost = np.empty(shape, np.uint8)
        limit = (robot_radius_m + self.MARGIN_M) / cell
        _fill_cost(self.kind, squared, _cost_factors(limit, reach), self.cost)
        self.labels = np.zeros(shape, np.int32)
        cells = np.empty((self.kind.size // 2 + 1, 2), np.int32)
        self.clusters, self.frontier_cells = _frontiers(self.kind, self.cost, self.labels, cells)
        """Size, mean row and mean column of each frontier; flat indices (k,) of the enterable cells of all."""
        self.lengths_from: dict[int, Array | None] = {}
        """By flat cell, see `PathFinder.lengths_to_frontiers_m`."""

    @classmethod
    def of(cls, belief: Belief, robot_radius_m: float) -> Terrain:
        """The terrain of a robot's map, with its own and its teammates' positions."""
        poses = np.array([belief.pose_map_robot, *belief.teammates.values()])
        return cls(belief.grid, robot_radius_m, poses[:, :2])

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
        """Rows and columns of the square of half side `reach_m` around a point."""
        reach = round(reach_m / self.resolution_m)
        row, column = (math.floor(v) for v in self.to_cells(point_m))
        rows = slice(max(row - reach, 0), max(row + reach + 1, 0))
        return rows, slice(max(column - reach, 0), max(column + reach + 1, 0))

    def label_near(self, point_m: Array, reach_m: float) -> int:
        """Label of the frontier with most cells in the square of half side `reach_m` around a point; 0 if none."""
        patch = self.labels[self.patch(point_m, reach_m)]
        found = patch[patch > 0]
        return int(np.bincount(found).argmax()) if len(found) else 0

    def is_open(self, points_m: Array) -> Array:
        """(k,) whether each of points_m (k, 2) lies in an enterable cell."""
        cells = np.floor(self.to_cells(points_m)).astype(int)
        inside = np.all((cells >= 0) & (cells < self.cost.shape), axis=1)
        r, c = np.where(inside[:, None], cells, 0).T
        return inside & (self.cost[r, c] > 0)


def path_is_blocked(grid: GridMap, points_m: Array, robot_radius_m: float) -> bool:
    """Whether any of points_m (k, 2) is nearer to a wall of the grid than the robot's radius."""
    columns, rows = ((np.asarray(points_m) - grid.origin_m) / grid.resolution_m).T
    reach = robot_radius_m / grid.resolution_m
    return bool(_has_wall_near(grid.log_odds, rows.copy(), columns.copy(), Terrain.WALL_ABOVE, reach))


def is_frontier(grid: GridMap, point_m: Array, reach_m: float) -> bool:
    """Whether the grid has a frontier in the square of half side `reach_m` around a point."""
    column, row = (math.floor(v) for v in (np.asarray(point_m) - grid.origin_m) / grid.resolution_m)
    return bool(has_frontier_near(grid.log_odds, row, column, round(reach_m / grid.resolution_m), Terrain.FREE_BELOW))


def _cost_factors(limit_cells: float, reach_cells: int) -> Array:
    """Cost factors by squared clearance [cells^2]: 0 below the limit, then falling to OPEN_COST at the reach."""
    distance = np.sqrt(np.arange(reach_cells * reach_cells + 1))
    near = np.clip((reach_cells - distance) / max(reach_cells - limit_cells, 1e-9), 0.0, 1.0)
    price = OPEN_COST + (Terrain.WALL_PRICE - OPEN_COST) * near**3
    return np.where(distance < limit_cells, 0, np.round(price)).astype(np.uint8)
