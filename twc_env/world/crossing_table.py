"""Walls between any place and fixed points of a building (its access points): exact, and computed once per place.

A square of the floor sees most walls alike: from all of it, the line to a point crosses a wall, or from all of it
misses it. Only the few others are tested again for each place inside. A square is worked out when it is first asked
for, and kept for as long as the building is.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from twc_env.kernels import kernel
from twc_env.world.wall_index import WallIndex

Array = NDArray

_SQUARE_M = 1.0
_TESTS_MAX = 500_000
"""Walls times points, of a building whose squares are worth working out: beyond it, looking up the walls near each line
is cheaper than testing all of them for a square that may be seen once."""
_ENTRIES_MAX = 1_000_000
"""Squares times points that are kept (some 40 MB at most); beyond it all are forgotten and worked out anew."""


class CrossingTable:
    """Counts walls, and sums their losses per band, between places and `points_m` (k, 2)."""

    def __init__(self, index: WallIndex, points_m: Array, loss_db: Array):
        """`loss_db` (bands, walls): what one crossing costs."""
        self._walls_m, self._loss_db = index.walls_m, np.ascontiguousarray(loss_db)
        self._points_m = np.ascontiguousarray(points_m, float)
        self._direct: tuple[WallIndex, ...] = ()
        if len(points_m) * len(index.walls_m) > _TESTS_MAX:
            self._direct = tuple(replace(index, loss_db=band) for band in self._loss_db)
        self._squares: dict[tuple[int, int], tuple[Array, Array, Array, Array]] = {}
        self._squares_max = max(_ENTRIES_MAX // max(len(points_m), 1), 1)

    def crossed(self, x: float, y: float, counts: Array, losses_db: Array) -> None:
        """Fill counts (k,) int64 and losses_db (bands, k) for the place (x, y)."""
        if self._direct:
            for band, index in enumerate(self._direct):
                counts[:], losses_db[band] = index.crossing(np.array([x, y]), self._points_m)
            return
        table = self._table(x, y)
        _cross_open(self._walls_m, self._loss_db, self._points_m, x, y, *table, counts, losses_db)

    def walls_around(self, x: float, y: float) -> tuple[Array, ...] | None:
        """All walls (w, 4) and their losses (bands, w); then, for the square around (x, y), the losses between it and
        each point that are sure (bands, k), and the walls that must be tested for point i: members[first[i] :
        first[i + 1]]. None for a building that is too large for squares."""
        if self._direct:
            return None
        return (self._walls_m, self._loss_db, *self._table(x, y)[1:])

    def _table(self, x: float, y: float) -> tuple[Array, Array, Array, Array]:
        square = (int(x // _SQUARE_M), int(y // _SQUARE_M))
        table = self._squares.get(square)
        return self._work_out(square) if table is None else table

    def _work_out(self, square: tuple[int, int]) -> tuple[Array, Array, Array, Array]:
        if len(self._squares) >= self._squares_max:
            self._squares.clear()
        counts = np.zeros(len(self._points_m), np.int64)
        losses = np.zeros((len(self._loss_db), len(self._points_m)))
        first = np.zeros(len(self._points_m) + 1, np.int64)
        middle = [(k + 0.5) * _SQUARE_M for k in square]
        members = np.empty(0, np.int32)
        for _ in range(2):  # count the walls that are open, then list them
            _sort_walls(
                self._walls_m, self._loss_db, self._points_m, *middle, 0.5 * _SQUARE_M, counts, losses, first, members
            )
            members = members if len(members) else np.empty(int(first[-1]), np.int32)
        table = self._squares[square] = (counts, losses, first, members)
        return table


@kernel
def _sort_walls(walls, loss, points, x, y, half, counts, losses, first, members):
    """Walls that all of a square crosses are counted, walls that none of it crosses are dropped, the others listed.

    Each side of a line that the test of `_cross_open` asks for is linear in the place: it is the same all over the
    square when its value in the middle exceeds what the half-width can change.
    """
    open_count = 0
    for k in range(points.shape[0]):
        qx, qy = points[k, 0], points[k, 1]
        counts[k], losses[:, k], first[k] = 0, 0.0, open_count
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
            if open_count < members.shape[0]:
                members[open_count] = w
            open_count += 1
    first[points.shape[0]] = open_count


@kernel
def _cross_open(walls, loss, points, px, py, sure_counts, sure_losses, first, members, counts, losses):
    """The test of `wall_index._cross` for the walls of a square that are neither surely crossed nor surely missed."""
    for k in range(points.shape[0]):
        counts[k] = sure_counts[k]
        for band in range(loss.shape[0]):
            losses[band, k] = sure_losses[band, k]
        qx, qy = points[k, 0], points[k, 1]
        dx, dy = qx - px, qy - py
        for m in range(first[k], first[k + 1]):
            w = members[m]
            ax, ay, bx, by = walls[w, 0], walls[w, 1], walls[w, 2], walls[w, 3]
            side_a = dx * (ay - py) - dy * (ax - px)
            side_b = dx * (by - py) - dy * (bx - px)
            if (side_a >= 0.0) == (side_b >= 0.0):
                continue
            side_p = (bx - ax) * (py - ay) - (by - ay) * (px - ax)
            side_q = (bx - ax) * (qy - ay) - (by - ay) * (qx - ax)
            if (side_p >= 0.0) != (side_q >= 0.0):
                counts[k] += 1
                for band in range(loss.shape[0]):
                    losses[band, k] += loss[band, w]
