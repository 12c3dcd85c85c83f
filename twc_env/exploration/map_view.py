"""Pictures of a believed map for learners: what lies around one robot, and the whole map shrunk to fit."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from twc_env.cell_rows import FIXED_BITS, FIXED_POINT, look_up_row, span_inside
from twc_env.kernels import kernel
from twc_env.messages import GridMap
from twc_env.slam.cell_kinds import FREE as FREE_CELL
from twc_env.slam.cell_kinds import UNKNOWN as UNKNOWN_CELL
from twc_env.slam.cell_kinds import WALL as WALL_CELL
from twc_env.slam.cell_kinds import kinds_of

Array = NDArray

FREE, WALL, UNKNOWN, FRONTIER, PATH, MATES, SIGNS = range(7)
CHANNELS = 7
_BYTE = np.dtype(np.uint8)
OVERVIEW_CHANNELS = 4
"""Free, wall, this robot, mates."""


def crop_around(grid: GridMap, pose_map_robot: Array, cells: int, cell_m: float) -> Array:
    """(7, cells, cells) uint8, 0 or 255: the robot in the middle looks along +column; the last three stay empty.

    A cell shows what stands in the square of four cells of the map around its middle. It is a frontier when it is free
    and has an unknown neighbour in the crop.
    """
    out = np.zeros((CHANNELS, cells, cells), np.uint8)
    x, y = (pose_map_robot[:2] - grid.origin_m).tolist()
    numbers, levels = np.empty(cells, np.uint32), np.empty(cells * cells, np.uint8)
    _crop(_kinds(grid), x, y, float(pose_map_robot[2]), 1.0 / grid.resolution_m, cell_m, numbers, levels, out)
    return out


def shared_maps(grids: Sequence[GridMap], signs: Sequence[Array]) -> list[tuple]:
    """What `views` asks of the maps of robots 0, 1, ... and the signs (2, k) on each; once for all that share them."""
    shared, first = [], 0
    for end in range(1, len(grids) + 1):
        grid, places = grids[first], signs[first]
        if end < len(grids) and grids[end].log_odds is grid.log_odds and signs[end] is places:
            continue
        shared.append((first, end, _kinds(grid), grid.origin_m, 1.0 / grid.resolution_m, places))
        first = end
    return shared


def views(
    shared: Sequence[tuple], poses: Array, cells: int, cell_m: float, paths_odom: Array, path_counts: Array,
    mates: Array,
) -> Array:  # fmt: skip
    """`crop_around` of each robot with its last three channels filled too: (robots, 7, cells, cells) uint8.

    shared: of `shared_maps`; poses (robots, 3, 3): in the map frame, its spread, in the odom frame; paths_odom
    (robots, 2, k): rings that hold the latest of `path_counts` places; mates (robots, >= 2, m): where each robot sees
    them, NaN for none. Robots that share a map are served by one compiled call.
    """
    out = np.empty((len(poses), CHANNELS, cells, cells), _BYTE)
    for of_some in shared:
        _crop_and_mark(*of_some, poses, cell_m, paths_odom, path_counts, mates, out)
    return out


def _kinds(grid: GridMap) -> Array:
    return kinds_of(grid.log_odds) if grid.kinds is None else grid.kinds


def shrink(grid: GridMap, cells: int) -> tuple[Array, Array, float]:
    """The known part of a grid as (2, cells, cells) uint8: share of free and of wall cells, north up as in the grid.

    Also the map-frame corner (2,) of its cell [0, 0] and the length of one of its cells [m].
    """
    out = np.zeros((2, cells, cells), np.uint8)
    row, column, factor = _shrink(grid.log_odds, out)
    corner_m = np.asarray(grid.origin_m, float) + np.array([column, row]) * grid.resolution_m
    return out, corner_m, factor * grid.resolution_m


@kernel
def _mark(channel, points, count, x, y, heading, inverse_m, cells):
    """Set the cells of channel (cells, cells) under the first points of (2, k), seen from a pose in their frame.

    Which cells these are is worked out for several points at once, and only then are they set.
    """
    size, flat, xs, ys = channel.shape[0], channel.reshape(-1), points[0], points[1]
    c, s = math.cos(heading) * inverse_m, math.sin(heading) * inverse_m
    middle, end = float(size // 2), float(size)
    ahead0, left0 = middle - c * x - s * y, middle - c * y + s * x
    count = min(count, points.shape[1])
    for k in range(count):
        column, row = ahead0 + c * xs[k] + s * ys[k], left0 + c * ys[k] - s * xs[k]
        is_inside = (column >= 0.0) & (row >= 0.0) & (column < end) & (row < end)
        column, row = (column if is_inside else 0.0), (row if is_inside else 0.0)
        cell = np.int32(row) * np.int32(size) + np.int32(column)
        cells[k] = cell if is_inside else np.int32(-1)
    for k in range(count):
        if cells[k] >= 0:
            flat[np.uint64(cells[k])] = 255


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
def _look_around(kinds, x, y, heading, inverse_m, cell_m, size, numbers, levels):
    """The kinds of cells around a place, robot in the middle and looking along +column: to levels (size * size,)."""
    height, width = kinds.shape
    step = cell_m * inverse_m
    c, s = math.cos(heading) * step, math.sin(heading) * step
    first = 0.5 - size // 2
    x0, y0 = x * inverse_m + first * (c - s) - 0.5, y * inverse_m + first * (s + c) - 0.5
    cells = kinds.reshape(-1)
    dx, dy = int(c * FIXED_POINT), int(s * FIXED_POINT)
    rows, columns = height << FIXED_BITS, width << FIXED_BITS
    for i in range(size):
        k, r = int(math.floor((x0 - s * i) * FIXED_POINT)), int(math.floor((y0 + c * i) * FIXED_POINT))
        out = levels[i * size : (i + 1) * size]
        last_k, last_r = k + dx * (size - 1), r + dy * (size - 1)
        if min(k, last_k) >= 0 and min(r, last_r) >= 0 and max(k, last_k) < columns and max(r, last_r) < rows:
            look_up_row(cells, width, r, k, dy, dx, size, numbers, out)
            continue
        out[:] = UNKNOWN_CELL
        first_k, end_k = span_inside(k, dx, columns, size)
        first_r, end_r = span_inside(r, dy, rows, size)
        begin, end = max(first_k, first_r), min(end_k, end_r)
        if begin < end:
            look_up_row(cells, width, r + begin * dy, k + begin * dx, dy, dx, end - begin, numbers, out[begin:])


@kernel
def _crop(kinds, x, y, heading, inverse_m, cell_m, numbers, levels, out):
    """Egocentric view: out[FREE], WALL, UNKNOWN, FRONTIER (255 or 0).

    Looking up stands apart from comparing, because only the latter gains from being done for many cells at once.
    """
    size = out.shape[1]
    flat, count = out.reshape(-1), size * size
    if kinds.shape[0] == 0:
        flat[: 2 * count] = 0
        flat[2 * count : 3 * count] = 255
        flat[3 * count : 4 * count] = 0
        return
    _look_around(kinds, x, y, heading, inverse_m, cell_m, size, numbers, levels)
    free, wall, unknown = flat[:count], flat[count : 2 * count], flat[2 * count : 3 * count]
    for j in range(count):
        free[j] = np.uint8(255) if levels[j] == FREE_CELL else np.uint8(0)
        wall[j] = np.uint8(255) if levels[j] == WALL_CELL else np.uint8(0)
        unknown[j] = np.uint8(255) if levels[j] == UNKNOWN_CELL else np.uint8(0)
    out[FRONTIER, 0] = 0
    out[FRONTIER, size - 1] = 0
    frontier, here = flat[3 * count + size : 4 * count - size], free[size:]
    below, above, left, right = unknown, unknown[2 * size :], unknown[size - 1 :], unknown[size + 1 :]
    for j in range(count - 2 * size):
        frontier[j] = here[j] & (below[j] | above[j] | left[j] | right[j])
    for i in range(1, size - 1):  # neighbours of the first and last column lie in other rows
        out[FRONTIER, i, 0] = out[FRONTIER, i, size - 1] = 0


@kernel
def _crop_and_mark(first, end, kinds, origin, inverse_grid_m, signs, poses, cell_m, paths, path_counts, mates, out):
    """All channels of the robots from `first` to before `end`: what lies around each, its path, mates and signs."""
    inverse_m = 1.0 / cell_m
    numbers, levels = np.empty(out.shape[3], np.uint32), np.empty(out.shape[2] * out.shape[3], np.uint8)
    cells = np.empty(max(paths.shape[2], mates.shape[2], signs.shape[1]), np.int32)
    for i in range(first, end):
        here, odom = poses[i, 0], poses[i, 2]
        _crop(kinds, here[0] - origin[0], here[1] - origin[1], here[2], inverse_grid_m, cell_m, numbers, levels, out[i])
        out[i, 4:] = 0
        _mark(out[i, 4], paths[i], path_counts[i], odom[0], odom[1], odom[2], inverse_m, cells)
        _mark(out[i, 5], mates[i], mates.shape[2], 0.0, 0.0, 0.0, inverse_m, cells)
        _mark(out[i, 6], signs, signs.shape[1], here[0], here[1], here[2], inverse_m, cells)
