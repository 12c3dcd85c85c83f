"""Traversal costs and frontiers of an estimated occupancy grid, for robots of one radius."""

from __future__ import annotations

import math
from functools import cached_property

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
        line, source = kind[r, 1 : width - 1], log_odds[row_low + r - 1, column_low : column_low + width - 2]
        for c in range(width - 2):
            line[c] = WALL * np.int8(source[c] > wall_above) + FREE * np.int8(source[c] < free_below)


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
def _open_seen_through(kind, row, column, heading, ranges, behind, reach, is_met):
    """Mark as free the walls that the scan (beams,) from (row, column) [cells] passes through, further than `behind`
    before it ends, except within `reach` cells of where beams end; is_met (h, w) bool must be false.

    Negative ranges met no wall (`SensorFrame.ranges_m`).
    """
    height, width = kind.shape
    beams = ranges.shape[0]
    for b in range(beams):
        if ranges[b] > 0.0:
            angle = heading + 2.0 * math.pi * b / beams
            r, c = math.floor(row + ranges[b] * math.sin(angle)), math.floor(column + ranges[b] * math.cos(angle))
            is_met[max(r - reach, 0) : max(r + reach + 1, 0), max(c - reach, 0) : max(c + reach + 1, 0)] = True
    for b in range(beams):
        angle = heading + 2.0 * math.pi * b / beams
        dr, dc = 0.5 * math.sin(angle), 0.5 * math.cos(angle)
        for k in range(int(2.0 * (abs(ranges[b]) - behind))):
            r, c = math.floor(row + k * dr), math.floor(column + k * dc)
            if r < 1 or c < 1 or r >= height - 1 or c >= width - 1:
                break
            if kind[r, c] == WALL and not is_met[r, c]:
                kind[r, c] = FREE


@kernel
def _fill_cost(kind, reach, cost_of_squared, cost):
    """Fill cost (h, w) with the cost factors by squared clearance [cells^2]; 0 where no robot's centre may enter.

    The clearance, exact up to `reach`, is a separable Euclidean distance transform: along rows, then along columns,
    with the rows within reach of the present one in a ring, so that they stay in the inner caches.
    """
    height, width = kind.shape
    far, ring = np.uint16(reach * reach), 2 * reach + 1
    across, has_wall = np.empty((ring, width), np.uint16), np.zeros(ring, np.bool_)
    base, squared = np.empty(width, np.uint16), np.empty(width, np.uint16)
    for last in range(height + reach):
        if last < height:
            line, source = across[last % ring], kind[last]
            found = False
            for c in range(width):
                base[c] = np.uint16(0) if source[c] == WALL else far
                line[c] = base[c]
                found |= source[c] == WALL
            has_wall[last % ring] = found
            for d in range(1, reach + 1 if found else 0):
                d2 = np.uint16(d * d)
                low, high = line[: width - d], line[d:]
                right, left = base[d:], base[: width - d]
                for c in range(width - d):
                    low[c] = min(low[c], np.uint16(right[c] + d2))
                for c in range(width - d):
                    high[c] = min(high[c], np.uint16(left[c] + d2))
        r = last - reach
        if r < 0:
            continue
        squared[:] = across[r % ring]
        for other in range(max(r - reach, 0), min(r + reach + 1, height)):
            if other == r or not has_wall[other % ring]:
                continue
            line, d2 = across[other % ring], np.uint16((other - r) * (other - r))
            for c in range(width):
                squared[c] = min(squared[c], np.uint16(line[c] + d2))
        out, source = cost[r], kind[r]
        for c in range(width):
            out[c] = cost_of_squared[squared[c]] if source[c] == FREE else 0


@kernel
def _frontiers(kind, cost, labels, cells):
    """Label the clusters (8-connected) of free cells beside unknown ones; only enterable cells keep their label.

    labels (h, w) int32 must be zero; cells (k, 2) is scratch. Returns (clusters + 1, 3): size, mean row and mean column
    of the enterable cells; row 0 is unused; and the flat indices (n,) int32 of these cells. Clusters without enterable
    cells are omitted.
    """
    height, width = kind.shape
    found, is_frontier = 0, np.zeros(width, np.uint8)
    for r in range(1, height - 1):
        line, any_in_row = kind[r], 0
        up, down, left, right = kind[r - 1, 1 : width - 1], kind[r + 1, 1 : width - 1], line[: width - 2], line[2:]
        own, inner = line[1 : width - 1], is_frontier[1 : width - 1]
        for c in range(width - 2):  # without branches, many cells at once; UNKNOWN is the least kind
            inner[c] = (own[c] == FREE) & (min(min(up[c], down[c]), min(left[c], right[c])) == UNKNOWN)
        for c in range(width - 2):
            any_in_row += inner[c]
        if any_in_row == 0:
            continue
        for c in range(1, width - 1):
            if is_frontier[c] and found < cells.shape[0]:
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
def _close_corners(kind, margin, padded):
    """Make the cells right of, below and diagonally below walls walls in padded, where kind begins at the margin."""
    height, width = kind.shape
    for r in range(height):
        for c in range(width):
            if kind[r, c] == WALL:
                padded[r + margin : r + margin + 2, c + margin : c + margin + 2] = WALL


@kernel
def _labels_near(labels, middles, reach, size, found):
    """Fill found (k,) with the label of most cells in the square of half side `reach` around cells middles (k, 2)."""
    height, width = labels.shape
    counts = np.zeros(size, np.int32)
    for k in range(middles.shape[0]):
        rows = max(middles[k, 0] - reach, 0), min(middles[k, 0] + reach + 1, height)
        columns = max(middles[k, 1] - reach, 0), min(middles[k, 1] + reach + 1, width)
        best = 0
        for r in range(rows[0], rows[1]):
            for c in range(columns[0], columns[1]):
                label = labels[r, c]
                if label > 0:
                    counts[label] += 1
                    if counts[label] > counts[best] or (counts[label] == counts[best] and label < best):
                        best = label
        for r in range(rows[0], rows[1]):
            for c in range(columns[0], columns[1]):
                counts[labels[r, c]] = 0
        found[k] = best


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
    BEHIND_M, BESIDE_CELLS = 0.3, 1
    """A beam that ends further behind a wall, with none that ends this near to the wall, shows that it is gone."""

    def __init__(
        self,
        grid: GridMap,
        robot_radius_m: float,
        robots_m: Array | None = None,
        scan: tuple[Array, Array] | None = None,
    ):
        """robots_m (k, 2): positions of robots in the map frame, where walls of `grid` are ignored; scan: the pose (3,)
        and ranges (beams,) [m] of one that sees through doors that have opened since they were drawn."""
        self.resolution_m = cell = float(grid.resolution_m)
        row_low, row_high, column_low, column_high = _known_bounds(grid.log_odds)
        self.origin_m = np.asarray(grid.origin_m, float) + (np.array([column_low, row_low]) - 1) * cell
        shape = (row_high - row_low + 2, column_high - column_low + 2)
        self.kind = np.zeros(shape, np.int8)
        _classify(grid.log_odds, row_low, column_low, self.FREE_BELOW, self.WALL_ABOVE, self.kind)
        if robots_m is not None and len(robots_m):
            discs = np.column_stack([self.to_cells(robots_m), np.full(len(robots_m), 1.2 * robot_radius_m / cell)])
            _clear_discs(self.kind, discs)
        if scan is not None and len(scan[1]):
            (row, column), ranges = self.to_cells(scan[0][:2]), np.asarray(scan[1], float) / cell
            args = row, column, float(scan[0][2]), ranges, self.BEHIND_M / cell, self.BESIDE_CELLS
            _open_seen_through(self.kind, *args, np.zeros(shape, np.bool_))
        reach = math.ceil(max(self.COMFORT_M, robot_radius_m + self.EASE_M) / cell)
        self.cost = np.empty(shape, np.uint8)
        _fill_cost(self.kind, reach, _cost_factors((robot_radius_m + self.MARGIN_M) / cell, reach), self.cost)
        self._padded: dict[tuple[int, bool], Array] = {}
        self.lengths_from: dict[int, Array | None] = {}
        """By flat cell, see `PathFinder.lengths_to_frontiers_m`."""

    @classmethod
    def of(cls, belief: Belief, robot_radius_m: float, trusts_scan: bool = False) -> Terrain:
        """The terrain of a robot's map, with its own and its teammates' positions; trusts_scan: without the walls that
        its last scan sees through."""
        poses = np.array([belief.pose_map_robot, *belief.teammates.values()])
        scan = (poses[0], belief.ranges_m) if trusts_scan and belief.ranges_m is not None else None
        return cls(belief.grid, robot_radius_m, poses[:, :2], scan)

    @cached_property
    def _found(self) -> tuple[Array, Array, Array]:
        """Labels, clusters and cells of the frontiers; whoever plans to a place does not need them."""
        labels, cells = self.no_labels(), np.empty((self.kind.size // 2 + 1, 2), np.int32)
        return labels, *_frontiers(self.kind, self.cost, labels, cells)

    @property
    def labels(self) -> Array:
        """(h, w) int32: the label of each enterable frontier cell, 0 for all others."""
        return self._found[0]

    @property
    def clusters(self) -> Array:
        """(clusters + 1, 3): size, mean row and mean column of each frontier; label 0 is none."""
        return self._found[1]

    @property
    def frontier_cells(self) -> Array:
        """(k,) int32: flat indices of the cells that have a label."""
        return self._found[2]

    def padded_kind(self, margin: int, closes_walls: bool) -> Array:
        """(h + 2 margin, w + 2 margin) int8: the kinds, with unknown cells around them; to read, as it is kept.

        closes_walls: cells right of, below and diagonally below walls are walls, too.
        """
        key = margin, closes_walls
        if key not in self._padded:
            height, width = self.kind.shape
            padded = np.zeros((height + 2 * margin, width + 2 * margin), np.int8)
            padded[margin : margin + height, margin : margin + width] = self.kind
            if closes_walls:
                _close_corners(self.kind, margin, padded)
            self._padded[key] = padded
        return self._padded[key]

    def no_labels(self) -> Array:
        """(h, w) int32 zeros, to mark goals in; memory is only touched where it is used."""
        return np.zeros(self.cost.shape, np.int32)

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
        return int(self.labels_near(np.asarray(point_m)[None], reach_m)[0])

    def labels_near(self, points_m: Array, reach_m: float) -> Array:
        """(k,) int64: `label_near` of each of points_m (k, 2)."""
        middles, found = np.floor(self.to_cells(points_m)).astype(np.int64), np.zeros(len(points_m), np.int64)
        _labels_near(self.labels, middles, round(reach_m / self.resolution_m), len(self.clusters), found)
        return found

    def is_open(self, points_m: Array) -> Array:
        """(k,) whether each of points_m (k, 2) lies in an enterable cell."""
        cells = np.floor(self.to_cells(points_m)).astype(int)
        inside = np.all((cells >= 0) & (cells < self.cost.shape), axis=1)
        r, c = np.where(inside[:, None], cells, 0).T
        return inside & (self.cost[r, c] > 0)


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
