"""Scan matching of points to a field of lines: point-to-line Gauss-Newton, correlative search, and information."""

from __future__ import annotations

import math

import numpy as np

from twc_env.kernels.compiled import borrowing_kernel
from twc_env.slam.matching.line_equations import ROBUST_SCALE_M, normal_equations
from twc_env.slam.scans.wall_cells import distance_in, line_in

WEIGHT_MIN = 5.0
"""Least sum of weights of a match."""
ACROSS_MIN = 0.7
"""A wall fixes a direction if the component of its unit normal along it is at least this large."""


@borrowing_kernel
def points_of(ranges, range_max, directions, points):
    """Write the end points of beams with a return, in the robot frame; returns their number."""
    n = 0
    for i in range(ranges.shape[0]):
        if 0.0 <= ranges[i] < range_max:
            points[n, 0] = ranges[i] * directions[i, 0]
            points[n, 1] = ranges[i] * directions[i, 1]
            n += 1
    return n


@borrowing_kernel
def _of_place(h):
    """Entries xx, xy and yy of the translation part of h with the heading marginalised out (Schur complement)."""
    t = max(h[5], 1e-9)
    return h[0] - h[2] * h[2] / t, h[1] - h[2] * h[4] / t, h[3] - h[4] * h[4] / t


@borrowing_kernel
def _weakest(h):
    """Information along the least constrained direction of translation: the smallest eigenvalue."""
    a, b, d = _of_place(h)
    mean, half = 0.5 * (a + d), 0.5 * math.sqrt((a - d) ** 2 + 4 * b * b)
    return max(mean - half, 0.0)


@borrowing_kernel
def weakest_direction(h):
    """Unit vector of the least constrained direction of translation."""
    a, b, d = _of_place(h)
    angle = 0.5 * math.atan2(2 * b, a - d) + 0.5 * math.pi
    return math.cos(angle), math.sin(angle)


@borrowing_kernel
def is_held_by_wall(cells, lines, origin, inverse_m, points, n, pose, distance_max, h, width_min_m):
    """Whether a wall at least width_min_m wide constrains the weakest direction of h: a run of successive points (n, 2)
    near lines across that direction. Narrower objects may be robots, present or drawn earlier."""
    vx, vy = weakest_direction(h)
    c, s = math.cos(pose[2]), math.sin(pose[2])
    low, high = math.inf, -math.inf
    for i in range(n):
        rx, ry = c * points[i, 0] - s * points[i, 1], s * points[i, 0] + c * points[i, 1]
        nx, ny, away = _line_at(cells, lines, origin, inverse_m, pose[0] + rx, pose[1] + ry, distance_max)
        if abs(away) <= distance_max and abs(nx * vx + ny * vy) >= ACROSS_MIN:
            aside = vx * ry - vy * rx
            low, high = min(low, aside), max(high, aside)
            if high - low >= width_min_m:
                return True
        else:
            low, high = math.inf, -math.inf
    return False


@borrowing_kernel
def _line_at(cells, lines, origin, inverse_m, x, y, distance_max):
    """Normal of the line nearest to a point, and the point's signed distance from it; 0, 0, inf if none is near."""
    height, width = cells.shape
    qx, qy = x - origin[0], y - origin[1]
    row, column = int(math.floor(qy * inverse_m)), int(math.floor(qx * inverse_m))
    if not (0 <= row < height and 0 <= column < width) or distance_in(cells[row, column]) > distance_max:
        return 0.0, 0.0, math.inf
    line = lines[line_in(cells[row, column])]
    nx, ny = np.float64(line[0]), np.float64(line[1])
    return nx, ny, nx * qx + ny * qy - line[2]


@borrowing_kernel
def _solve3(h, damping):
    """Damped Gauss-Newton step (x, y, heading) of the normal equations h (9,)."""
    a00, a01, a02, a11, a12, a22 = h[0] + damping, h[1], h[2], h[3] + damping, h[4], h[5] + damping
    g0, g1, g2 = h[6], h[7], h[8]
    m0, m1, m2 = a11 * a22 - a12 * a12, a02 * a12 - a01 * a22, a01 * a12 - a02 * a11
    det = a00 * m0 + a01 * m1 + a02 * m2
    n1, n2 = a00 * a22 - a02 * a02, a01 * a02 - a00 * a12
    n3 = a00 * a11 - a01 * a01
    return (
        -(m0 * g0 + m1 * g1 + m2 * g2) / det,
        -(m1 * g0 + n1 * g1 + n2 * g2) / det,
        -(m2 * g0 + n2 * g1 + n3 * g2) / det,
    )


@borrowing_kernel
def refine_pose(
    cells, lines, origin, inverse_m, points, n, guess, distance_max, iterations, degenerate_share, stop_m, stop_rad,
    scratch, pose, h,
):  # fmt: skip
    """Gauss-Newton from a guess (3,), without steps along a degenerate direction, which the walls do not constrain.

    Writes the pose (3,) and the last h (9,). Returns the sum of weights, the points near walls, whether the match is
    degenerate, and the sum of weights at the guess.
    """
    pose[0], pose[1], pose[2] = guess[0], guess[1], guess[2]
    total, near, begun = 0.0, 0, 0.0
    degenerate = False
    for k in range(iterations):
        total, near = normal_equations(
            cells, lines, origin, inverse_m, points, n, pose[0], pose[1], pose[2], distance_max, scratch, h
        )  # fmt: skip
        if k == 0:
            begun = total
        if total < WEIGHT_MIN:
            break
        degenerate = _weakest(h) < degenerate_share * total
        dx, dy, turn = _solve3(h, 1e-3 * total)
        if degenerate:
            vx, vy = weakest_direction(h)
            along = dx * vx + dy * vy
            dx -= along * vx
            dy -= along * vy
        pose[0] += dx
        pose[1] += dy
        pose[2] += turn
        if abs(dx) < stop_m and abs(dy) < stop_m and abs(turn) < stop_rad:
            break
    return total, near, degenerate, begun


@borrowing_kernel
def _score(cells, origin, inverse_m, points, n, stride, x, y, c, s):
    """Sum over every stride-th point of a score that falls from 1 on a wall to 0 at 0.3 m from it."""
    height, width = cells.shape
    total = 0.0
    for i in range(0, n, stride):
        qx = x + c * points[i, 0] - s * points[i, 1] - origin[0]
        qy = y + s * points[i, 0] + c * points[i, 1] - origin[1]
        if qx < 0.0 or qy < 0.0:
            continue
        column, row = int(qx * inverse_m), int(qy * inverse_m)
        if row < height and column < width:
            total += max(1.0 - distance_in(cells[row, column]) / 0.3, 0.0)
    return total


@borrowing_kernel
def correlate(cells, origin, inverse_m, points, n, guess, window_m, window_rad, step_m, step_rad, stride, best):
    """Exhaustive search in a window around a guess (3,); writes the best pose, returns its mean score in [0, 1]."""
    best_score = -1.0
    turns = int(window_rad / step_rad)
    moves = int(window_m / step_m)
    for k in range(-turns, turns + 1):
        heading = guess[2] + k * step_rad
        c, s = math.cos(heading), math.sin(heading)
        for j in range(-moves, moves + 1):
            for i in range(-moves, moves + 1):
                score = _score(
                    cells, origin, inverse_m, points, n, stride, guess[0] + i * step_m, guess[1] + j * step_m, c, s
                )
                if score > best_score:
                    best_score = score
                    best[0], best[1], best[2] = guess[0] + i * step_m, guess[1] + j * step_m, heading
    return best_score / max((n + stride - 1) // stride, 1)


@borrowing_kernel
def share_near(cells, origin, inverse_m, points, n, pose, near_m):
    """Share of the points within near_m of a wall, with the points at a pose (3,)."""
    height, width = cells.shape
    c, s = math.cos(pose[2]), math.sin(pose[2])
    count = 0
    for i in range(n):
        qx = pose[0] + c * points[i, 0] - s * points[i, 1] - origin[0]
        qy = pose[1] + s * points[i, 0] + c * points[i, 1] - origin[1]
        if qx < 0.0 or qy < 0.0:
            continue
        column, row = int(qx * inverse_m), int(qy * inverse_m)
        if row < height and column < width and distance_in(cells[row, column]) <= near_m:
            count += 1
    return count / max(n, 1)


@borrowing_kernel
def _weight_at(cells, lines, origin, inverse_m, x, y, distance_max):
    """Weight of a point in `normal_equations`; 0 if no wall is near."""
    _, _, away = _line_at(cells, lines, origin, inverse_m, x, y, distance_max)
    return 1.0 / (1.0 + away * away / ROBUST_SCALE_M**2) if abs(away) <= distance_max else 0.0


@borrowing_kernel
def weight_changes(cells, lines, origin, inverse_m, points, n, before, after, distance_max):
    """Sums of the weights that points gain, and that others lose, from one pose to another."""
    won = lost = 0.0
    c0, s0, c1, s1 = math.cos(before[2]), math.sin(before[2]), math.cos(after[2]), math.sin(after[2])
    for i in range(n):
        px, py = points[i, 0], points[i, 1]
        x, y = before[0] + c0 * px - s0 * py, before[1] + s0 * px + c0 * py
        weight = _weight_at(cells, lines, origin, inverse_m, x, y, distance_max)
        x, y = after[0] + c1 * px - s1 * py, after[1] + s1 * px + c1 * py
        more = _weight_at(cells, lines, origin, inverse_m, x, y, distance_max) - weight
        won += max(more, 0.0)
        lost += max(-more, 0.0)
    return won, lost


@borrowing_kernel
def fill_information(h, degenerate, scale, out):
    """Write the information h / scale to out (3, 3), if degenerate with zero along that direction."""
    out[0, 0], out[0, 1], out[0, 2], out[1, 1], out[1, 2], out[2, 2] = h[0], h[1], h[2], h[3], h[4], h[5]
    out[1, 0], out[2, 0], out[2, 1] = h[1], h[2], h[4]
    for i in range(3):
        for j in range(3):
            out[i, j] /= scale
    if degenerate:
        vx, vy = weakest_direction(h)
        kxx, kxy, kyy = 1.0 - vx * vx, -vx * vy, 1.0 - vy * vy
        for j in range(3):
            a, b = out[0, j], out[1, j]
            out[0, j], out[1, j] = kxx * a + kxy * b, kxy * a + kyy * b
        for i in range(3):
            a, b = out[i, 0], out[i, 1]
            out[i, 0], out[i, 1] = kxx * a + kxy * b, kxy * a + kyy * b
