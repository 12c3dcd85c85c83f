"""Exact wall crossings between any position and fixed points of a building (its access points), with a cache.

The floor is divided into squares. For each square and point, every wall is either crossed from all positions in the
square, or from none, or is uncertain; only the uncertain walls are tested for each position. A square is computed when
it is first needed.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.kernels.compiled import borrowing_kernel
from twc_env.records.growing_arrays import lazy_zeros
from twc_env.world.building.wall_index import WallIndex, cross, is_crossed

_SQUARE_M = 1.0
_TESTS_MAX = 500_000
"""Limit of walls times points for the cache; beyond it, testing the walls near each line is faster."""
_ENTRIES_MAX = 1_000_000
"""Limit of cached squares times points (about 40 MB), at which the cache is cleared."""
_SQUARES_MAX = 1_000_000
"""Limit of squares in the bounds of a building for the cache."""
MISSING, _OUTSIDE = -1, -2
"""Numbers of squares not computed yet and of positions outside of the bounds."""


class CrossingTable:
    """Counts of walls crossed, and sums of their losses per band, between positions and points_m (k, 2)."""

    def __init__(self, index: WallIndex, points_m: Array, loss_db: Array):
        """loss_db (bands, walls): loss of one crossing."""
        self._walls = index.buckets()
        points_m, loss_db = np.ascontiguousarray(points_m, float), np.ascontiguousarray(loss_db)
        squares = np.floor(index.walls_m.reshape(-1, 2) / _SQUARE_M).astype(np.int64)
        low, shape = squares.min(axis=0), np.ptp(squares, axis=0) + 1
        if len(points_m) * len(index.walls_m) > _TESTS_MAX or shape.prod() > _SQUARES_MAX:
            shape[:] = 0
        self._squares_max = max(_ENTRIES_MAX // max(len(points_m), 1), 1)
        self._square_count = self._member_count = 0
        points, bands = len(points_m), len(loss_db)
        self._inputs = loss_db, points_m, low, np.full(shape, MISSING, np.int32)
        self._set_tables(
            np.zeros((1, points), np.int32), np.zeros((1, bands, points)), np.zeros((1, points + 1), np.int32),
            np.zeros(points, np.int32),
        )  # fmt: skip

    def _set_tables(self, *kept: Array) -> None:
        self._tables = kept
        self.arrays = self._inputs + kept
        """Arguments of `crossed_at` after the walls; `prepare` may replace them by larger arrays."""

    def crossed(self, x: float, y: float, counts: Array, losses_db: Array) -> None:
        """Fill counts (k,) int64 and losses_db (bands, k) for the position (x, y) [m]."""
        self.prepare(x, y)
        crossed_at(x, y, *self._walls, *self.arrays, counts, losses_db)

    def prepare(self, x: float, y: float) -> None:
        """Compute the square around a position unless it is cached."""
        loss_db, points_m, low, numbers = self._inputs
        if square_at(x, y, low, numbers) != MISSING:
            return
        if self._square_count == self._squares_max:
            numbers[:] = MISSING
            self._square_count = self._member_count = 0
        square, begin = self._square_count, self._member_count
        corner = np.floor(np.array([x, y]) / _SQUARE_M).astype(np.int64)
        middle = ((corner + 0.5) * _SQUARE_M).tolist()
        if square == len(self._tables[0]):
            self._set_tables(*(_enlarged(kept, square + 1) for kept in self._tables[:3]), self._tables[3])
        while True:
            counts, losses, first, members = self._tables
            end = _classify_walls(
                self._walls[0], loss_db, points_m, *middle, 0.5 * _SQUARE_M, counts[square], losses[square],
                first[square], members, begin,
            )  # fmt: skip
            if end <= len(members):
                break
            self._set_tables(counts, losses, first, _enlarged(members, end))
        numbers[tuple(corner - low)] = square
        self._square_count, self._member_count = square + 1, end


def _enlarged(array: Array, count: int) -> Array:
    """The array, or a copy with more than `count` rows, the new ones zero."""
    if count <= len(array):
        return array
    enlarged = lazy_zeros((2 * count, *array.shape[1:]), array.dtype)
    enlarged[: len(array)] = array
    return enlarged


@borrowing_kernel
def square_at(x, y, low, numbers):
    """Number of the square around a position; `MISSING` or `_OUTSIDE` if there is none."""
    i, j = int(np.floor(x / _SQUARE_M)) - low[0], int(np.floor(y / _SQUARE_M)) - low[1]
    return numbers[i, j] if 0 <= i < numbers.shape[0] and 0 <= j < numbers.shape[1] else _OUTSIDE


@borrowing_kernel
def crossed_at(
    x, y, walls, origin, bucket, rows, columns, first, members, loss, points, low, numbers, certain_counts,
    certain_losses, first_uncertain, uncertain_walls, counts, losses,
):  # fmt: skip
    """Fill counts (k,) and losses (bands, k) between a position and the points.

    Without a cached square, all walls along the lines are tested.
    """
    square = square_at(x, y, low, numbers)
    if square < 0 or square >= certain_counts.shape[0]:
        cross(walls, origin, bucket, rows, columns, first, members, loss, x, y, points, counts, losses)
        return
    for band in range(loss.shape[0]):
        for k in range(points.shape[0]):
            qx, qy, count, total = (
                points[k, 0],
                points[k, 1],
                int(certain_counts[square, k]),
                certain_losses[square, band, k],
            )
            # No branch, as crossings are unpredictable; unsigned indices need no check for negative ones.
            for m in range(np.uint64(first_uncertain[square, k]), np.uint64(first_uncertain[square, k + 1])):
                w = np.uint64(uncertain_walls[m])
                hit = int(is_crossed(walls, w, x, y, qx, qy))
                count += hit
                total += hit * loss[band, w]
            counts[k], losses[band, k] = count, total


@borrowing_kernel
def _classify_walls(walls, loss, points, x, y, half, counts, losses, first, members, begin):
    """Count the walls crossed from all of a square and list the uncertain ones in `members` from `begin` on.

    Returns the end of the list, which is incomplete if that exceeds the length of `members`. The side tests of
    `is_crossed` are linear in the position: the sign is constant over the square if the absolute value at its centre
    exceeds the greatest change within the half-width.
    """
    end = begin
    for k in range(points.shape[0]):
        qx, qy = points[k, 0], points[k, 1]
        counts[k], losses[:, k], first[k] = 0, 0.0, end
        for w in range(walls.shape[0]):
            ax, ay, bx, by = walls[w, 0], walls[w, 1], walls[w, 2], walls[w, 3]
            ex, ey = bx - ax, by - ay
            side_q = ex * (qy - ay) - ey * (qx - ax)
            side_p = ex * (y - ay) - ey * (x - ax)
            slack = 1e-9 * (1.0 + abs(ex) + abs(ey))
            reach_p = half * (abs(ex) + abs(ey)) + slack
            if abs(side_p) > reach_p and abs(side_q) > slack and (side_p > 0.0) == (side_q > 0.0):
                continue
            dx, dy = qx - x, qy - y
            side_a = dx * (ay - y) - dy * (ax - x)
            side_b = dx * (by - y) - dy * (bx - x)
            slack += 1e-9 * (abs(dx) + abs(dy)) * (1.0 + abs(ax - x) + abs(ay - y))
            reach_a = half * (abs(qy - ay) + abs(qx - ax)) + slack
            reach_b = half * (abs(qy - by) + abs(qx - bx)) + slack
            if abs(side_a) > reach_a and abs(side_b) > reach_b:
                if (side_a > 0.0) == (side_b > 0.0):
                    continue
                if abs(side_p) > reach_p and abs(side_q) > slack:
                    counts[k] += 1
                    for band in range(loss.shape[0]):
                        losses[band, k] += loss[band, w]
                    continue
            if end < members.shape[0]:
                members[end] = w
            end += 1
    first[points.shape[0]] = end
    return end
