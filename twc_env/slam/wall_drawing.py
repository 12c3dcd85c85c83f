"""Draw the walls that scans saw into a field of lines, in which each cell knows the wall nearest to it.

Neighbouring end points are joined to straight pieces of wall, and each piece tells the cells around it of its line.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

REACH_M = 0.45
"""Cells further from a wall than this know nothing of it."""
SAME_WALL_M = 0.02
"""A piece of wall this near to a line that is already known adds nothing."""
JUMP_MAX_M = 0.5
"""Neighbouring beams whose end points are further apart lie on different surfaces."""
PIECE_M = 0.3
"""Neighbouring end points are joined to pieces of wall about this long ..."""
STRAIGHT_M = 0.02
"""... if none of them is further than this from the chord."""


@njit(cache=True, error_model="numpy")
def _stamp(walls, inverse_m, ax, ay, bx, by, nx, ny, offset, drawn):
    """Tell the cells around the wall piece a-b [m from the field's corner] of its line, where it is the nearest."""
    height, width = walls.shape[0], walls.shape[1]
    ex, ey = bx - ax, by - ay
    length = math.sqrt(ex * ex + ey * ey)
    if length < 1e-6:
        return
    ex /= length
    ey /= length
    mx, my = 0.5 * (ax + bx), 0.5 * (ay + by)
    column, row = int(mx * inverse_m), int(my * inverse_m)
    cell = 1.0 / inverse_m
    if 0 <= row < height and 0 <= column < width and walls[row, column, 3] < cell:
        is_parallel = abs(walls[row, column, 0] * nx + walls[row, column, 1] * ny) > 0.97
        gap = abs(walls[row, column, 0] * mx + walls[row, column, 1] * my - walls[row, column, 2])
        if is_parallel and gap < SAME_WALL_M:
            return
    first_column = max(0, int((min(ax, bx) - REACH_M) * inverse_m))
    last_column = min(width - 1, int((max(ax, bx) + REACH_M) * inverse_m))
    first_row = max(0, int((min(ay, by) - REACH_M) * inverse_m))
    last_row = min(height - 1, int((max(ay, by) + REACH_M) * inverse_m))
    drawn[0], drawn[1] = min(drawn[0], first_column), min(drawn[1], first_row)
    drawn[2], drawn[3] = max(drawn[2], last_column + 1), max(drawn[3], last_row + 1)
    for r in range(first_row, last_row + 1):
        dy = (r + 0.5) * cell - ay
        for c in range(first_column, last_column + 1):
            dx = (c + 0.5) * cell - ax
            along = dx * ex + dy * ey
            across = dy * ex - dx * ey
            beyond = max(0.0, max(-along, along - length))
            squared = across * across + beyond * beyond
            held = walls[r, c, 3]
            if squared < held * held:
                walls[r, c, 0] = nx
                walls[r, c, 1] = ny
                walls[r, c, 2] = offset
                walls[r, c, 3] = math.sqrt(squared)


@njit(cache=True, error_model="numpy")
def _add_piece(walls, inverse_m, ends, first, last, drawn):
    """Draw the piece of wall along the end points first..last: the straight line of least squares through them."""
    ax, ay, bx, by = ends[first, 0], ends[first, 1], ends[last, 0], ends[last, 1]
    mx = my = 0.0
    for i in range(first, last + 1):
        mx += ends[i, 0]
        my += ends[i, 1]
    mx /= last - first + 1
    my /= last - first + 1
    xx = xy = yy = 0.0
    for i in range(first, last + 1):
        dx, dy = ends[i, 0] - mx, ends[i, 1] - my
        xx += dx * dx
        xy += dx * dy
        yy += dy * dy
    # The direction of the larger eigenvalue; its half-angle form has no case of its own for either axis.
    half = 0.5 * math.atan2(2.0 * xy, xx - yy)
    nx, ny = -math.sin(half), math.cos(half)
    _stamp(walls, inverse_m, ax, ay, bx, by, nx, ny, nx * mx + ny * my, drawn)


@njit(cache=True, error_model="numpy")
def _is_straight(ends, first, last):
    """Whether the end points between first and last lie near the chord from one to the other."""
    ex, ey = ends[last, 0] - ends[first, 0], ends[last, 1] - ends[first, 1]
    limit = STRAIGHT_M * math.sqrt(ex * ex + ey * ey)
    for i in range(first + 1, last):
        if abs((ends[i, 1] - ends[first, 1]) * ex - (ends[i, 0] - ends[first, 0]) * ey) > limit:
            return False
    return True


@njit(cache=True, error_model="numpy")
def _add_run(walls, inverse_m, ends, count, drawn):
    """Draw one surface: end points that follow each other without a jump, cut into straight pieces."""
    first = 0
    for i in range(1, count):
        if not _is_straight(ends, first, i):
            _add_piece(walls, inverse_m, ends, first, i - 1, drawn)
            first = i - 1
        dx, dy = ends[i, 0] - ends[first, 0], ends[i, 1] - ends[first, 1]
        if i == count - 1 or dx * dx + dy * dy >= PIECE_M * PIECE_M:
            _add_piece(walls, inverse_m, ends, first, i, drawn)
            first = i


@njit(cache=True, error_model="numpy")
def _add_scan(walls, origin, inverse_m, pose, directions, ranges, range_max, ends, drawn):
    beams = ranges.shape[0]
    c, s = math.cos(pose[2]), math.sin(pose[2])
    x, y = pose[0] - origin[0], pose[1] - origin[1]
    count = 0
    for k in range(-1, beams):
        i = k if k >= 0 else beams - 1
        r = ranges[i]
        if r >= range_max or r < 0.0:
            _add_run(walls, inverse_m, ends, count, drawn)
            count = 0
            continue
        dx, dy = directions[i, 0], directions[i, 1]
        qx, qy = x + r * (c * dx - s * dy), y + r * (s * dx + c * dy)
        if count and (qx - ends[count - 1, 0]) ** 2 + (qy - ends[count - 1, 1]) ** 2 >= JUMP_MAX_M**2:
            _add_run(walls, inverse_m, ends, count, drawn)
            count = 0
        ends[count, 0], ends[count, 1] = qx, qy
        count += 1
    _add_run(walls, inverse_m, ends, count, drawn)


@njit(cache=True, error_model="numpy")
def draw_scans(walls, origin, inverse_m, poses, directions, scans, range_max, drawn):
    """Draw scans (k, beams) [m] taken at poses (k, 3) into walls (rows, columns, 4): normal, offset, distance.

    origin (2,): the field's corner, from which the offsets are measured. directions (beams, 2): cosine and sine.
    drawn (4,): left, bottom, right and top end of the cells drawn so far, widened here.
    """
    ends = np.empty((scans.shape[1] + 1, 2))
    for k in range(poses.shape[0]):
        _add_scan(walls, origin, inverse_m, poses[k], directions, scans[k], range_max, ends, drawn)
