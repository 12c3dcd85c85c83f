"""Pictures of a believed map for learners: what lies around one robot, and the whole map shrunk to fit."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from twc_env.kernels import kernel
from twc_env.messages import GridMap

Array = NDArray

FREE, WALL, UNKNOWN, FRONTIER, PATH, MATES, SIGNS = range(7)
CHANNELS = 7
OVERVIEW_CHANNELS = 4
"""Free, wall, this robot, mates."""
FIXED_BITS = 32
FIXED_POINT = 2.0**FIXED_BITS
"""Cell numbers are stepped in whole parts of a cell, so that a step is an addition and a shift, no conversion."""


def crop_around(grid: GridMap, pose_map_robot: Array, cells: int, cell_m: float) -> Array:
    """(7, cells, cells) uint8, 0 or 255: the robot in the middle looks along +column; the last three stay empty.

    A crop cell is a frontier when it is free and has an unknown neighbour in the crop.
    """
    out = np.zeros((CHANNELS, cells, cells), np.uint8)
    x, y = (pose_map_robot[:2] - grid.origin_m).tolist()
    _crop(grid.log_odds, x, y, float(pose_map_robot[2]), 1.0 / grid.resolution_m, cell_m, out)
    return out


def views(
    grids: Sequence[GridMap], poses: Array, cells: int, cell_m: float, paths_odom: Array, path_counts: Array,
    mates: Array, mate_counts: Array, signs: Sequence[Array],
) -> Array:  # fmt: skip
    """`crop_around` of each robot with its last three channels filled too: (robots, 7, cells, cells) uint8.

    poses (robots, 3, 3): in the map frame, its spread, in the odom frame; paths_odom (robots, k, 2): rings that hold
    the latest of `path_counts` places; mates (robots, m, >= 2): the first of them as each robot sees them; signs: of
    each robot (k, 2) in the map frame. Robots that share a map are served by one compiled call.
    """
    out = np.empty((len(grids), CHANNELS, cells, cells), np.uint8)
    first = 0
    for end in range(1, len(grids) + 1):
        grid, places = grids[first], signs[first]
        if end < len(grids) and grids[end].log_odds is grid.log_odds and signs[end] is places:
            continue
        _crop_and_mark(
            grid.log_odds, grid.origin_m, 1.0 / grid.resolution_m, poses, cell_m, paths_odom, path_counts,
            mates, mate_counts, places, first, end, out,
        )  # fmt: skip
        first = end
    return out


def shrink(grid: GridMap, cells: int) -> tuple[Array, Array, float]:
    """The known part of a grid as (2, cells, cells) uint8: share of free and of wall cells, north up as in the grid.

    Also the map-frame corner (2,) of its cell [0, 0] and the length of one of its cells [m].
    """
    out = np.zeros((2, cells, cells), np.uint8)
    row, column, factor = _shrink(grid.log_odds, out)
    corner_m = np.asarray(grid.origin_m, float) + np.array([column, row]) * grid.resolution_m
    return out, corner_m, factor * grid.resolution_m


@kernel
def _mark(channel, points, count, x, y, heading, inverse_m):
    """Set the cells of channel (cells, cells) under the first points of (k, 2), seen from a pose in their frame."""
    size = channel.shape[0]
    half = size // 2
    c, s = math.cos(heading) * inverse_m, math.sin(heading) * inverse_m
    for k in range(min(count, points.shape[0])):
        dx, dy = points[k, 0] - x, points[k, 1] - y
        row, column = math.floor(c * dy - s * dx) + half, math.floor(c * dx + s * dy) + half
        if 0 <= row < size and 0 <= column < size:
            channel[row, column] = 255


@kernel
def _shrink(log_odds, out):
    """Returns the first row and column of the known box, and how many grid cells go into one of `out`."""
    height, width = log_odds.shape
    size = out.shape[1]
    low_r, high_r, low_c, high_c = height, -1, width, -1
    for r in range(height):
        for c in range(width):
            if log_odds[r, c] != 0:
                low_r, high_r = min(low_r, r), max(high_r, r)
                low_c, high_c = min(low_c, c), max(high_c, c)
    if high_r < 0:
        return 0, 0, 1.0
    factor = max(1.0, max(high_r - low_r + 1, high_c - low_c + 1) / size)
    free, wall = np.zeros((size, size), np.int64), np.zeros((size, size), np.int64)
    for r in range(low_r, high_r + 1):
        i = min(int((r - low_r) / factor), size - 1)
        for c in range(low_c, high_c + 1):
            j = min(int((c - low_c) / factor), size - 1)
            free[i, j] += log_odds[r, c] < 0
            wall[i, j] += log_odds[r, c] > 0
    area = factor * factor
    for i in range(size):
        for j in range(size):
            out[0, i, j] = int(255.0 * min(1.0, free[i, j] / area))
            out[1, i, j] = int(255.0 * min(1.0, wall[i, j] / factor))
    return low_r, low_c, factor


@kernel
def _stays_inside(x, y, dx, dy, count, height, width):
    """Whether a row of samples from cell (x, y) on, in fixed point, lies inside the grid."""
    k0, k1 = x >> FIXED_BITS, (x + dx * (count - 1)) >> FIXED_BITS
    r0, r1 = y >> FIXED_BITS, (y + dy * (count - 1)) >> FIXED_BITS
    return min(k0, k1) >= 0 and min(r0, r1) >= 0 and max(k0, k1) < width and max(r0, r1) < height


@kernel
def _misses(x, y, dx, dy, count, height, width):
    """Whether a row of samples lies beside the grid, so that it meets none of its cells."""
    k0, k1 = x >> FIXED_BITS, (x + dx * (count - 1)) >> FIXED_BITS
    r0, r1 = y >> FIXED_BITS, (y + dy * (count - 1)) >> FIXED_BITS
    return max(k0, k1) < 0 or max(r0, r1) < 0 or min(k0, k1) >= width or min(r0, r1) >= height


@kernel
def _look_up_two(cells, width, xa, ya, xb, yb, dx, dy, a, b):
    """Write the levels of two rows of samples that lie inside the grid; unsigned numbers index without a check."""
    bits, width = np.uint64(FIXED_BITS), np.uint64(width)
    xa, ya, xb, yb, dx, dy = np.uint64(xa), np.uint64(ya), np.uint64(xb), np.uint64(yb), np.uint64(dx), np.uint64(dy)
    for j in range(a.shape[0]):
        a[j] = cells[(ya >> bits) * width + (xa >> bits)]
        b[j] = cells[(yb >> bits) * width + (xb >> bits)]
        xa += dx
        ya += dy
        xb += dx
        yb += dy


@kernel
def _look_up(cells, height, width, x, y, dx, dy, levels):
    """Write the levels of a row of samples; 0 outside the grid."""
    for j in range(levels.shape[0]):
        k, r = x >> FIXED_BITS, y >> FIXED_BITS
        levels[j] = cells[r * width + k] if 0 <= r < height and 0 <= k < width else 0
        x += dx
        y += dy


@kernel
def _crop(log_odds, x, y, heading, inverse_m, cell_m, out):
    """Egocentric view, robot in the middle and looking along +column: out[FREE], WALL, UNKNOWN, FRONTIER (255 or 0).

    Each cell takes two samples on one of its diagonals, by turns, so that a thin wall hardly slips through. Looking up
    stands apart from comparing, because only the latter gains from being done for many cells at once.
    """
    height, width = log_odds.shape
    size = out.shape[1]
    if height == 0:
        out[:UNKNOWN], out[UNKNOWN], out[FRONTIER] = 0, 255, 0
        return
    step = 0.5 * cell_m * inverse_m
    c, s = math.cos(heading) * step, math.sin(heading) * step
    first = 0.5 - 2 * (size // 2)  # in samples, two to a cell
    x0 = x * inverse_m + first * (c - s)
    y0 = y * inverse_m + first * (s + c)
    cells = log_odds.reshape(-1)
    dx, dy = int(2 * c * FIXED_POINT), int(2 * s * FIXED_POINT)
    levels, is_known = np.empty((2, size), np.int16), np.empty(size, np.bool_)
    for i in range(size):
        line, shift = 2 * i, i & 1
        xa = int(math.floor((x0 - s * line + c * shift) * FIXED_POINT))
        ya = int(math.floor((y0 + c * line + s * shift) * FIXED_POINT))
        line, shift = line + 1, 1 - shift
        xb = int(math.floor((x0 - s * line + c * shift) * FIXED_POINT))
        yb = int(math.floor((y0 + c * line + s * shift) * FIXED_POINT))
        if _misses(xa, ya, dx, dy, size, height, width) and _misses(xb, yb, dx, dy, size, height, width):
            out[0, i], out[1, i], out[2, i], is_known[i] = 0, 0, 255, False
            continue
        is_known[i] = True
        is_inside = _stays_inside(xa, ya, dx, dy, size, height, width)
        if is_inside and _stays_inside(xb, yb, dx, dy, size, height, width):
            _look_up_two(cells, width, xa, ya, xb, yb, dx, dy, levels[0], levels[1])
        else:
            _look_up(cells, height, width, xa, ya, dx, dy, levels[0])
            _look_up(cells, height, width, xb, yb, dx, dy, levels[1])
        free, wall, unknown = out[0, i], out[1, i], out[2, i]
        for j in range(size):
            is_wall = (levels[0, j] > 0) | (levels[1, j] > 0)
            is_free = ((levels[0, j] < 0) | (levels[1, j] < 0)) & (not is_wall)
            wall[j], free[j] = np.uint8(is_wall) * np.uint8(255), np.uint8(is_free) * np.uint8(255)
            unknown[j] = np.uint8(not (is_wall | is_free)) * np.uint8(255)
    out[3] = 0
    for i in range(1, size - 1):
        if not is_known[i]:
            continue
        above, here, below = out[2, i - 1], out[2, i], out[2, i + 1]
        free, frontier = out[0, i], out[3, i]
        for j in range(1, size - 1):
            frontier[j] = free[j] & (above[j] | below[j] | here[j - 1] | here[j + 1])


@kernel
def _crop_and_mark(
    log_odds, origin, inverse_grid_m, poses, cell_m, paths, path_counts, mates, mate_counts, signs, first, end, out
):
    """All channels of the robots from `first` to before `end`: what lies around each, its path, mates and signs."""
    inverse_m = 1.0 / cell_m
    for i in range(first, end):
        here, odom = poses[i, 0], poses[i, 2]
        _crop(log_odds, here[0] - origin[0], here[1] - origin[1], here[2], inverse_grid_m, cell_m, out[i])
        out[i, 4:] = 0
        _mark(out[i, 4], paths[i], path_counts[i], odom[0], odom[1], odom[2], inverse_m)
        _mark(out[i, 5], mates[i], mate_counts[i], 0.0, 0.0, 0.0, inverse_m)
        _mark(out[i, 6], signs, signs.shape[0], here[0], here[1], here[2], inverse_m)
