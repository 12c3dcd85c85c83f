"""What points say of a pose when each is to lie on the line of the wall nearest to it: Gauss-Newton's equations.

Look-ups apart, everything is worked out for many points at once; what they say is added up in their order.
"""

from __future__ import annotations

import math

import numpy as np

from twc_env.kernels import borrowing_kernel, kernel

LANES = 16
"""So many points are worked out at once."""
FAR_M = 1e3
"""Distance of a cell that knows no wall."""
ROBUST_SCALE_M = 0.08
"""Residual at which a beam has lost half of its weight (Cauchy)."""


@kernel
def line_scratch():
    """Room for what `normal_equations` works out on the way."""
    return np.zeros(16 * LANES), np.empty(LANES, np.int32), np.zeros(4 * LANES, np.float32), np.empty(10)


@borrowing_kernel
def _look_up_walls(cells, height, width, inverse_m, points, first, x, y, c, s, work, places, seen):
    """Of LANES points from the first on: where they end up (qx, qy), only turned (rx, ry), and the walls known there.

    work (>= 6 LANES,): px, py, qx, qy, rx, ry. seen (4 LANES,): normal, offset, distance, which is FAR_M for none.
    """
    count = min(points.shape[0] - first, LANES)
    for j in range(count):
        work[j], work[LANES + j] = points[first + j, 0], points[first + j, 1]
    for j in range(LANES):
        px, py = work[j], work[LANES + j]
        rx, ry = c * px - s * py, s * px + c * py
        qx, qy = x + rx, y + ry
        work[2 * LANES + j], work[3 * LANES + j], work[4 * LANES + j], work[5 * LANES + j] = qx, qy, rx, ry
        across, up = qx * inverse_m, qy * inverse_m
        is_inside = (across >= 0.0) & (up >= 0.0) & (across < width) & (up < height)
        places[j] = np.int32(up) * np.int32(width) + np.int32(across) if is_inside else np.int32(-1)
    for j in range(LANES):
        if j >= count or places[j] < 0:
            seen[3 * LANES + j] = FAR_M
            continue
        wall = cells[np.uint64(places[j])]
        seen[j], seen[LANES + j], seen[2 * LANES + j], seen[3 * LANES + j] = wall[0], wall[1], wall[2], wall[3]


@borrowing_kernel
def _add_terms(work, seen, distance_max, sums):
    """Add to sums (10,) what each of LANES points contributes: worked out for many at once, added in their order."""
    near = 0
    for j in range(LANES):
        nx, ny = np.float64(seen[j]), np.float64(seen[LANES + j])
        e = nx * work[2 * LANES + j] + ny * work[3 * LANES + j] - np.float64(seen[2 * LANES + j])
        is_near = (np.float64(seen[3 * LANES + j]) <= distance_max) & (abs(e) <= distance_max)
        w = 1.0 / (1.0 + e * e * (1.0 / ROBUST_SCALE_M**2)) if is_near else 0.0
        jt = ny * work[4 * LANES + j] - nx * work[5 * LANES + j]
        wx, wy, we = w * nx, w * ny, w * e
        work[6 * LANES + j], work[7 * LANES + j], work[8 * LANES + j] = wx * nx, wx * ny, wx * jt
        work[9 * LANES + j], work[10 * LANES + j], work[11 * LANES + j] = wy * ny, wy * jt, w * jt * jt
        work[12 * LANES + j], work[13 * LANES + j], work[14 * LANES + j] = we * nx, we * ny, we * jt
        work[15 * LANES + j] = w
        near += is_near
    h0, h1, h2, h3, h4, h5 = sums[0], sums[1], sums[2], sums[3], sums[4], sums[5]
    g0, g1, g2, total = sums[6], sums[7], sums[8], sums[9]
    for j in range(LANES):
        h0 += work[6 * LANES + j]
        h1 += work[7 * LANES + j]
        h2 += work[8 * LANES + j]
        h3 += work[9 * LANES + j]
        h4 += work[10 * LANES + j]
        h5 += work[11 * LANES + j]
        g0 += work[12 * LANES + j]
        g1 += work[13 * LANES + j]
        g2 += work[14 * LANES + j]
        total += work[15 * LANES + j]
    sums[0], sums[1], sums[2], sums[3], sums[4], sums[5] = h0, h1, h2, h3, h4, h5
    sums[6], sums[7], sums[8], sums[9] = g0, g1, g2, total
    return near


@borrowing_kernel
def normal_equations(walls, origin, inverse_m, points, n, x, y, heading, distance_max, scratch, h):
    """Sum J^T w J (h: 6 upper entries) and J^T w e (3 more) over points near walls; gives sum of w and number.

    scratch: as `line_scratch` makes it.
    """
    work, places, seen, sums = scratch
    height, width, cells = float(walls.shape[0]), float(walls.shape[1]), walls.reshape(-1, 4)
    c, s = math.cos(heading), math.sin(heading)
    x -= origin[0]
    y -= origin[1]
    for k in range(10):
        sums[k] = 0.0
    near = 0
    for first in range(0, n, LANES):
        _look_up_walls(cells, height, width, inverse_m, points[:n], first, x, y, c, s, work, places, seen)
        near += _add_terms(work, seen, distance_max, sums)
    for k in range(9):
        h[k] = sums[k]
    return sums[9], near
