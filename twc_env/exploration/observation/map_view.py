"""Images of estimated maps for learning agents: an egocentric crop, and the whole map downscaled."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.kernels.cell_rows import FIXED_BITS, FIXED_POINT, look_up, look_up_row, number_square, span_inside
from twc_env.kernels.compiled import BindsAnew, Lent, borrowing_kernel, bound, kernel, parts_of
from twc_env.records.messages import GridMap
from twc_env.records.team_messages import read_only
from twc_env.slam.scans.cell_kinds import FREE as FREE_CELL
from twc_env.slam.scans.cell_kinds import UNKNOWN as UNKNOWN_CELL
from twc_env.slam.scans.cell_kinds import WALL as WALL_CELL
from twc_env.slam.scans.cell_kinds import kinds_of

FREE, WALL, UNKNOWN, FRONTIER, PATH, TEAMMATES, SIGNS = range(7)
CHANNELS = 7
_BYTE = np.dtype(np.uint8)
OUTSIDE = np.uint32(2**32 - 1)
"""Instead of a pixel's index: the point lies outside the image."""
OVERVIEW_CHANNELS = 4
"""Free, wall, this robot, teammates."""


def crop_around(grid: GridMap, pose_map_robot: Array, cells: int, cell_m: float) -> Array:
    """(7, cells, cells) uint8, 0 or 255: the map around a robot, which faces +column; the last three channels stay 0.

    A pixel shows the kind (`note_kinds`) of the 2 x 2 map cells around its centre. It is a frontier if it is free and
    one of its four neighbours in the crop is unknown; never at the border of the crop.
    """
    out = np.zeros((CHANNELS, cells, cells), np.uint8)
    x, y = (pose_map_robot[:2] - grid.origin_m).tolist()
    _crop(_kinds(grid), x, y, float(pose_map_robot[2]), 1.0 / grid.resolution_m, cell_m, _make_room(cells), out)
    return out


class BelievedMaps(NamedTuple):
    """The maps of robots 0, 1, ... as `MapViews` reads them; robots may share a map."""

    kinds: tuple[Array, ...]
    """Per robot (rows, columns) uint8 kinds of the cells of its map, see `cell_kinds`."""
    places: Array
    """(robots, 3) x and y of its lower left corner [m], and cells per metre."""
    signs: tuple[Array, ...]
    """Per robot (2, k) positions of signs [m] in its map frame."""

    @classmethod
    def of(cls, grids: Sequence[GridMap], signs: Sequence[Array]) -> BelievedMaps:
        """From the grid of each robot, and the signs (2, k) on it."""
        places = [(*grid.origin_m.tolist(), 1.0 / grid.resolution_m) for grid in grids]
        return cls(tuple(map(_kinds, grids)), np.array(places), tuple(signs))


class MapViews(BindsAnew):
    """Draws the egocentric map image of each robot, with its path, teammates and signs."""

    def __init__(self, cells: int, cell_m: float, paths_odom: Array, path_counts: Array, teammates: Array):
        """These arrays are read at each `draw`: paths_odom (robots, >= 2, k) ring buffers with the latest of
        `path_counts` (robots,) positions in the odom frame; teammates (robots, >= 2, m) positions in the robot frame.
        NaN for none.
        """
        self._shape = len(paths_odom), CHANNELS, cells, cells
        self._kept = paths_odom, path_counts, teammates, float(cell_m)
        self._run: Callable[..., None] | None = None
        """`_crop_and_mark` bound to these and to scratch arrays."""

    def draw(self, maps: BelievedMaps, poses: Array) -> Array:
        """(robots, 7, cells, cells) uint8: `crop_around` of each robot, and its path, teammates and signs.

        poses (robots, 3, 3): pose in the map frame, its standard deviation, pose in the odom frame.
        """
        out = np.empty(self._shape, _BYTE)
        if self._run is None:
            kept = Lent(self._kept + _make_room(self._shape[-1]))
            self._run = bound(_crop_and_mark, kept, *maps, poses, out)
        self._run(*maps, poses, out)
        return out


def _make_room(size: int) -> tuple[Array, ...]:
    """Scratch arrays of `_look_around` and `_mark`."""
    count = size * size
    shapes = (count, np.uint8), ((2, size), np.int64), ((6, size), np.uint32), (count, np.uint32)
    return tuple([np.empty(shape, kind) for shape, kind in shapes])


def _kinds(grid: GridMap) -> Array:
    return read_only(kinds_of(grid.log_odds) if grid.kinds is None else grid.kinds)


def shrink(grid: GridMap, cells: int) -> tuple[Array, Array, float]:
    """The known part of a grid, downscaled to (2, cells, cells) uint8; row 0 is the lowest y.

    Channels, as a share of 255: free cells per area; wall cells per side length of a pixel, at most 1.
    Also returns the map-frame corner (2,) of pixel [0, 0] and the side length of a pixel [m].
    """
    out = np.zeros((2, cells, cells), np.uint8)
    row, column, factor = _shrink(grid.log_odds, out)
    corner_m = np.asarray(grid.origin_m, float) + np.array([column, row]) * grid.resolution_m
    return out, corner_m, factor * grid.resolution_m


@borrowing_kernel
def _mark(channel, points, count, x, y, heading, inverse_m, numbers):
    """Set the pixels of channel (cells, cells) at the first `count` points of (2, k), seen from a pose in their frame.

    numbers: scratch. Pixel indices are computed for a batch of its length, which is vectorised, before any pixel is
    set.
    """
    size, flat = channel.shape[0], channel.reshape(-1)
    c, s = math.cos(heading) * inverse_m, math.sin(heading) * inverse_m
    middle, end = float(size // 2), float(size)
    ahead0, left0 = middle - c * x - s * y, middle - c * y + s * x
    for first in range(0, min(count, points.shape[1]), numbers.shape[0]):
        last = min(first + numbers.shape[0], count, points.shape[1])
        xs, ys = points[0, first:last], points[1, first:last]
        for k in range(xs.shape[0]):
            column, row = ahead0 + c * xs[k] + s * ys[k], left0 + c * ys[k] - s * xs[k]
            is_inside = (column >= 0.0) & (row >= 0.0) & (column < end) & (row < end)
            column, row = (column if is_inside else 0.0), (row if is_inside else 0.0)
            number = np.uint32(np.int32(row) * np.int32(size) + np.int32(column))
            numbers[k] = number if is_inside else OUTSIDE
        for k in range(xs.shape[0]):
            if numbers[k] != OUTSIDE:
                flat[np.uint64(numbers[k])] = 255


@kernel
def _shrink(log_odds, out):
    """Fill `out`, see `shrink`; returns first row and column of the known cells' box, and grid cells per pixel."""
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


@borrowing_kernel
def _look_around(kinds, x, y, heading, inverse_m, cell_m, size, room):
    """Write to room[0] the kinds of the cells around a pose, which is in the middle and faces +column.

    x, y: from the grid's lower left corner [m]; inverse_m: cells per metre; cell_m: size of a pixel.
    """
    levels, firsts, scratch, numbers = room
    height, width = kinds.shape
    step = cell_m * inverse_m
    c, s = math.cos(heading) * step, math.sin(heading) * step
    first = 0.5 - size // 2
    x0, y0 = x * inverse_m + first * (c - s) - 0.5, y * inverse_m + first * (s + c) - 0.5
    cells = kinds.reshape(-1)
    dx, dy = int(c * FIXED_POINT), int(s * FIXED_POINT)
    rows, columns = height << FIXED_BITS, width << FIXED_BITS
    for i in range(size):
        firsts[0, i] = int(math.floor((y0 + c * i) * FIXED_POINT))
        firsts[1, i] = int(math.floor((x0 - s * i) * FIXED_POINT))
    is_inside = True
    for i in (0, size - 1):
        for j in (0, size - 1):
            is_inside &= 0 <= firsts[1, i] + j * dx < columns and 0 <= firsts[0, i] + j * dy < rows
    if is_inside:
        number_square(width, firsts, dy, dx, scratch, numbers)
        look_up(cells, numbers, size * size, levels)
        return
    levels[:] = UNKNOWN_CELL
    for i in range(size):
        r, k = firsts[0, i], firsts[1, i]
        first_k, end_k = span_inside(k, dx, columns, size)
        first_r, end_r = span_inside(r, dy, rows, size)
        begin, end = max(first_k, first_r), min(end_k, end_r)
        if begin < end:
            out = levels[i * size + begin : i * size + end]
            look_up_row(cells, width, r + begin * dy, k + begin * dx, dy, dx, end - begin, numbers, out)


@borrowing_kernel
def _crop(kinds, x, y, heading, inverse_m, cell_m, room, out):
    """Fill the channels FREE, WALL, UNKNOWN and FRONTIER of out with 0 or 255, the others with 0.

    Look-ups and comparisons are separate loops, because only the latter can be vectorised.
    """
    size = out.shape[1]
    flat, count = out.reshape(-1), size * size
    if kinds.shape[0] == 0:
        flat[: 2 * count] = 0
        flat[2 * count : 3 * count] = 255
        flat[3 * count :] = 0
        return
    _look_around(kinds, x, y, heading, inverse_m, cell_m, size, room)
    flat[4 * count :] = 0
    levels = room[0]
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


@borrowing_kernel
def _crop_and_mark(kept, kinds, places, signs, poses, out):
    """Fill all channels of all robots: map, path, teammates and signs."""
    paths, path_counts, teammates, cell_m, levels, firsts, scratch, numbers = parts_of(kept)
    inverse_m, room = 1.0 / cell_m, (levels, firsts, scratch, numbers)
    for i in range(len(kinds)):
        here, odom, place = poses[i, 0], poses[i, 2], places[i]
        _crop(kinds[i], here[0] - place[0], here[1] - place[1], here[2], place[2], cell_m, room, out[i])
        _mark(out[i, 4], paths[i], path_counts[i], odom[0], odom[1], odom[2], inverse_m, numbers)
        _mark(out[i, 5], teammates[i], teammates.shape[2], 0.0, 0.0, 0.0, inverse_m, numbers)
        _mark(out[i, 6], signs[i], signs[i].shape[1], here[0], here[1], here[2], inverse_m, numbers)
