"""Spatial index of walls: a grid of square buckets for line-of-sight and distance queries."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.kernels.compiled import borrowing_kernel, kernel

_BUCKET_MIN_M, _BUCKET_MAX_M = 0.5, 2.0
_MARGIN_M = 0.5
"""Margin of the grid around the walls."""


@dataclass(frozen=True, slots=True, eq=False)
class WallIndex:
    """Walls, and for each bucket the walls that touch it."""

    walls_m: Array
    """(walls, 4): x1, y1, x2, y2."""
    loss_db: Array
    """(walls,) RSSI loss per crossing."""
    origin_m: Array
    """(2,) lower left corner of bucket (0, 0)."""
    bucket_m: float
    shape: tuple[int, int]
    """(rows, columns)."""
    first: Array
    """(rows * columns + 1,) int32: the walls of bucket b are members[first[b] : first[b + 1]]."""
    members: Array
    """(entries,) int32 wall numbers."""

    def buckets(self) -> tuple:
        """Arguments of kernels: walls, origin, bucket side, rows, columns, first, members."""
        return self.walls_m, self.origin_m, self.bucket_m, *self.shape, self.first, self.members

    def crossing(self, point_m: Array, targets_m: Array) -> tuple[Array, Array]:
        """Walls between a point (2,) and each target (k, 2): counts (k,) and sums of losses (k,) [dB].

        A line through the common end of two collinear walls crosses one of them.
        """
        counts, losses = np.empty(len(targets_m), np.int64), np.empty((1, len(targets_m)))
        # Copies, as the compiled signature excludes read-only arrays.
        targets_m, loss_db = np.array(targets_m, float, order="C"), self.loss_db[None].copy()
        cross(*self.buckets(), loss_db, float(point_m[0]), float(point_m[1]), targets_m, counts, losses)
        return counts, losses[0]

    def distance_m(self, points_m: Array, reach_m: float) -> Array:
        """(k, 2) points -> (k,) distance to the nearest wall, at most `reach_m`."""
        gaps = np.empty(len(points_m))
        _gaps(*self.buckets(), np.ascontiguousarray(points_m, float), reach_m, gaps)
        return gaps


def index_walls(walls_m: Array, loss_db: Array) -> WallIndex:
    """The index of walls (w, 2, 2) with losses (w,), with a few walls per bucket."""
    flat = np.ascontiguousarray(np.asarray(walls_m, float).reshape(-1, 4))
    low = np.minimum(flat[:, :2], flat[:, 2:]).min(axis=0) - _MARGIN_M
    high = np.maximum(flat[:, :2], flat[:, 2:]).max(axis=0) + _MARGIN_M
    bucket_m = float(np.clip(1.5 * np.sqrt(np.prod(high - low) / len(flat)), _BUCKET_MIN_M, _BUCKET_MAX_M))
    columns, rows = (np.ceil((high - low) / bucket_m).astype(int) + 1).tolist()
    first = np.zeros(rows * columns + 1, np.int32)
    _fill(flat, low, bucket_m, rows, columns, first, np.empty(0, np.int32))
    counts = first.copy()
    first[1:] = np.cumsum(counts[:-1])
    first[0] = 0
    members = np.empty(int(first[-1]), np.int32)
    _fill(flat, low, bucket_m, rows, columns, first[:-1].copy(), members)
    return WallIndex(flat, np.asarray(loss_db, float), low, bucket_m, (rows, columns), first, members)


@borrowing_kernel
def _fill(walls, origin, bucket, rows, columns, slots, members):
    """Count the walls that touch each bucket into slots, or write them to members if that is not empty."""
    half = 0.5 * bucket + 1e-9
    for w in range(walls.shape[0]):
        ax, ay = walls[w, 0] - origin[0], walls[w, 1] - origin[1]
        bx, by = walls[w, 2] - origin[0], walls[w, 3] - origin[1]
        c0, c1 = int(min(ax, bx) / bucket - 1e-9), int(max(ax, bx) / bucket + 1e-9)
        r0, r1 = int(min(ay, by) / bucket - 1e-9), int(max(ay, by) / bucket + 1e-9)
        ex, ey = bx - ax, by - ay
        for r in range(max(r0, 0), min(r1, rows - 1) + 1):
            for c in range(max(c0, 0), min(c1, columns - 1) + 1):
                # The wall's line misses the bucket if all corners lie on one side.
                side = (c * bucket + half - ax) * ey - (r * bucket + half - ay) * ex
                if abs(side) > half * (abs(ex) + abs(ey)) + 1e-9:
                    continue
                b = r * columns + c
                if members.shape[0] > 0:
                    members[slots[b]] = w
                slots[b] += 1


@borrowing_kernel
def is_crossed(walls, w, px, py, qx, qy):
    """Whether the line from p to q crosses wall w; at the common end of two collinear walls, one of them."""
    ax, ay, bx, by = walls[w, 0], walls[w, 1], walls[w, 2], walls[w, 3]
    dx, dy = qx - px, qy - py
    side_a = dx * (ay - py) - dy * (ax - px)
    side_b = dx * (by - py) - dy * (bx - px)
    side_p = (bx - ax) * (py - ay) - (by - ay) * (px - ax)
    side_q = (bx - ax) * (qy - ay) - (by - ay) * (qx - ax)
    # Branch-free: computing both sides costs less than a misprediction.
    return ((side_a >= 0.0) != (side_b >= 0.0)) & ((side_p >= 0.0) != (side_q >= 0.0))


@kernel
def cross(walls, origin, bucket, rows, columns, first, members, losses_db, px, py, targets, counts, losses):
    """Fill counts (k,) and losses (bands, k), sums of losses_db (bands, walls), of walls from p to targets (k, 2)."""
    stamp = np.full(walls.shape[0], -1, np.int32)
    for k in range(targets.shape[0]):
        qx, qy = targets[k, 0], targets[k, 1]
        dx, dy = qx - px, qy - py
        counts[k], losses[:, k] = 0, 0.0
        # Traverse the buckets from p to q; next_x, next_y: share of the line at which the next column or row begins.
        gx, gy = (px - origin[0]) / bucket, (py - origin[1]) / bucket
        c, r = int(np.floor(gx)), int(np.floor(gy))
        c_end, r_end = int(np.floor((qx - origin[0]) / bucket)), int(np.floor((qy - origin[1]) / bucket))
        step_c, step_r = (1 if dx > 0 else -1), (1 if dy > 0 else -1)
        rate_x, rate_y = bucket / max(abs(dx), 1e-12), bucket / max(abs(dy), 1e-12)
        next_x = (c + 1 - gx if dx > 0 else gx - c) * rate_x if dx != 0 else np.inf
        next_y = (r + 1 - gy if dy > 0 else gy - r) * rate_y if dy != 0 else np.inf
        for _ in range(abs(c_end - c) + abs(r_end - r) + 1):
            if 0 <= c < columns and 0 <= r < rows:
                b = r * columns + c
                for m in range(first[b], first[b + 1]):
                    w = members[m]
                    if stamp[w] == k:
                        continue
                    stamp[w] = k
                    if is_crossed(walls, w, px, py, qx, qy):
                        counts[k] += 1
                        for band in range(losses.shape[0]):
                            losses[band, k] += losses_db[band, w]
            if next_x < next_y:
                next_x += rate_x
                c += step_c
            else:
                next_y += rate_y
                r += step_r


@borrowing_kernel
def is_blocked(walls, origin, bucket, rows, columns, first, members, px, py, qx, qy):
    """Whether a wall crosses the line from p to q; for short lines, as it tests all buckets of their bounding box."""
    c0 = max(int(np.floor((min(px, qx) - origin[0]) / bucket)), 0)
    c1 = min(int(np.floor((max(px, qx) - origin[0]) / bucket)), columns - 1)
    r0 = max(int(np.floor((min(py, qy) - origin[1]) / bucket)), 0)
    r1 = min(int(np.floor((max(py, qy) - origin[1]) / bucket)), rows - 1)
    if c0 > c1:
        return False
    for r in range(r0, r1 + 1):
        for m in range(first[r * columns + c0], first[r * columns + c1 + 1]):
            if is_crossed(walls, members[m], px, py, qx, qy):
                return True
    return False


@borrowing_kernel
def wall_beside(walls, origin, bucket, rows, columns, first, members, x, y, reach):
    """Vector from the nearest wall to (x, y), and its length, at most `reach`."""
    c0 = max(int(np.floor((x - reach - origin[0]) / bucket)), 0)
    c1 = min(int(np.floor((x + reach - origin[0]) / bucket)), columns - 1)
    r0 = max(int(np.floor((y - reach - origin[1]) / bucket)), 0)
    r1 = min(int(np.floor((y + reach - origin[1]) / bucket)), rows - 1)
    best, from_x, from_y = reach * reach, 0.0, 0.0
    for r in range(r0, r1 + 1):
        for c in range(c0, c1 + 1):
            for m in range(first[r * columns + c], first[r * columns + c + 1]):
                w = members[m]
                ax, ay = x - walls[w, 0], y - walls[w, 1]
                ex, ey = walls[w, 2] - walls[w, 0], walls[w, 3] - walls[w, 1]
                t = min(max((ax * ex + ay * ey) / (ex * ex + ey * ey), 0.0), 1.0)
                dx, dy = ax - t * ex, ay - t * ey
                if dx * dx + dy * dy < best:
                    best, from_x, from_y = dx * dx + dy * dy, dx, dy
    return from_x, from_y, np.sqrt(best)


@borrowing_kernel
def gap(walls, origin, bucket, rows, columns, first, members, x, y, reach):
    """Distance of (x, y) to the nearest wall, at most `reach`."""
    return wall_beside(walls, origin, bucket, rows, columns, first, members, x, y, reach)[2]


@borrowing_kernel
def _gaps(walls, origin, bucket, rows, columns, first, members, points, reach, gaps):
    for i in range(points.shape[0]):
        gaps[i] = gap(walls, origin, bucket, rows, columns, first, members, points[i, 0], points[i, 1], reach)
