"""Draw the walls that scans saw into a field of lines, in which each cell knows the wall nearest to it.

Neighbouring end points are joined to straight pieces of wall, and each piece tells the cells around it of its line.
"""

from __future__ import annotations

import math

import numpy as np

from twc_env.kernels import borrowing_kernel, kernel

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


@borrowing_kernel
def _stamp(walls, inverse_m, ax, ay, bx, by, nx, ny, offset, drawn, squares):
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
        wall = walls[row, column]
        if abs(wall[0] * nx + wall[1] * ny) > 0.97 and abs(wall[0] * mx + wall[1] * my - wall[2]) < SAME_WALL_M:
            return
    left = max(0, int((min(ax, bx) - REACH_M) * inverse_m))
    right = min(width - 1, int((max(ax, bx) + REACH_M) * inverse_m)) + 1
    bottom = max(0, int((min(ay, by) - REACH_M) * inverse_m))
    top = min(height - 1, int((max(ay, by) + REACH_M) * inverse_m)) + 1
    if left >= right or bottom >= top:
        return
    drawn[0], drawn[1] = min(drawn[0], left), min(drawn[1], bottom)
    drawn[2], drawn[3] = max(drawn[2], right), max(drawn[3], top)
    dx = (left + 0.5) * cell - ax
    for r in range(bottom, top):
        dy = (r + 0.5) * cell - ay
        along, across = np.float32(dx * ex + dy * ey), np.float32(dy * ex - dx * ey)
        along_step, across_step, end = np.float32(cell * ex), np.float32(-cell * ey), np.float32(length)
        for j in range(right - left):  # many cells at once, as all of this is float32
            k = np.float32(np.int32(j))
            a, b = along + k * along_step, across + k * across_step
            beyond = max(np.float32(0.0), max(-a, a - end))
            squares[j] = b * b + beyond * beyond
        cells = walls[r]
        for j in range(right - left):
            held = cells[left + j, 3]
            if squares[j] < held * held:
                wall = cells[left + j]
                wall[0], wall[1], wall[2], wall[3] = nx, ny, offset, math.sqrt(squares[j])


@borrowing_kernel
def _add_piece(walls, inverse_m, ends, first, last, drawn, squares):
    """Draw the piece of wall along the end points first..last: the straight line of least squares through them."""
    ax, ay, bx, by = ends[first, 0], ends[first, 1], ends[last, 0], ends[last, 1]
    sx = sy = xx = xy = yy = 0.0
    for i in range(first, last + 1):
        dx, dy = ends[i, 0] - ax, ends[i, 1] - ay
        sx += dx
        sy += dy
        xx += dx * dx
        xy += dx * dy
        yy += dy * dy
    mx, my = sx / (last - first + 1), sy / (last - first + 1)
    xx -= sx * mx
    xy -= sx * my
    yy -= sy * my
    # The normal of the larger eigenvalue's direction, whose doubled angle has tangent 2 xy / (xx - yy).
    gap = xx - yy
    root = math.sqrt(gap * gap + 4.0 * xy * xy)
    nx, ny = 0.0, 1.0
    if root > 0.0 and gap >= 0.0:
        ny = math.sqrt(0.5 + 0.5 * gap / root)
        nx = -xy / (root * ny)
    elif root > 0.0:
        nx = -math.copysign(math.sqrt(0.5 - 0.5 * gap / root), xy)
        ny = -xy / (root * nx)
    _stamp(walls, inverse_m, ax, ay, bx, by, nx, ny, nx * (ax + mx) + ny * (ay + my), drawn, squares)


@borrowing_kernel
def _is_straight(ends, first, last):
    """Whether the end points between first and last lie near the chord from one to the other."""
    ax, ay = ends[first, 0], ends[first, 1]
    ex, ey = ends[last, 0] - ax, ends[last, 1] - ay
    limit = STRAIGHT_M * STRAIGHT_M * (ex * ex + ey * ey)
    for i in range(first + 1, last):
        across = (ends[i, 1] - ay) * ex - (ends[i, 0] - ax) * ey
        if across * across > limit:
            return False
    return True


@borrowing_kernel
def _add_run(walls, inverse_m, ends, count, drawn, squares):
    """Draw one surface: end points that follow each other without a jump, cut into straight pieces."""
    first = 0 * count  # a plain 0 is a type of its own, for which the callees would be compiled again
    for i in range(1, count):
        if not _is_straight(ends, first, i):
            _add_piece(walls, inverse_m, ends, first, i - 1, drawn, squares)
            first = i - 1
        dx, dy = ends[i, 0] - ends[first, 0], ends[i, 1] - ends[first, 1]
        if i == count - 1 or dx * dx + dy * dy >= PIECE_M * PIECE_M:
            _add_piece(walls, inverse_m, ends, first, i, drawn, squares)
            first = i


@borrowing_kernel
def _add_scan(walls, origin, inverse_m, pose, directions, ranges, range_max, ends, drawn, squares):
    beams = ranges.shape[0]
    c, s = math.cos(pose[2]), math.sin(pose[2])
    x, y = pose[0] - origin[0], pose[1] - origin[1]
    count = np.int64(0)
    for k in range(-1, beams):
        i = k if k >= 0 else beams - 1
        r = ranges[i]
        if r >= range_max or r < 0.0:
            _add_run(walls, inverse_m, ends, count, drawn, squares)
            count = np.int64(0)
            continue
        dx, dy = directions[i, 0], directions[i, 1]
        qx, qy = x + r * (c * dx - s * dy), y + r * (s * dx + c * dy)
        if count and (qx - ends[count - 1, 0]) ** 2 + (qy - ends[count - 1, 1]) ** 2 >= JUMP_MAX_M**2:
            _add_run(walls, inverse_m, ends, count, drawn, squares)
            count = np.int64(0)
        ends[count, 0], ends[count, 1] = qx, qy
        count += 1
    _add_run(walls, inverse_m, ends, count, drawn, squares)


@kernel
def _add_scans(walls, origin, inverse_m, poses, directions, scans, range_max, drawn):
    """Draw scans whose numbers are sound."""
    ends = np.empty((scans.shape[1] + 1, 2))
    squares = np.empty(int((2 * JUMP_MAX_M + 2 * REACH_M) * inverse_m) + 3, np.float32)
    for k in range(poses.shape[0]):
        _add_scan(walls, origin, inverse_m, poses[k], directions, scans[k], range_max, ends, drawn, squares)


@borrowing_kernel
def _are_sound(poses, scans):
    """Whether all poses are finite, and ranges numbers; infinite ones mean no return."""
    are_sound = True
    for k in range(poses.shape[0]):
        for axis in range(3):
            are_sound &= math.isfinite(poses[k, axis])
        for i in range(scans.shape[1]):
            are_sound &= scans[k, i] > -np.inf
    return are_sound


@borrowing_kernel
def draw_scans(walls, origin, inverse_m, poses, directions, scans, range_max, drawn):
    """Draw scans (k, beams) [m] taken at poses (k, 3) into walls (rows, columns, 4): normal, offset, distance.

    origin (2,): the field's corner, from which the offsets are measured. directions (beams, 2): cosine and sine.
    drawn (4,): left, bottom, right and top end of the cells drawn so far, widened here. Gives False, and draws nothing,
    where a range is no number or a pose is not finite.
    """
    if not _are_sound(poses, scans):
        return False
    _add_scans(walls, origin, inverse_m, poses, directions, scans, range_max, drawn)
    return True
