"""Scan matching without an initial guess: correlative, by branch and bound over all headings (Olson 2009,
Hess 2016).

The target's points become a grid of scores. The source's points are rotated to each heading and shifted by whole cells.
A box of shifts is bounded from above with a coarser grid, in which each cell holds the maximum of a square of cells
whose side doubles from level to level. The search finds the best pose of the lattice and evaluates few of them.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.errors import DataError
from twc_env.kernels.compiled import kernel
from twc_env.records.array_validation import validated_points

CELL_M = 0.1
BLUR_M = 0.3
"""The score of a cell falls linearly from `FULL` at a target point to 0 at this distance."""
FULL = 255
BLUR_CELLS = int(BLUR_M / CELL_M)
AROUND = np.hypot(*np.mgrid[-BLUR_CELLS : BLUR_CELLS + 1, -BLUR_CELLS : BLUR_CELLS + 1]) * CELL_M
SCORES_AROUND = np.round(FULL * np.maximum(1.0 - AROUND / BLUR_M, 0.0)).astype(np.uint8)
"""Scores of the cells around a point."""
LEVELS = 5
"""Levels of the score grid; the largest box of shifts has 2^(LEVELS - 1) cells a side."""
POINTS_MAX = 160
"""Largest number of source points that are compared, evenly spread."""

POINTS_AT_ONCE = 16
"""After this many points the sum stops early if the rest cannot exceed the best score."""

WINDOW_MAX_M = 1000.0
REACH_MAX_M = 500.0
"""A score grid that extends this far to all sides takes 500 MB."""

WALL_STEP_M, WALL_RAD, SQUARE_SHARE_MIN = 0.5, 0.06, 0.5
"""Largest distance of neighbouring points on one wall; tolerance of the wall directions, which are defined modulo 90
degrees; and how dominant these directions must be (1: all walls are orthogonal, 0: no preference)."""


@dataclass(frozen=True, slots=True, eq=False)
class GlobalMatch:
    """The best pose of the lattice."""

    pose: Array
    """(3,) of the source in the target's frame; accurate to about one cell, to be refined."""
    score: float
    """Mean score of the points, in [0, 1]."""
    evaluated: int
    """Number of boxes and poses evaluated."""


def match_globally(
    target_points: Array,
    source_points: Array,
    window_m: float,
    score_min: float = 0.4,
    turn_rad: float | None = None,
    places: Array | None = None,
) -> GlobalMatch | None:
    """Pose of the source points (n, 2) in the frame of the target points (m, 2) with the highest score.

    Searches all headings, and all shifts of up to `window_m`, rounded to whole cells, along x and y; with a window of 0
    it only rotates. turn_rad: as of `turn_along_walls`: only headings near it, modulo 90 degrees. places: shifts to
    search alone, of `possible_places`. None if no pose reaches `score_min`. Raises DataError for invalid points or
    settings.
    """
    target_points, source_points = validated_points(target_points), validated_points(source_points)
    for points in (target_points, source_points):
        if np.abs(points).max(initial=0.0) > REACH_MAX_M:
            raise DataError(
                f"points must lie within {REACH_MAX_M:g} m of their own origin, the scanner; got one at "
                f"{np.abs(points).max():g} m: move them there, or check their unit"
            )
    if not 0.0 <= window_m <= WINDOW_MAX_M:
        raise DataError(f"window_m must lie in [0, {WINDOW_MAX_M:g}]; got {window_m!r}")
    if not score_min >= 0.0:
        raise DataError(f"score_min must be 0 or more; got {score_min!r}")
    if len(target_points) == 0 or len(source_points) == 0:
        return None
    fields, origin_m = score_fields(target_points)
    chosen = subsampled(source_points)
    headings = lattice_headings(chosen)
    if turn_rad is not None:
        headings = headings[np.abs(_modulo_quarter(headings - turn_rad)) <= WALL_RAD]
    reach = int(round(window_m / CELL_M))
    best = np.zeros(3, np.int64)
    least = int(score_min * FULL * len(chosen))
    if places is None:
        places = np.zeros((0, 0, 0), np.uint8)
    score, evaluated = _branch_and_bound(fields, chosen, headings, origin_m, reach, least, places, best)
    if score < 0:
        return None
    pose = np.array([best[1] * CELL_M, best[2] * CELL_M, headings[best[0]]])
    return GlobalMatch(pose, score / (FULL * len(chosen)), int(evaluated))


def possible_places(is_possible: Callable[[Array], Array], window_m: float) -> Array:
    """(LEVELS, k, k) uint8 for `match_globally`: whether any of the 2^l x 2^l shifts from (row, column) on is possible.

    is_possible: for shifts (..., 2) [m], x and y, whether the source's origin may be there.
    """
    reach = int(round(window_m / CELL_M))
    shifts_m = CELL_M * np.arange(-reach, reach + 1)
    places = np.zeros((LEVELS, len(shifts_m), len(shifts_m)), np.uint8)
    for row, y_m in zip(places[0], shifts_m.tolist(), strict=True):  # all at once take 13 times the memory
        row[:] = is_possible(np.column_stack([shifts_m, np.full(len(shifts_m), y_m)]))
    _widen(places)
    return places


def subsampled(points: Array, count_max: int = POINTS_MAX) -> Array:
    """At most this many points, evenly spread over their order."""
    if len(points) <= count_max:
        return points
    return points[np.linspace(0, len(points) - 1, count_max).astype(np.int64)]


def lattice_headings(points: Array) -> Array:
    """(k,) headings over the full circle, so close that points at the RMS range move by one cell between neighbours."""
    reach_m = max(float(np.sqrt(np.mean(np.sum(points**2, axis=1)))), 10 * CELL_M)
    count = math.ceil(2 * math.pi * reach_m / CELL_M)
    return (np.arange(count) - count // 2) * (2 * math.pi / count)


def walls_run(points: Array) -> tuple[float, float]:
    """Direction of walls modulo 90 degrees [rad], and how dominant it is [0, 1]; points (n, 2) in order of beams."""
    direction_rad, share = _walls_run(np.ascontiguousarray(points, float), WALL_STEP_M)
    return direction_rad, share


def turn_along_walls(
    target: tuple[float, float], source: tuple[float, float], share_min: float = SQUARE_SHARE_MIN
) -> float | None:
    """Turn of the source that lays its walls along those of the target, modulo 90 degrees; both as of `walls_run`.

    None if one of the two has no dominant directions.
    """
    return None if min(target[1], source[1]) < share_min else float(_modulo_quarter(target[0] - source[0]))


def _modulo_quarter(angles_rad: Array | float) -> Array | float:
    return (angles_rad + math.pi / 4) % (math.pi / 2) - math.pi / 4


@kernel
def _walls_run(points, step_max):
    """Dominant direction modulo 90 degrees of the segments between successive points, and how dominant it is [0, 1]."""
    across = along = total = 0.0
    for k in range(points.shape[0] - 1):
        dx, dy = points[k + 1, 0] - points[k, 0], points[k + 1, 1] - points[k, 1]
        squared = dx * dx + dy * dy
        if 0.0 < squared < step_max * step_max:
            angle = 4.0 * math.atan2(dy, dx)
            along += squared * math.cos(angle)
            across += squared * math.sin(angle)
            total += squared
    return math.atan2(across, along) / 4.0, math.hypot(along, across) / max(total, 1e-9)


def score_fields(points: Array) -> tuple[Array, Array]:
    """(LEVELS, rows, columns) uint8 scores and the corner (2,) [m]; cells of level l hold the maximum of 2^l x 2^l."""
    margin = 2 ** (LEVELS - 1) + BLUR_CELLS + 1
    origin_m = np.floor(points.min(axis=0) / CELL_M) * CELL_M - margin * CELL_M
    columns, rows = (np.floor((points.max(axis=0) - origin_m) / CELL_M).astype(np.int64) + 1 + margin).tolist()
    fields = np.zeros((LEVELS, rows, columns), np.uint8)
    _stamp(fields[0], points, origin_m)
    _widen(fields)
    return fields, origin_m


@kernel
def _stamp(field, points, origin):
    """Write the scores of the cells around the points."""
    rows, columns = field.shape
    reach = BLUR_CELLS
    for k in range(points.shape[0]):
        column = int(math.floor((points[k, 0] - origin[0]) / CELL_M))
        row = int(math.floor((points[k, 1] - origin[1]) / CELL_M))
        if row < 0 or column < 0 or row >= rows or column >= columns or field[row, column] == FULL:
            continue
        for r in range(max(row - reach, 0), min(row + reach + 1, rows)):
            for c in range(max(column - reach, 0), min(column + reach + 1, columns)):
                field[r, c] = max(field[r, c], SCORES_AROUND[r - row + reach, c - column + reach])


@kernel
def _widen(fields):
    """Compute the levels above the first."""
    levels, rows, columns = fields.shape
    for level in range(1, levels):
        step = 1 << (level - 1)
        below, here = fields[level - 1], fields[level]
        for r in range(rows):
            other = min(r + step, rows - 1)
            for c in range(columns):
                here[r, c] = max(below[r, c], below[other, c])
        for r in range(rows):
            for c in range(columns - step):
                here[r, c] = max(here[r, c], here[r, c + step])


@kernel
def _sum(field, cells, row, column, held):
    """Total score of the cells (n, 2) shifted by (row, column); stops early once it cannot exceed `held`."""
    rows, columns = field.shape
    total, rest = 0, FULL * cells.shape[0]
    for first in range(0, cells.shape[0], POINTS_AT_ONCE):
        end = min(first + POINTS_AT_ONCE, cells.shape[0])
        for k in range(first, end):
            r, c = cells[k, 0] + row, cells[k, 1] + column
            if 0 <= r < rows and 0 <= c < columns:
                total += field[r, c]
        rest -= FULL * (end - first)
        if total + rest <= held:
            return total
    return total


@kernel
def _turn(points, heading, origin, cells):
    """Write the cells (n, 2) of the points rotated to a heading, without shift."""
    cosine, sine = math.cos(heading), math.sin(heading)
    for k in range(points.shape[0]):
        x = cosine * points[k, 0] - sine * points[k, 1] - origin[0]
        y = sine * points[k, 0] + cosine * points[k, 1] - origin[1]
        cells[k, 0], cells[k, 1] = int(math.floor(y / CELL_M)), int(math.floor(x / CELL_M))


@kernel
def _branch_and_bound(fields, points, headings, origin, reach, score_min, places, best):
    """Best score over all headings and shifts -reach..reach (-1 if below score_min), and the number of evaluations.

    Writes the heading's index and the shift (columns, rows) to `best`. Depth first, boxes with the highest bound
    first; a box whose bound does not exceed the best score is pruned, and one in which no place is possible.
    """
    levels, is_limited = fields.shape[0], len(places) > 0
    top = levels - 1
    side = 1 << top
    boxes = (2 * reach + side) // side
    turned = np.empty((len(headings), len(points), 2), np.int32)
    bounds = np.empty(len(headings) * boxes * boxes, np.int64)
    held, evaluated = score_min - 1, 0
    for a in range(len(headings)):
        _turn(points, headings[a], origin, turned[a])
        for i in range(boxes):
            for j in range(boxes):
                k = (a * boxes + i) * boxes + j
                if is_limited and not places[top, i * side, j * side]:
                    bounds[k] = -1
                    continue
                bounds[k] = _sum(fields[top], turned[a], i * side - reach, j * side - reach, held)
                evaluated += 1
    is_found = False
    stack = np.empty((4 * levels, 4), np.int64)  # level, row shift, column shift, bound
    promising = np.flatnonzero(bounds > held)
    for k in promising[np.argsort(-bounds[promising], kind="mergesort")]:
        if bounds[k] <= held:
            break
        a = k // (boxes * boxes)
        stack[0, 0], stack[0, 3] = top, bounds[k]
        stack[0, 1], stack[0, 2] = (k // boxes % boxes) * side - reach, (k % boxes) * side - reach
        depth = 1
        while depth > 0:
            depth -= 1
            level, row, column, bound = stack[depth, 0], stack[depth, 1], stack[depth, 2], stack[depth, 3]
            if bound <= held:
                continue
            if level == 0:
                held, is_found = bound, True
                best[0], best[1], best[2] = a, column, row
                continue
            half = 1 << (level - 1)
            begin = depth
            for r in range(2):
                for c in range(2):
                    low_row, low_column = row + r * half, column + c * half
                    if low_row > reach or low_column > reach:
                        continue
                    if is_limited and not places[level - 1, low_row + reach, low_column + reach]:
                        continue
                    value = _sum(fields[level - 1], turned[a], low_row, low_column, held)
                    evaluated += 1
                    if value <= held:
                        continue
                    at = depth  # insertion sort: the best of the four on top of the stack
                    while at > begin and stack[at - 1, 3] > value:
                        stack[at] = stack[at - 1]
                        at -= 1
                    stack[at, 0], stack[at, 1], stack[at, 2], stack[at, 3] = level - 1, low_row, low_column, value
                    depth += 1
    return (held if is_found else -1), evaluated
