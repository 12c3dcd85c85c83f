"""Occupancy grid of log-odds cells that grows with the observed area: below 0 free, above 0 wall, 0 unknown."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.errors import DataError
from twc_env.kernels.compiled import BindsAnew, Lent, bound, rebound
from twc_env.records.messages import GridMap
from twc_env.slam.scans.cell_kinds import note_kinds
from twc_env.slam.scans.scan_integration import BLOCK_COLUMNS, BLOCK_ROWS, folding_room, integrate_many
from twc_env.slam.scans.sparse_scans import SparseScans

ROUNDING_M = 1e-9
"""A box that ends this close to the grid's border may lie outside after the grid has grown on another side."""
CELLS_MAX = 2**31
"""4 GB of cells; a map that needs more comes from wrong poses."""
SURE_FREE, SURE_WALL = -12, 20
"""Log-odds of certain cells (`map_merging`): three scans see through free floor, two meet a wall."""
NOWHERE_M = (math.inf, math.inf, -math.inf, -math.inf)
"""An empty box: left, bottom, right, top."""


class OccupancyGrid(BindsAnew):
    """A log-odds grid that grows on demand."""

    PADDING_M = 6.0

    def __init__(self, resolution_m: float, range_max_m: float, beam_count: int, has_kinds: bool = True):
        """has_kinds: whether it keeps `GridMap.kinds`, for pictures and observations."""
        self.resolution_m, self._has_kinds = resolution_m, has_kinds
        self.range_max_m = range_max_m
        self._sparse = SparseScans(beam_count, range_max_m)
        self._room = folding_room(self._sparse.beam_count, int(2 * range_max_m / resolution_m) + 8)
        self._reached_m = np.zeros(4)
        self._run: Callable[..., bool] | None = None
        """`integrate_many` bound to the arrays of this grid."""
        self.clear()

    def clear(self) -> None:
        """Remove all cells."""
        self.log_odds = np.zeros((0, 0), np.int16)
        self.origin_m = np.zeros(2)
        self._kinds = np.zeros((0, 0), np.uint8)
        self._touched, self._numbers = np.zeros((0, 0), np.int64), np.zeros(1, np.int64)
        """As `GridMap.touched`; the number of integrated scans."""
        self._boxes_m = np.array([NOWHERE_M] * 2)
        """Bounding boxes [m] of all cells, and of cells that scans may have touched."""
        self._snapshot: GridMap | None = None
        self._rebind()

    def take_over(self, other: OccupancyGrid) -> None:
        """Copy the state of another grid."""
        self.log_odds, self.origin_m = other.log_odds.copy(), other.origin_m.copy()
        self._kinds = other._kinds.copy() if self._has_kinds else self._kinds
        self._touched, self._numbers = other._touched.copy(), other._numbers.copy()
        self._boxes_m, self._snapshot = other._boxes_m.copy(), None
        self._rebind()

    def begin_with(self, grid: GridMap) -> None:
        """Begin with the cells of an older grid of the same resolution, of which newer scans need few to outweigh it:
        certain cells are just certain (`SURE_FREE`, `SURE_WALL`)."""
        cells, cell = np.clip(grid.log_odds, SURE_FREE, SURE_WALL).astype(np.int16), self.resolution_m
        left, bottom = np.round(np.asarray(grid.origin_m) / cell).astype(int).tolist()
        self.clear()
        rows, columns = cells.shape
        self.log_odds, self.origin_m = np.ascontiguousarray(cells), np.array([left * cell, bottom * cell])
        self._kinds = np.zeros(cells.shape, np.uint8)
        note_kinds(self.log_odds, 0, 0, rows, columns, self._kinds)
        self._touched = np.zeros((-(-rows // BLOCK_ROWS), -(-columns // BLOCK_COLUMNS)), np.int64)
        self._boxes_m[:] = *self.origin_m, *(self.origin_m + np.array([columns, rows]) * cell)
        self._rebind()

    def integrate(self, poses: Array, scans: Array) -> None:
        """Integrate scans (k, beams) [m] taken at poses (k, 3); a negative range marks free space up to it, without a
        wall.

        Raises DataError for poses that are not finite, or so large or far apart that no grid can hold the cells between
        them.
        """
        if len(poses) == 0:
            return
        poses, scans = np.ascontiguousarray(poses, float), self._sparse.filled(np.ascontiguousarray(scans, float))
        if not self._fold_in(poses, scans):
            if not np.isfinite(poses).all():
                worst = poses[~np.isfinite(poses).all(axis=1)][0]
                raise DataError(f"poses (x, y, heading) must be finite; got {worst.tolist()}")
            self._grow(self._reached_m[:2], self._reached_m[2:])
            if not self._fold_in(poses, scans):
                raise self._too_far()

    def _too_far(self) -> DataError:
        reached = ", ".join(f"{reached:.6g}" for reached in self._reached_m)
        return DataError(
            f"no grid of {self.resolution_m:g} m cells holds scans that reach {reached} m (left, bottom, right, top): "
            "look at the units of odometry and gyro"
        )

    def _fold_in(self, poses: Array, scans: Array) -> bool:
        """Integrate; returns False, with nothing changed, if scans reach beyond the grid or a pose is not finite."""
        if self._run is None:
            self._run = bound(integrate_many, self._packed(), poses, scans)
        return self._run(poses, scans)

    def _packed(self) -> Lent:
        """The constant arguments of `integrate_many`."""
        parts = (
            self.log_odds, self._kinds, self._touched, self._numbers, self._boxes_m, 1.0 / self.resolution_m,
            self._sparse.directions, self.range_max_m, self._reached_m, self._room,
        )  # fmt: skip
        return Lent(parts)

    def _rebind(self) -> None:
        """Update the bound kernel after arrays were replaced."""
        if self._run is not None:
            self._run = rebound(self._run, self._packed())

    def snapshot(self) -> GridMap:
        """A read-only view of the current cells; valid until the next `integrate`."""
        if self._snapshot is None:
            views = self.log_odds.view(), self.origin_m.view(), self._kinds.view(), self._touched.view()
            for view in views:
                view.flags.writeable = False
            cells, origin_m, kinds, touched = views
            self._snapshot = GridMap(cells, origin_m, self.resolution_m, kinds if self._has_kinds else None, touched)
        return self._snapshot

    def known_box(self) -> tuple[int, int, int, int]:
        """First row and column, end row and column of the bounding box of known cells."""
        left, bottom, right, top = self._boxes_m[1].tolist()
        if left > right:
            return 0, 0, 0, 0
        (x, y), cell = self.origin_m.tolist(), self.resolution_m
        rows, columns = self.log_odds.shape
        return (
            max(int((bottom - y) / cell) - 1, 0),
            max(int((left - x) / cell) - 1, 0),
            min(int((top - y) / cell) + 2, rows),
            min(int((right - x) / cell) + 2, columns),
        )

    def _grow(self, low_m: Array, high_m: Array) -> None:
        """Enlarge the grid to contain the box low_m..high_m, with padding on the sides that grow."""
        (rows, columns), cell, ends = self.log_odds.shape, self.resolution_m, []
        for low, high, old_low, count in zip(
            low_m.tolist(), high_m.tolist(), self.origin_m.tolist(), (columns, rows), strict=True
        ):
            if not math.isfinite(high - low):
                raise self._too_far()
            old_high = old_low + count * cell
            is_below, is_above = low < old_low + ROUNDING_M, high > old_high - ROUNDING_M
            first = math.floor((low - self.PADDING_M) / cell) if is_below or not rows else round(old_low / cell)
            last = math.ceil((high + self.PADDING_M) / cell) if is_above or not rows else round(old_high / cell)
            ends.append((first, last))
        (left, right), (bottom, top) = ends
        shape = top - bottom, right - left
        if shape[0] * shape[1] > CELLS_MAX:
            raise self._too_far()
        grown, kinds = np.zeros(shape, np.int16), np.zeros(shape if self._has_kinds else (0, 0), np.uint8)
        if rows:
            (x, y) = self.origin_m.tolist()
            r, c = round(y / cell - bottom), round(x / cell - left)
            grown[r : r + rows, c : c + columns] = self.log_odds
            note_kinds(grown, r - 1, c - 1, r + rows, c + columns, kinds)  # squares at the old border changed
        self.log_odds, self._kinds, self._snapshot = grown, kinds, None
        self._touched = np.zeros((-(-shape[0] // BLOCK_ROWS), -(-shape[1] // BLOCK_COLUMNS)), np.int64)
        self.origin_m = np.array([left * cell, bottom * cell])
        self._boxes_m[0] = *self.origin_m, *(self.origin_m + np.array([shape[1], shape[0]]) * cell)
        self._rebind()


def resampled(grid: GridMap, resolution_m: float) -> GridMap:
    """The same map at other cells, on multiples of their size: a cell is a wall if any point of it is, free if any is
    and none is a wall."""
    step = min(grid.resolution_m, resolution_m)
    low_m = np.floor(np.asarray(grid.origin_m) / resolution_m) * resolution_m
    high_m = np.asarray(grid.origin_m) + np.array(grid.log_odds.shape[::-1]) * grid.resolution_m
    columns, rows = np.ceil((high_m - low_m) / resolution_m - ROUNDING_M).astype(int).tolist()
    per_cell = math.ceil(resolution_m / step - ROUNDING_M)
    out = np.zeros((rows, columns), np.int16)
    at = np.stack(np.meshgrid(np.arange(columns) + 0.0, np.arange(rows) + 0.0), axis=-1)
    for i in range(per_cell):
        for j in range(per_cell):
            within = (np.array([i, j]) + 0.5) / per_cell
            levels = grid.level_at(low_m + (at + within) * resolution_m)
            out = np.where((levels > 0) | (out > 0), np.maximum(levels, out), np.minimum(levels, out))
    return GridMap(out, low_m, resolution_m)
