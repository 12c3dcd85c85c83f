"""Metrics of merged maps: correctly mapped area, coverage and IoU."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from numpy.typing import NDArray as Array

from twc_env.errors import DataError
from twc_env.kernels.cell_rows import FIXED_BITS, FIXED_POINT, look_up_row, span_inside
from twc_env.kernels.compiled import borrowing_kernel, kernel
from twc_env.records.messages import BLOCK_SHAPE

REACH_CELLS = 1e9
"""Largest distance of map and building in cells; beyond it, steps in fixed point would overflow."""

BLOCK_ROWS, BLOCK_COLUMNS = BLOCK_SHAPE


@dataclass(frozen=True, slots=True)
class MapScore:
    """A map compared with the building, cell by cell."""

    correct_area_m2: float
    """Free floor that the map shows as free."""
    believed_area_m2: float
    """Area that the map shows as free, correctly or not."""
    coverage_correct: float
    """Share of the building's explorable floor that the map shows as free."""
    map_iou: float
    """Intersection over union of the map's free area and the explorable floor."""
    wall_iou: float
    """Intersection over union of walls, with a tolerance of one cell."""
    wall_precision: float
    """Share of the map's wall cells with a true wall within one cell."""


def correct_area_m2(
    log_odds: Array, origin_m: Array, resolution_m: float, pose_building_map: Array, truth_free: Array,
    truth_origin_m: Array, truth_resolution_m: float, box: tuple[int, int, int, int] | None = None,
) -> float:  # fmt: skip
    """Area of the explorable floor (truth_free) that the map shows as free; arguments as in `score_map`.

    box: first row and column, end row and column of the cells to evaluate; None: all.
    """
    log_odds, truth_free = validated_grid(log_odds, "log_odds"), validated_grid(truth_free, "truth_free")
    row, column, step = _sampling(pose_building_map, origin_m, resolution_m, truth_origin_m, truth_resolution_m)
    box = box or (0, 0, *log_odds.shape)
    return (
        float(_count_free(np.ascontiguousarray(log_odds), box, row, column, step, truth_free)) * truth_resolution_m**2
    )


def floor_mask(
    shape: tuple[int, int], origin_m: Array, resolution_m: float, pose_building_map: Array, truth_free: Array,
    truth_origin_m: Array, truth_resolution_m: float,
) -> Array:  # fmt: skip
    """(h, w) bool: cells of a map of that shape whose centres lie on explorable floor; arguments as in `score_map`."""
    truth_free = validated_grid(truth_free, "truth_free")
    row, column, step = _sampling_back(pose_building_map, origin_m, resolution_m, truth_origin_m, truth_resolution_m)
    mask = np.zeros(shape, bool)
    _look_up_floor(np.ascontiguousarray(truth_free), row, column, step, mask)
    return mask


def score_map(
    log_odds: Array, origin_m: Array, resolution_m: float, pose_building_map: Array, truth_free: Array,
    truth_wall: Array, truth_origin_m: Array, truth_resolution_m: float,
) -> MapScore:  # fmt: skip
    """Compare a merged map with the building.

    log_odds (h, w) int16 with its lower left corner at origin_m in the map frame; a cell is free below 0 and wall
    above. pose_building_map (3,) places the map frame in the building. truth_free and truth_wall (H, W) bool with their
    corner at truth_origin_m in the building frame.

    The centre of each true cell is looked up in the map. Only true walls that border explorable floor are scored: with
    r the share of them that the map shows within one cell, and p the share of the map's wall cells with a true wall
    within one cell, wall_iou = p r / (p + r - p r), which equals the IoU if both match exactly.

    Raises DataError for invalid grids and poses.
    """
    log_odds = validated_grid(log_odds, "log_odds")
    truth_free, truth_wall = validated_grid(truth_free, "truth_free"), validated_grid(truth_wall, "truth_wall")
    if truth_free.shape != truth_wall.shape:
        raise DataError(f"truth_free {truth_free.shape} and truth_wall {truth_wall.shape} must have one shape")
    if not log_odds.size:
        return MapScore(0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    places = pose_building_map, origin_m, resolution_m, truth_origin_m, truth_resolution_m
    correct_m2 = correct_area_m2(
        log_odds, origin_m, resolution_m, pose_building_map, truth_free, truth_origin_m, truth_resolution_m
    )
    floor_m2 = float(np.count_nonzero(truth_free)) * truth_resolution_m**2
    believed_m2 = float(np.count_nonzero(log_odds < 0)) * resolution_m**2
    union_m2 = floor_m2 + max(believed_m2, correct_m2) - correct_m2
    map_wall = log_odds > 0
    recall = _share(*_count_met(np.flatnonzero(truth_wall), truth_free, *_sampling(*places), map_wall))
    precision = _share(*_count_met(np.flatnonzero(map_wall), map_wall, *_sampling_back(*places), truth_wall))
    return MapScore(
        correct_area_m2=correct_m2,
        believed_area_m2=believed_m2,
        coverage_correct=_share(correct_m2, floor_m2),
        map_iou=_share(correct_m2, union_m2),
        wall_iou=_share(precision * recall, precision + recall - precision * recall),
        wall_precision=precision,
    )


def _share(part: float, whole: float) -> float:
    return float(part / whole) if whole > 0 else 0.0


def validated_grid(values: ArrayLike, name: str) -> Array:
    """The values as an array (h, w). Raises DataError for rows of unlike length, or another number of axes."""
    try:
        grid = np.asarray(values)
    except Exception as error:  # an object of another library may raise any
        raise DataError(f"{name} must be a grid (rows, columns): {error}") from None
    if grid.ndim != 2:
        raise DataError(f"{name} must be a grid (rows, columns); got shape {grid.shape}")
    return grid


def _near(row: float, column: float) -> tuple[float, float]:
    """The arguments. Raises DataError for cells too far away or not finite."""
    if not (abs(row) < REACH_CELLS and abs(column) < REACH_CELLS):
        raise DataError(f"map and building must lie in one place; theirs are ({row:g}, {column:g}) cells apart")
    return row, column


def _placed(pose_building_map, *resolutions_m: float) -> tuple[float, float, float]:
    """The pose as numbers. Raises DataError for an invalid pose or cell size."""
    pose = np.asarray(pose_building_map, float)
    if pose.shape != (3,) or not min(resolutions_m) > 0.0:
        raise DataError(
            f"a map needs a pose (3,) and cells of a size above 0; got shape {pose.shape} and {resolutions_m}"
        )
    x, y, heading = pose.tolist()
    return x, y, heading


def _sampling(pose_building_map: Array, origin_m, resolution_m, truth_origin_m, truth_resolution_m):
    """Map cell (row, column, as reals) of the centre of true cell [0, 0], and (cos, sin) of one true cell's step."""
    for name, corner_m in (("origin_m", origin_m), ("truth_origin_m", truth_origin_m)):
        if np.shape(corner_m) != (2,):
            raise DataError(f"{name} must be a corner (x [m], y [m]); got {corner_m!r}")
    x, y, heading = _placed(pose_building_map, resolution_m, truth_resolution_m)
    c, s = math.cos(heading), math.sin(heading)
    dx = truth_origin_m[0] + 0.5 * truth_resolution_m - x
    dy = truth_origin_m[1] + 0.5 * truth_resolution_m - y
    row = (-s * dx + c * dy - origin_m[1]) / resolution_m
    column = (c * dx + s * dy - origin_m[0]) / resolution_m
    scale = truth_resolution_m / resolution_m
    return *_near(float(row), float(column)), (c * scale, -s * scale)


def _sampling_back(pose_building_map: Array, origin_m, resolution_m, truth_origin_m, truth_resolution_m):
    """As `_sampling`, for the centres of map cells in the true grid."""
    x, y, heading = _placed(pose_building_map, resolution_m, truth_resolution_m)
    c, s = math.cos(heading), math.sin(heading)
    px, py = origin_m[0] + 0.5 * resolution_m, origin_m[1] + 0.5 * resolution_m
    row = (y + s * px + c * py - truth_origin_m[1]) / truth_resolution_m
    column = (x + c * px - s * py - truth_origin_m[0]) / truth_resolution_m
    scale = resolution_m / truth_resolution_m
    return *_near(float(row), float(column)), (c * scale, s * scale)


@kernel
def _count_free(log_odds, box, row0, column0, step, truth_free):
    """Number of true free cells whose centre lies in a free cell of a box of the map; steps in fixed point."""
    columns = log_odds.shape[1]
    bottom, left, rows_above, columns_right = box[0], box[1], box[2] - box[0], box[3] - box[1]
    width = truth_free.shape[1]
    cells, levels = log_odds.reshape(-1), np.empty(width, log_odds.dtype)
    numbers, below = np.empty(width, np.uint32), levels.dtype.type(0)
    c, s = step[0], step[1]
    dk, dr = int(np.rint(c * FIXED_POINT)), int(np.rint(s * FIXED_POINT))
    count = 0
    for i in range(truth_free.shape[0]):
        r = int(np.floor((row0 - bottom + c * i) * FIXED_POINT))
        k = int(np.floor((column0 - left - s * i) * FIXED_POINT))
        first_r, last_r = span_inside(r, dr, rows_above << FIXED_BITS, width)
        first_k, last_k = span_inside(k, dk, columns_right << FIXED_BITS, width)
        first, last = max(first_r, first_k), min(last_r, last_k)
        if first >= last:
            continue
        row, column = r + first * dr + (bottom << FIXED_BITS), k + first * dk + (left << FIXED_BITS)
        look_up_row(cells, columns, row, column, dr, dk, last - first, numbers, levels)
        free = truth_free[i, first:last]
        for j in range(last - first):  # separate from the look-ups, so that it is vectorised
            count += free[j] & (levels[j] < below)
    return count


@kernel
def _look_up_floor(truth_free, row0, column0, step, mask):
    """Write to the mask whether the true cell at the centre of each map cell is free."""
    rows, columns = truth_free.shape
    height, width = mask.shape
    cells, numbers = truth_free.reshape(-1), np.empty(width, np.uint32)
    c, s = step[0], step[1]
    dk, dr = int(np.rint(c * FIXED_POINT)), int(np.rint(s * FIXED_POINT))
    for i in range(height):
        r, k = int(np.floor((row0 + c * i) * FIXED_POINT)), int(np.floor((column0 - s * i) * FIXED_POINT))
        first_r, last_r = span_inside(r, dr, rows << FIXED_BITS, width)
        first_k, last_k = span_inside(k, dk, columns << FIXED_BITS, width)
        first, last = max(first_r, first_k), min(last_r, last_k)
        if first < last:
            row, column = r + first * dr, k + first * dk
            look_up_row(cells, columns, row, column, dr, dk, last - first, numbers, mask[i, first:last])


@borrowing_kernel
def recount_free(log_odds, mask, touched, known, counts):
    """Number of free cells of a map (h, w) under a mask (h, w); only blocks modified since the last call are recounted.

    touched, known, counts (blocks, blocks): `GridMap.touched`, its values at the last call, and the counts then.
    """
    total = 0
    for a in range(touched.shape[0]):
        for b in range(touched.shape[1]):
            if touched[a, b] != known[a, b]:
                first, end = BLOCK_COLUMNS * b, min(BLOCK_COLUMNS * (b + 1), mask.shape[1])
                known[a, b], count = touched[a, b], 0
                for row in range(BLOCK_ROWS * a, min(BLOCK_ROWS * (a + 1), mask.shape[0])):
                    count += _count_row(log_odds[row, first:end], mask[row, first:end])
                counts[a, b] = count
            total += counts[a, b]
    return total


@borrowing_kernel
def _count_row(levels, mask):
    """Number of free cells under the mask, in a row short enough for 16 bits."""
    count = np.int16(0)  # as wide as the levels, for the widest vectors
    for j in range(levels.shape[0]):
        count = np.int16(count + np.int16((levels[j] < np.int16(0)) & mask[j]))
    return np.int64(count)


@kernel
def _count_met(walls, beside, row0, column0, step, others):
    """(met, all) wall cells that border cells of `beside`; met: with a cell of `others` at most one cell away.

    walls (k,): flat indices in a grid of the shape of `beside`.
    """
    c, s = step[0], step[1]
    met, count = 0, 0
    for number in walls:
        i, j = number // beside.shape[1], number % beside.shape[1]
        if _is_beside(beside, i, j):
            count += 1
            r, k = int(np.floor(row0 + c * i + s * j)), int(np.floor(column0 - s * i + c * j))
            met += _is_beside(others, r, k)
    return met, count


@kernel
def _is_beside(cells, row, column):
    """Whether this cell or one of its neighbours is true; cells outside are false."""
    found = False
    for a in range(max(row - 1, 0), min(row + 2, cells.shape[0])):
        for b in range(max(column - 1, 0), min(column + 2, cells.shape[1])):
            found = found or cells[a, b]
    return found
