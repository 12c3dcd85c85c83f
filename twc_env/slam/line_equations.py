"""What points say of a pose when each is to lie on the line of the wall nearest to it: Gauss-Newton's equations.

All is worked out for many points at once, in 32 bits: of 40 m that leaves a hundredth of a millimetre. The sums of
every LANES-th point are kept apart and added up last, so that they do not depend on how many a processor takes at once.
"""

from __future__ import annotations

import math

import numpy as np

from twc_env.kernels import borrowing_kernel, kernel
from twc_env.slam.wall_cells import NO_WALL, distance_in, line_in

LANES, POINTS = 16, 192
"""Sums that are kept apart; and points that go through one loop before they go through the next."""
TERMS = 11
"""What is summed: six entries of J^T w J, three of J^T w e, the weights and the points near walls."""
_ONE, _NONE, _NOWHERE = np.float32(1.0), np.float32(0.0), np.float32(np.nan)
ROBUST_SCALE_M = 0.08
"""Residual at which a beam has lost half of its weight (Cauchy)."""
_INVERSE_SCALE = np.float32(1.0 / ROBUST_SCALE_M**2)


@kernel
def line_scratch():
    """Room for what `normal_equations` works out on the way, row after row."""
    work, seen, sums = (
        np.zeros(6 * POINTS, np.float32), np.zeros(3 * POINTS, np.float32), np.zeros(TERMS * LANES, np.float32)
    )  # fmt: skip
    return work, np.zeros(POINTS, np.int32), np.zeros(POINTS, np.uint32), seen, sums


@borrowing_kernel
def _place_points(points, x, y, c, s, inverse_m, height, width, work, places):
    """Where points end up and, only turned, from where; and the numbers of their cells: 0 for all outside the field.

    work: rows px, py, rx, ry, qx, qy; qy is NaN outside the field.
    """
    count = points.shape[0]
    for j in range(count):
        work[j], work[POINTS + j] = points[j, 0], points[j, 1]
    for j in range(count):
        px, py = work[j], work[POINTS + j]
        rx, ry = c * px - s * py, s * px + c * py
        qx, qy = x + rx, y + ry
        across, up = qx * inverse_m, qy * inverse_m
        is_inside = (across >= _NONE) & (up >= _NONE) & (across < width) & (up < height)
        places[j] = np.int32(up) * np.int32(width) + np.int32(across) if is_inside else np.int32(0)
        work[2 * POINTS + j], work[3 * POINTS + j], work[4 * POINTS + j] = rx, ry, qx
        work[5 * POINTS + j] = qy if is_inside else _NOWHERE


@borrowing_kernel
def _look_up_lines(cells, lines, count, places, held, seen):
    """The cells of these numbers, and the lines that they know: rows normal x, normal y, offset."""
    for j in range(count):
        held[j] = cells[np.uint64(places[j])]
        line = lines[line_in(held[j])]
        seen[j], seen[POINTS + j], seen[2 * POINTS + j] = line[0], line[1], line[2]


@borrowing_kernel
def _add_terms(count, all_work, all_held, all_seen, distance_max, sums):
    """Add to the rows of sums what each point contributes; count is a multiple of LANES."""
    for first in range(0, count, LANES):
        work, held, seen = all_work[first:], all_held[first:], all_seen[first:]
        for j in range(LANES):
            nx, ny = seen[j], seen[POINTS + j]
            away = nx * work[4 * POINTS + j] + ny * work[5 * POINTS + j] - seen[2 * POINTS + j]
            is_near = (distance_in(held[j]) <= distance_max) & (abs(away) <= distance_max)
            e = away if is_near else _NONE
            near = _ONE if is_near else _NONE
            w = near / (_ONE + e * e * _INVERSE_SCALE)
            jt = ny * work[2 * POINTS + j] - nx * work[3 * POINTS + j]
            wx, wy, wt = w * nx, w * ny, w * jt
            sums[j] += wx * nx
            sums[LANES + j] += wx * ny
            sums[2 * LANES + j] += wx * jt
            sums[3 * LANES + j] += wy * ny
            sums[4 * LANES + j] += wy * jt
            sums[5 * LANES + j] += wt * jt
            sums[6 * LANES + j] += wx * e
            sums[7 * LANES + j] += wy * e
            sums[8 * LANES + j] += wt * e
            sums[9 * LANES + j] += w
            sums[10 * LANES + j] += near


@borrowing_kernel
def normal_equations(cells, lines, origin, inverse_m, points, n, x, y, heading, distance_max, scratch, h):
    """Sum J^T w J (h: 6 upper entries) and J^T w e (3 more) over points near walls; gives sum of w and number.

    cells (rows, columns) and lines (n, 3): as `wall_drawing` draws them. scratch: as `line_scratch` makes it.
    """
    work, places, held, seen, sums = scratch
    height, width, flat = np.float32(cells.shape[0]), np.float32(cells.shape[1]), cells.reshape(-1)
    c, s = np.float32(math.cos(heading)), np.float32(math.sin(heading))
    x, y = np.float32(x - origin[0]), np.float32(y - origin[1])
    for k in range(TERMS * LANES):
        sums[k] = _NONE
    for first in range(0, n, POINTS):
        count = min(n - first, POINTS)
        _place_points(points[first : first + count], x, y, c, s, np.float32(inverse_m), height, width, work, places)
        _look_up_lines(flat, lines, count, places, held, seen)
        padded = (count + LANES - 1) // LANES * LANES
        for k in range(count, padded):
            held[k] = NO_WALL
        _add_terms(padded, work, held, seen, np.float32(distance_max), sums)
    for k in range(9):
        h[k] = _total(sums, k)
    return _total(sums, 9), int(_total(sums, 10))


@borrowing_kernel
def _total(sums, row):
    """One of the sums, over all LANES."""
    total = 0.0
    for j in range(row * LANES, row * LANES + LANES // 4):
        total += np.float64(
            (sums[j] + sums[j + LANES // 4]) + (sums[j + LANES // 2] + sums[j + LANES // 2 + LANES // 4])
        )
    return total
