"""Draw the walls that scans saw into a field of lines, in which each cell knows the wall nearest to it.

Neighbouring end points are joined to straight pieces of wall, and each piece tells the cells around it of its line.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.kernels import borrowing_kernel
from twc_env.slam.wall_cells import LINES_MAX, NO_WALL, distance_in, line_in, wall_cell

REACH_M = 0.49
"""Cells further from a wall than this know nothing of it; less than half a metre (`wall_cells`)."""
SAME_WALL_M = 0.02
"""A piece of wall this near to a line that is already known adds nothing."""
JUMP_MAX_M, JUMP_BEAMS = 0.5, 180
"""Neighbouring beams whose end points are further apart lie on different surfaces; where a turn has fewer beams than
so many, as much further as there are fewer. But what then is further apart than the first needs a third point that
lies on the same line: alone, it may be two edges of a doorway."""
PIECE_M, PIECE_NOISES = 0.3, 30.0
"""Neighbouring end points are joined to pieces of wall about this long, or as many times as long as ranges err: the
shorter a piece for the error of its points, the more it lies askew."""
STRAIGHT_M, STRAIGHT_NOISES = 0.02, 2.0
"""None of them is further than this from the chord ..."""
CUT_MIN_M, CUT_NOISES = 0.1, 10.0
"""... of which no shorter one is looked at: end points that lie as close as they err give it any direction, and pieces
of walls that run across a corridor hold the robot back."""
LINES = 4
"""Where `drawn` counts the lines."""
NOWHERE = 2**31
"""Left and bottom end of what is drawn, while there is nothing."""
BLOCK_CELLS = 16
"""Cells of a row that are told of a wall at once: a few too many are quicker than a remainder."""


@borrowing_kernel
def _knows(cells, lines, inverse_m, nx, ny, mx, my):
    """Whether the place (mx, my) [m from the field's corner] lies on a wall that is drawn, of nearly this normal."""
    column, row = int(mx * inverse_m), int(my * inverse_m)
    if not (0 <= row < cells.shape[0] and 0 <= column < cells.shape[1]):
        return False
    if distance_in(cells[row, column]) >= 1.0 / inverse_m:
        return False
    line = lines[line_in(cells[row, column])]
    return abs(line[0] * nx + line[1] * ny) > 0.97 and abs(line[0] * mx + line[1] * my - line[2]) < SAME_WALL_M


@borrowing_kernel
def _stamp(cells, lines, inverse_m, ax, ay, bx, by, nx, ny, offset, drawn):
    """Tell the cells around the wall piece a-b [m from the field's corner] of its line, where it is the nearest."""
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
        for first in range(left, right, BLOCK_CELLS):  # many cells at once, as all of this is 32 bits wide
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
    """Where beams end, the last one first and last: ends (2, beams + 1), NaN where they met nothing.

    follows (beams + 1,): whether an end point lies on the same surface as the one before. For many beams at once.
    limits: of `drawing_limits`.
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
def _is_straight(ends, first, last, limits):
    """Whether the end points between first and last lie near the chord from one to the other."""
    ax, ay = ends[0, first], ends[1, first]
    ex, ey = ends[0, last] - ax, ends[1, last] - ay
    squared = ex * ex + ey * ey
    if squared < limits[2]:
        return True
    limit = limits[3] * squared
    for i in range(first + 1, last):
        across = (ends[1, i] - ay) * ex - (ends[0, i] - ax) * ey
        if across * across > limit:
            return False
    return True


@borrowing_kernel
def _cut_run(ends, begin, end, limits, pieces, count):
    """Cut one surface, end points that follow each other without a jump, into straight pieces behind the `count` first.

    pieces (2, n): number of the first and the last end point. Gives how many pieces there are then.
    """
    first = begin
    for i in range(begin + 1, end):
        if not _is_straight(ends, first, i, limits):
            pieces[0, count], pieces[1, count] = first, i - 1
            count += 1
            first = i - 1
        dx, dy = ends[0, i] - ends[0, first], ends[1, i] - ends[1, first]
        squared = dx * dx + dy * dy
        if i == end - 1 or (squared >= limits[4] and (i - first > 1 or squared <= limits[1])):
            pieces[0, count], pieces[1, count] = first, i
            count += 1
            first = i
    return count


@borrowing_kernel
def _sum_up(ends, first, last, p, sums):
    """Sums over the end points of a piece of wall, seen from the first of them, to column p of sums."""
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
    """The straight lines of least squares through pieces of wall, from sums (6, n) over their end points.

    fits (4, n): a normal, and the middle of the end points seen from the first. For many pieces at once.
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
    """Where beams end, the pieces of wall that they make up, the lines of these, and the cells around them."""
    ends, follows, pieces, sums, fits, limits = room
    x, y = pose[0] - origin[0], pose[1] - origin[1]
    _place_ends(x, y, math.cos(pose[2]), math.sin(pose[2]), directions, ranges, range_max, limits, ends, follows)
    begin = count = 0 * ranges.shape[0]  # a plain 0 is a type of its own, for which the callees are compiled again
    for i in range(1, follows.shape[0] + 1):
        if i == follows.shape[0] or not follows[i]:
            count = _cut_run(ends, begin, i, limits, pieces, count)
            begin = i
    for p in range(count):
        _sum_up(ends, pieces[0, p], pieces[1, p], p, sums)
    _fit_lines(count, sums, fits)
    for p in range(count):
        first, last, nx, ny = pieces[0, p], pieces[1, p], fits[0, p], fits[1, p]
        ax, ay, bx, by = ends[0, first], ends[1, first], ends[0, last], ends[1, last]
        if last - first == 1 and (bx - ax) ** 2 + (by - ay) ** 2 > limits[1]:
            continue
        offset = nx * (ax + fits[2, p]) + ny * (ay + fits[3, p])
        _stamp(cells, lines, inverse_m, ax, ay, bx, by, nx, ny, offset, drawn)


@borrowing_kernel
def _is_sound(pose, ranges):
    """Whether a pose is finite, and ranges numbers; infinite ones mean no return."""
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

    A line is a normal and an offset. origin (2,): the field's corner, from which the offsets are measured. directions
    (beams, 2): cosine and sine. room: of `drawing_room`. drawn (5,): left, bottom, right and top end of
    the cells drawn so far, widened here, and how many lines there are. Gives False, and draws nothing, where a range is
    no number or a pose is not finite; walls for which there are no lines left are left out.
    """
    for k in range(poses.shape[0]):
        if not _is_sound(poses[k], scans[k]):
            return False
    for k in range(poses.shape[0]):
        _add_scan(cells, lines, origin, inverse_m, poses[k], directions, scans[k], range_max, room, drawn)
    return True


@borrowing_kernel
def forget_walls(cells, drawn):
    """Let the cells drawn so far know no wall."""
    for row in range(drawn[1], drawn[3]):
        for column in range(drawn[0], drawn[2]):
            cells[row, column] = NO_WALL
    drawn[0], drawn[1], drawn[2], drawn[3], drawn[LINES] = NOWHERE, NOWHERE, 0, 0, 0


def drawing_limits(beams: int, range_noise_std_m: float) -> Array:
    """(5,) squares [m2]: how far end points may be apart that follow each other, and two of which there is no third;
    the shortest chord that is looked at, how far points may be from one, and how long a piece is."""
    noise_m = range_noise_std_m
    return np.square([
        JUMP_MAX_M * max(1.0, JUMP_BEAMS / beams), JUMP_MAX_M, max(CUT_MIN_M, CUT_NOISES * noise_m),
        max(STRAIGHT_M, STRAIGHT_NOISES * noise_m), max(PIECE_M, PIECE_NOISES * noise_m),
    ])  # fmt: skip


def drawing_room(beams: int, range_noise_std_m: float) -> tuple[Array, ...]:
    """Room for `draw_scans` to work in, for scans of so many beams that err by so much: where they end and whether on
    the surface of the one before, pieces of wall, their sums and lines; and `drawing_limits`."""
    ends, pieces = (np.empty((2, beams + 1)), np.empty(beams + 1, bool)), np.empty((2, beams), np.int64)
    return *ends, pieces, np.empty((6, beams)), np.empty((4, beams)), drawing_limits(beams, range_noise_std_m)
