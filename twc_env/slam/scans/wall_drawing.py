"""Draw the walls seen by scans into a line field, in which each cell stores the nearest wall.

Neighbouring end points are joined to straight wall pieces, and each piece writes its line to the cells around it.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.config.range_noise import RangeNoise
from twc_env.kernels.compiled import borrowing_kernel
from twc_env.slam.scans.wall_cells import LINES_MAX, NO_WALL, distance_in, line_in, wall_cell

REACH_M = 0.49
"""Cells further from a wall do not store it; below half a metre (`wall_cells`)."""
SAME_WALL_M = 0.02
"""A wall piece this near to a known line is not added."""
JUMP_MAX_M, JUMP_BEAMS = 0.5, 180
"""Neighbouring end points further apart are on different surfaces. With fewer than JUMP_BEAMS beams per turn the limit
grows in proportion, but points further apart than JUMP_MAX_M then need a third one on the same line: two alone may be
the edges of a doorway."""
PIECE_M, PIECE_NOISES = 0.3, 30.0
"""Length of a wall piece, or as a multiple of the range noise: the shorter a piece relative to the noise, the less
accurate is its direction."""
STRAIGHT_M, STRAIGHT_NOISES = 0.02, 2.0
"""Maximum distance of a piece's points from its chord ..."""
CUT_MIN_M, CUT_NOISES = 0.1, 10.0
"""... tested from this chord length on: points as close as their noise have an arbitrary direction, and wall pieces
across a corridor would hold the robot back. Where noise grows with range, these three grow beyond the typical range."""
NOISY_M, ASKEW_MAX_RAD = 0.03, 0.3
"""Where noise grows with range and is greater than this, no wall piece is drawn whose direction has a greater standard
deviation: of the pieces that are left at the ends of walls, many lie across a corridor. With constant noise of 3 and
5 cm that brought nothing."""
LINES = 4
"""Index in `drawn` of the number of lines."""
NOWHERE = 2**31
"""Left and bottom of the drawn box while it is empty."""
BLOCK_CELLS = 16
"""Cells of a row that are updated at once: a few too many are faster than a remainder loop."""


@borrowing_kernel
def _knows(cells, lines, inverse_m, nx, ny, mx, my):
    """Whether the point (mx, my) [m from the field's corner] lies on a drawn wall with nearly this normal."""
    column, row = int(mx * inverse_m), int(my * inverse_m)
    if not (0 <= row < cells.shape[0] and 0 <= column < cells.shape[1]):
        return False
    if distance_in(cells[row, column]) >= 1.0 / inverse_m:
        return False
    line = lines[line_in(cells[row, column])]
    return abs(line[0] * nx + line[1] * ny) > 0.97 and abs(line[0] * mx + line[1] * my - line[2]) < SAME_WALL_M


@borrowing_kernel
def _stamp(cells, lines, inverse_m, ax, ay, bx, by, nx, ny, offset, drawn):
    """Write the line of the wall piece a-b [m from the field's corner] to the cells for which it is the nearest."""
    height, width = cells.shape
    ex, ey = bx - ax, by - ay
    length = math.sqrt(ex * ex + ey * ey)
    if length < 1e-6 or _knows(cells, lines, inverse_m, nx, ny, 0.5 * (ax + bx), 0.5 * (ay + by)):
        return
    ex /= length
    ey /= length
    left = max(0, int((min(ax, bx) - REACH_M) * inverse_m))
    right = min(width - 1, int((max(ax, bx) + REACH_M) * inverse_m)) + 1
    bottom = max(0, int((min(ay, by) - REACH_M) * inverse_m))
    top = min(height - 1, int((max(ay, by) + REACH_M) * inverse_m)) + 1
    if left >= right or bottom >= top or drawn[LINES] >= LINES_MAX:
        return
    line = np.uint32(drawn[LINES])
    lines[line, 0], lines[line, 1], lines[line, 2] = nx, ny, offset
    drawn[LINES] += 1
    drawn[0], drawn[1] = min(drawn[0], left), min(drawn[1], bottom)
    drawn[2], drawn[3] = max(drawn[2], right), max(drawn[3], top)
    cell = 1.0 / inverse_m
    along_step, across_step, end = np.float32(cell * ex), np.float32(-cell * ey), np.float32(length)
    for r in range(bottom, top):
        dy, row = (r + 0.5) * cell - ay, cells[r]
        for first in range(left, right, BLOCK_CELLS):  # vectorises, as all values have 32 bits
            start = min(first, width - BLOCK_CELLS)
            dx = (start + 0.5) * cell - ax
            along, across = np.float32(dx * ex + dy * ey), np.float32(dy * ex - dx * ey)
            block = row[start : start + BLOCK_CELLS]
            for j in range(BLOCK_CELLS):
                k = np.float32(np.int32(j))
                a, b = along + k * along_step, across + k * across_step
                beyond = max(np.float32(0.0), max(-a, a - end))
                away = np.float32(math.sqrt(b * b + beyond * beyond))
                told = wall_cell(min(away, np.float32(REACH_M)), line)
                block[j] = min(block[j], told if away <= np.float32(REACH_M) else NO_WALL)


@borrowing_kernel
def _place_ends(x, y, c, s, directions, ranges, range_max, limits, ends, follows):
    """End points of the beams, the last one also first: ends (2, beams + 1), NaN without return.

    follows (beams + 1,): whether an end point is on the same surface as the previous one. Vectorised over beams.
    limits: from `drawing_limits`.
    """
    beams, along, across = ranges.shape[0], ends[0], ends[1]
    for i in range(beams):
        r, dx, dy = ranges[i], directions[i, 0], directions[i, 1]
        is_met = (r >= 0.0) & (r < range_max)
        along[i + 1] = x + r * (c * dx - s * dy) if is_met else math.nan
        across[i + 1] = y + r * (s * dx + c * dy)
    along[0], across[0], follows[0] = along[beams], across[beams], False
    for i in range(beams):
        dx, dy = along[i + 1] - along[i], across[i + 1] - across[i]
        follows[i + 1] = dx * dx + dy * dy < limits[0]


@borrowing_kernel
def _roughness(dx, dy, limits):
    """Variance of the range of a point this far from the scanner, as a multiple of that at the typical range."""
    return limits[5] + limits[6] * (dx * dx + dy * dy)


@borrowing_kernel
def _is_straight(ends, first, last, limits, rougher):
    """Whether the end points between first and last are near the chord."""
    ax, ay = ends[0, first], ends[1, first]
    ex, ey = ends[0, last] - ax, ends[1, last] - ay
    squared = ex * ex + ey * ey
    if squared < limits[2] * rougher:
        return True
    limit = limits[3] * rougher * squared
    for i in range(first + 1, last):
        across = (ends[1, i] - ay) * ex - (ends[0, i] - ax) * ey
        if across * across > limit:
            return False
    return True


@borrowing_kernel
def _cut_run(ends, x, y, begin, end, limits, pieces, count):
    """Split one surface, consecutive end points without a jump, into straight pieces appended to the first `count`.

    x, y: of the scanner. pieces (2, n): index of the first and last end point. Returns the new number of pieces.
    """
    first = begin
    for i in range(begin + 1, end):
        rougher = max(1.0, _roughness(ends[0, i] - x, ends[1, i] - y, limits))
        if not _is_straight(ends, first, i, limits, rougher):
            pieces[0, count], pieces[1, count] = first, i - 1
            count += 1
            first = i - 1
        dx, dy = ends[0, i] - ends[0, first], ends[1, i] - ends[1, first]
        squared = dx * dx + dy * dy
        if i == end - 1 or (squared >= limits[4] * rougher and (i - first > 1 or squared <= limits[1])):
            pieces[0, count], pieces[1, count] = first, i
            count += 1
            first = i
    return count


@borrowing_kernel
def _sum_up(ends, first, last, p, sums):
    """Moments of the end points of a piece, relative to the first of them, to column p of sums."""
    ax, ay = ends[0, first], ends[1, first]
    sx = sy = xx = xy = yy = 0.0
    for i in range(first, last + 1):
        dx, dy = ends[0, i] - ax, ends[1, i] - ay
        sx += dx
        sy += dy
        xx += dx * dx
        xy += dx * dy
        yy += dy * dy
    sums[0, p], sums[1, p], sums[2, p], sums[3, p], sums[4, p], sums[5, p] = sx, sy, xx, xy, yy, last - first + 1


@borrowing_kernel
def _fit_lines(count, sums, fits):
    """Least-squares lines through wall pieces, from the moments (6, n) of their end points.

    fits (4, n): normal, and centroid of the end points relative to the first. Vectorised over pieces.
    """
    sum_x, sum_y, sum_xx, sum_xy, sum_yy, number = sums[0], sums[1], sums[2], sums[3], sums[4], sums[5]
    normal_x, normal_y, middle_x, middle_y = fits[0], fits[1], fits[2], fits[3]
    for p in range(count):
        sx, sy = sum_x[p], sum_y[p]
        mx, my = sx / number[p], sy / number[p]
        xx, xy, yy = sum_xx[p] - sx * mx, sum_xy[p] - sx * my, sum_yy[p] - sy * my
        # The normal of the larger eigenvalue's direction, whose doubled angle has tangent 2 xy / (xx - yy).
        gap = xx - yy
        root = math.sqrt(gap * gap + 4.0 * xy * xy)
        large = math.sqrt(0.5 + abs(0.5 * gap / root))
        small = xy / (root * large)
        nx, ny = (-small, large) if gap >= 0.0 else (-large if xy >= 0.0 else large, abs(small))
        normal_x[p], normal_y[p] = nx if root > 0.0 else 0.0, ny if root > 0.0 else 1.0
        middle_x[p], middle_y[p] = mx, my


@borrowing_kernel
def _add_scan(cells, lines, origin, inverse_m, pose, directions, ranges, range_max, room, drawn):
    """End points, wall pieces, their lines, and the cells around them."""
    ends, follows, pieces, sums, fits, limits = room
    x, y = pose[0] - origin[0], pose[1] - origin[1]
    _place_ends(x, y, math.cos(pose[2]), math.sin(pose[2]), directions, ranges, range_max, limits, ends, follows)
    begin = count = 0 * ranges.shape[0]  # a literal 0 has another type, for which the callees would be compiled again
    for i in range(1, follows.shape[0] + 1):
        if i == follows.shape[0] or not follows[i]:
            count = _cut_run(ends, x, y, begin, i, limits, pieces, count)
            begin = i
    for p in range(count):
        _sum_up(ends, pieces[0, p], pieces[1, p], p, sums)
    _fit_lines(count, sums, fits)
    for p in range(count):
        first, last, nx, ny = pieces[0, p], pieces[1, p], fits[0, p], fits[1, p]
        ax, ay, bx, by = ends[0, first], ends[1, first], ends[0, last], ends[1, last]
        if last - first == 1 and (bx - ax) ** 2 + (by - ay) ** 2 > limits[1]:
            continue
        roughness = _roughness(ax + fits[2, p] - x, ay + fits[3, p] - y, limits)
        if roughness > limits[7] and limits[8] * roughness > ((bx - ax) ** 2 + (by - ay) ** 2) * (last - first + 1):
            continue
        offset = nx * (ax + fits[2, p]) + ny * (ay + fits[3, p])
        _stamp(cells, lines, inverse_m, ax, ay, bx, by, nx, ny, offset, drawn)


@borrowing_kernel
def _is_sound(pose, ranges):
    """Whether a pose is finite and no range is NaN or -inf; +inf means no return."""
    is_sound = math.isfinite(pose[0]) and math.isfinite(pose[1]) and math.isfinite(pose[2])
    for i in range(ranges.shape[0]):
        is_sound &= ranges[i] > -np.inf
    return is_sound


@borrowing_kernel
def draw_scan(cells, lines, origin, inverse_m, pose, directions, ranges, range_max, room, drawn):
    """`draw_scans` of one scan (beams,) at a pose (3,)."""
    if not _is_sound(pose, ranges):
        return False
    _add_scan(cells, lines, origin, inverse_m, pose, directions, ranges, range_max, room, drawn)
    return True


@borrowing_kernel
def draw_scans(cells, lines, origin, inverse_m, poses, directions, scans, range_max, room, drawn):
    """Draw scans (k, beams) [m] taken at poses (k, 3) into cells (rows, columns), see `wall_cells`, and lines (n, 3).

    A line is a normal and an offset from the field's corner `origin` (2,). directions (beams, 2): cosine and sine.
    room: from `drawing_room`. drawn (5,): left, bottom, right and top end of the drawn cells, extended here, and the
    number of lines. Returns False and draws nothing if a range is NaN or a pose is not finite; when no lines are left,
    further walls are dropped.
    """
    for k in range(poses.shape[0]):
        if not _is_sound(poses[k], scans[k]):
            return False
    for k in range(poses.shape[0]):
        _add_scan(cells, lines, origin, inverse_m, poses[k], directions, scans[k], range_max, room, drawn)
    return True


@borrowing_kernel
def clear_walls(cells, drawn):
    """Reset the drawn cells to no wall."""
    for row in range(drawn[1], drawn[3]):
        for column in range(drawn[0], drawn[2]):
            cells[row, column] = NO_WALL
    drawn[0], drawn[1], drawn[2], drawn[3], drawn[LINES] = NOWHERE, NOWHERE, 0, 0, 0


def drawing_limits(beams: int, noise: RangeNoise) -> Array:
    """(9,) limits: squares [m2] of the maximum distance of consecutive end points, and of two without a third; of the
    shortest chord tested, the maximum distance of points from it, and the length of a piece at the typical range; and
    multiples of the variance of noise there: the constant part, what a squared metre of range adds, and `NOISY_M`; and
    the least squared length [m2] of a piece of one point whose direction is sure enough."""
    typical_m = noise.typical_std_m
    squares = np.square([
        JUMP_MAX_M * max(1.0, JUMP_BEAMS / beams), JUMP_MAX_M, max(CUT_MIN_M, CUT_NOISES * typical_m),
        max(STRAIGHT_M, STRAIGHT_NOISES * typical_m), max(PIECE_M, PIECE_NOISES * typical_m),
    ])  # fmt: skip
    shares = [1.0, 0.0, math.inf]
    if noise.per_m:
        shares = [(part / typical_m) ** 2 for part in (noise.std_m, noise.per_m, NOISY_M)]
    # A line through n points evenly along a length has a direction of variance 12 variance / (n length^2).
    return np.array([*squares, *shares, 12.0 * (typical_m / ASKEW_MAX_RAD) ** 2])


def drawing_room(beams: int, noise: RangeNoise) -> tuple[Array, ...]:
    """Work arrays of `draw_scans` for scans with this many beams and this noise: end points, same-surface flags, wall
    pieces, their moments and lines; and `drawing_limits`."""
    ends, pieces = (np.empty((2, beams + 1)), np.empty(beams + 1, bool)), np.empty((2, beams), np.int64)
    return *ends, pieces, np.empty((6, beams)), np.empty((4, beams)), drawing_limits(beams, noise)
