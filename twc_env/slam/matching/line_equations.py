"""Gauss-Newton normal equations of point-to-line scan matching: each point is matched to the line of the nearest wall.

In single precision (0.01 mm at 40 m). The sums of every LANES-th point are kept separately and added at the end, so
that results do not depend on the processor's vector width.
"""

from __future__ import annotations

import math

import numpy as np

from twc_env.kernels.compiled import borrowing_kernel, kernel
from twc_env.slam.scans.wall_cells import NO_WALL, distance_in, line_in

LANES, POINTS = 16, 192
"""Number of separate sums; number of points per block, each loop processes one block."""
TERMS = 11
"""Sums: six entries of J^T w J, three of J^T w e, the weights, and the points near walls."""
_ONE, _NONE, _NOWHERE = np.float32(1.0), np.float32(0.0), np.float32(np.nan)
ROBUST_SCALE_M = 0.08
"""Residual at which a point has half its weight (Cauchy)."""
_INVERSE_SCALE = np.float32(1.0 / ROBUST_SCALE_M**2)


@kernel
def line_scratch():
    """Scratch memory of `normal_equations`."""
    work, seen, sums = (
        np.zeros(6 * POINTS, np.float32), np.zeros(3 * POINTS, np.float32), np.zeros(TERMS * LANES, np.float32)
    )  # fmt: skip
    return work, np.zeros(POINTS, np.int32), np.zeros(POINTS, np.uint32), seen, sums


@borrowing_kernel
def _place_points(points, x, y, c, s, inverse_m, height, width, work, places):
    """Transform points (n, 2) to the field frame, and find their cells (flat index; 0 outside the field).

    work: rows px, py (points), rx, ry (rotated), qx, qy (transformed); qy is NaN outside the field.
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
    """Write the values of these cells to held, and their lines to seen: rows normal x, normal y, offset."""
    for j in range(count):
        held[j] = cells[np.uint64(places[j])]
        line = lines[line_in(held[j])]
        seen[j], seen[POINTS + j], seen[2 * POINTS + j] = line[0], line[1], line[2]


@borrowing_kernel
def _add_terms(count, all_work, all_held, all_seen, distance_max, sums):
    """Add the terms of each point to the rows of sums; count is a multiple of LANES."""
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
    """Write J^T w J (6 upper entries) and J^T w e (3) over points near walls to h; returns sum of w and their number.

    cells (rows, columns) and lines (n, 3) of a field as drawn by `wall_drawing`; scratch of `line_scratch`.
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
    """Sum of one row over all LANES."""
    total = 0.0
    for j in range(row * LANES, row * LANES + LANES // 4):
        total += np.float64(
            (sums[j] + sums[j + LANES // 4]) + (sums[j + LANES // 2] + sums[j + LANES // 2 + LANES // 4])
        )
    return total
