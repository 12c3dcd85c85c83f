"""Walls between any place and fixed points of a building (its access points): exact, and computed once per place.

A square of the floor sees most walls alike: from all of it, the line to a point crosses a wall, or from all of it
misses it. Only the few others are tested again for each place inside. A square is worked out when it is first asked
for, and kept for as long as the building is.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.kernels import borrowing_kernel
from twc_env.world.wall_index import WallIndex, cross, is_crossed

_SQUARE_M = 1.0
_TESTS_MAX = 500_000
"""Walls times points, of a building whose squares are worth working out: beyond it, looking up the walls near each line
is cheaper than testing all of them for a square that may be seen once."""
_ENTRIES_MAX = 1_000_000
"""Squares times points that are kept (some 40 MB at most); beyond it all are forgotten and worked out anew."""
_SQUARES_MAX = 1_000_000
"""Of a building's floor, for all of which a number is kept."""
MISSING, _OUTSIDE = -1, -2


class CrossingTable:
    """Counts walls, and sums their losses per band, between places and `points_m` (k, 2)."""

    def __init__(self, index: WallIndex, points_m: Array, loss_db: Array):
        """`loss_db` (bands, walls): what one crossing costs."""
        self._walls = index.buckets()
        points_m, loss_db = np.ascontiguousarray(points_m, float), np.ascontiguousarray(loss_db)
        squares = np.floor(index.walls_m.reshape(-1, 2) / _SQUARE_M).astype(np.int64)
        low, shape = squares.min(axis=0), np.ptp(squares, axis=0) + 1
        if len(points_m) * len(index.walls_m) > _TESTS_MAX or shape.prod() > _SQUARES_MAX:
            shape[:] = 0
        self._squares_max = max(_ENTRIES_MAX // max(len(points_m), 1), 1)
        self._square_count = self._member_count = 0
        points, bands = len(points_m), len(loss_db)
        self._fixed = loss_db, points_m, low, np.full(shape, MISSING, np.int32)
        self._keep(
            np.zeros((1, points), np.int32), np.zeros((1, bands, points)), np.zeros((1, points + 1), np.int32),
            np.zeros(points, np.int32),
        )  # fmt: skip

    def _keep(self, *kept: Array) -> None:
        self._kept = kept
        self.arrays = self._fixed + kept
        """What `crossed_at` needs beside the walls; others once `prepare` has grown them."""

    def crossed(self, x: float, y: float, counts: Array, losses_db: Array) -> None:
        """Fill counts (k,) int64 and losses_db (bands, k) for the place (x, y)."""
        self.prepare(x, y)
        crossed_at(x, y, *self._walls, *self.arrays, counts, losses_db)

    def prepare(self, x: float, y: float) -> None:
        """Work out the square around a place, if that is still to be done."""
        loss_db, points_m, low, numbers = self._fixed
        if square_at(x, y, low, numbers) != MISSING:
            return
        if self._square_count == self._squares_max:
            numbers[:] = MISSING
            self._square_count = self._member_count = 0
        square, begin = self._square_count, self._member_count
        corner = np.floor(np.array([x, y]) / _SQUARE_M).astype(np.int64)
        middle = ((corner + 0.5) * _SQUARE_M).tolist()
        if square == len(self._kept[0]):
            self._keep(*(_grown(kept, square + 1) for kept in self._kept[:3]), self._kept[3])
        while True:
            counts, losses, first, members = self._kept
            end = _sort_walls(
                self._walls[0], loss_db, points_m, *middle, 0.5 * _SQUARE_M, counts[square], losses[square],
                first[square], members, begin,
            )  # fmt: skip
            if end <= len(members):
                break
            self._keep(counts, losses, first, _grown(members, end))
        numbers[tuple(corner - low)] = square
        self._square_count, self._member_count = square + 1, end


def _grown(array: Array, count: int) -> Array:
    """The array with room for `count` rows, and then for as many again."""
    if count <= len(array):
        return array
    return np.concatenate([array, np.zeros((2 * count - len(array), *array.shape[1:]), array.dtype)])


@borrowing_kernel
def square_at(x, y, low, numbers):
    """Number of the square around a place; -1 where it must be worked out, -2 outside of the building."""
    i, j = int(np.floor(x / _SQUARE_M)) - low[0], int(np.floor(y / _SQUARE_M)) - low[1]
    return numbers[i, j] if 0 <= i < numbers.shape[0] and 0 <= j < numbers.shape[1] else _OUTSIDE


@borrowing_kernel
def crossed_at(
    x, y, walls, origin, bucket, rows, columns, first, members, loss, points, low, numbers, sure_counts, sure_losses,
    first_open, open_walls, counts, losses,
):  # fmt: skip
    """Fill counts (k,) and losses (bands, k) between a place and the points.

    Outside of the building, and where the square is not worked out, all walls on the way are tested.
    """
    square = square_at(x, y, low, numbers)
    if square < 0 or square >= sure_counts.shape[0]:
        cross(walls, origin, bucket, rows, columns, first, members, loss, x, y, points, counts, losses)
        return
    for band in range(loss.shape[0]):
        for k in range(points.shape[0]):
            qx, qy, count, total = points[k, 0], points[k, 1], int(sure_counts[square, k]), sure_losses[square, band, k]
            # Without a branch, for which walls are hit cannot be foretold; unsigned numbers cannot count from an end.
            for m in range(np.uint64(first_open[square, k]), np.uint64(first_open[square, k + 1])):
                w = np.uint64(open_walls[m])
                hit = int(is_crossed(walls, w, x, y, qx, qy))
                count += hit
                total += hit * loss[band, w]
            counts[k], losses[band, k] = count, total


@borrowing_kernel
def _sort_walls(walls, loss, points, x, y, half, counts, losses, first, members, begin):
    """Walls that all of a square crosses are counted, walls that none of it crosses are dropped, the others listed.

    Listed from `begin` on; returns where the list ends, were there room.

    Each side of a line that `is_crossed` asks for is linear in the place: it is the same all over the
    square when its value in the middle exceeds what the half-width can change.
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
