"""Metrics of maps from signal strength (papers.md K1, K2, K17-K19): walls crossed, free and wall IoU, calibration.

Maps hold 255 for free, 0 for wall and 127 for unknown cells; truth and estimate are on the same grid.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.kernels.compiled import kernel
from twc_env.metrics.mapping import score_map

FREE, UNKNOWN, WALL = 255, 127, 0
CORNER_CELLS = 1e-9
"""A line this near to the corner of a cell passes through it."""


@dataclass(frozen=True, slots=True)
class StructureScore:
    """An estimated map of walls compared with the truth."""

    iou_free: float
    """Eq. 11, over cells known in both; it ignores cells that the estimate leaves unknown, so see `coverage` too."""
    iou_wall: float
    """IoU of walls within one cell, over all cells (`score_map`)."""
    coverage: float
    """Share of the cells of known truth that the estimate knows."""
    mse: float
    """Eq. 14 with maps scaled to 0..1; times 65025 for grey values."""
    brier: float
    """Mean squared error of the wall probability, over cells known in both."""


def truth_map(free: Array, wall: Array) -> Array:
    """(rows, columns) 255, 127 and 0 from free and wall cells."""
    return np.where(free, FREE, np.where(wall, WALL, UNKNOWN)).astype(np.uint8)


def score_structure(estimate: Array, truth: Array, probability: Array | None = None) -> StructureScore:
    """Score an estimate (rows, columns) against the truth; probability: of a wall per cell, NaN where unknown."""
    known = (estimate != UNKNOWN) & (truth != UNKNOWN)
    both = known & (estimate != WALL) & (truth != WALL)
    either = known & ((estimate != WALL) | (truth != WALL))
    log_odds = np.select([estimate == FREE, estimate == WALL], [-1, 1], 0).astype(np.int16)
    walls = score_map(log_odds, np.zeros(2), 1.0, np.zeros(3), truth == FREE, truth == WALL, np.zeros(2), 1.0)
    if probability is None:
        probability = np.where(estimate == UNKNOWN, np.nan, (estimate == WALL).astype(float))
    told = np.isfinite(probability) & (truth != UNKNOWN)
    error = probability[told] - (truth[told] == WALL)
    difference = estimate.astype(float) - truth.astype(float)
    return StructureScore(
        iou_free=float(both.sum() / max(either.sum(), 1)),
        iou_wall=walls.wall_iou,
        coverage=float(known.sum() / max((truth != UNKNOWN).sum(), 1)),
        mse=float(np.mean((difference / 255.0) ** 2)),
        brier=float(np.mean(error**2)) if told.any() else float("nan"),
    )


def reliability(probability: Array, is_wall: Array, bins: int = 10) -> tuple[Array, Array, Array]:
    """(bins,) mean probability, share of walls, and count of the cells in each bin of probability."""
    place = np.minimum((np.asarray(probability) * bins).astype(int), bins - 1)
    count = np.bincount(place, minlength=bins)
    with np.errstate(invalid="ignore"):
        mean = np.bincount(place, probability, minlength=bins) / count
        share = np.bincount(place, np.asarray(is_wall, float), minlength=bins) / count
    return mean, share, count


def calibration_error(probability: Array, is_wall: Array) -> float:
    """Expected calibration error in [0, 1]: |mean probability - share of walls| of each bin, weighted by its count.

    Arguments of equal shape as in `reliability`; 0 if there are none.
    """
    mean, share, count = reliability(probability, is_wall)
    told = count > 0
    return float((np.abs(mean - share)[told] * count[told]).sum() / max(count.sum(), 1))


def walls_crossed_in_raster(wall: Array, start_cell: Array, target_cells: Array, gap_cells: float = 0.0) -> Array:
    """Walls (targets,) on the line from a start (row, column) to each target (targets, 2), in fractional cells.

    A wall is a run of occupied cells of any thickness (papers.md K1), also of cells that touch at a corner. Runs closer
    than `gap_cells` count once, because a ray that grazes a rough wall of a measured map crosses it only once.
    """
    crossed = np.empty(len(target_cells), np.int64)
    start, targets = np.asarray(start_cell, float), np.ascontiguousarray(target_cells, float)
    _count_runs(np.ascontiguousarray(wall), start, targets, gap_cells, crossed)
    return crossed


def walls_crossed_map(wall: Array, free: Array, start_cell: Array) -> Array:
    """(rows, columns) walls between a start (row, column) and every free cell, -1 elsewhere (papers.md K2)."""
    cells = np.argwhere(free)
    k_map = np.full(wall.shape, -1, np.int64)
    k_map[tuple(cells.T)] = walls_crossed_in_raster(wall, start_cell, cells + 0.5)
    return k_map


@kernel
def _count_runs(wall, start, targets, gap, crossed):
    """Walk along each line from cell to cell (Amanatides and Woo 1987), so that no cell is missed, however little of it
    the line cuts. Where it passes between two wall cells that touch at a corner, it crosses their wall."""
    for i in range(targets.shape[0]):
        dr, dc = targets[i, 0] - start[0], targets[i, 1] - start[1]
        length = np.sqrt(dr * dr + dc * dc)
        r, c = int(np.floor(start[0])), int(np.floor(start[1]))
        step_r, step_c = (1 if dr > 0.0 else -1), (1 if dc > 0.0 else -1)
        # Shares of the line at which it leaves the row and the column, and of one row and one column.
        each_r, each_c = 1.0 / max(abs(dr), 1e-12), 1.0 / max(abs(dc), 1e-12)
        leaves_r = ((r + 1 - start[0]) if dr > 0.0 else (start[0] - r)) * each_r
        leaves_c = ((c + 1 - start[1]) if dc > 0.0 else (start[1] - c)) * each_c
        runs, inside, left_at, at = 0, False, -1e9, 0.0
        while True:
            left = min(leaves_r, leaves_c)
            if _is_wall(wall, r, c) and (min(left, 1.0) - at) * length > CORNER_CELLS:
                runs += not inside and at * length - left_at >= gap
                inside, left_at = True, min(left, 1.0) * length
            else:
                inside = False
            at = left
            if at >= 1.0:
                break
            is_corner = abs(leaves_r - leaves_c) * length < CORNER_CELLS
            if is_corner and not inside and _is_wall(wall, r + step_r, c) and _is_wall(wall, r, c + step_c):
                runs += at * length - left_at >= gap
                inside, left_at = True, at * length
            leaves_row = is_corner or leaves_r < leaves_c
            if is_corner or not leaves_row:
                c, leaves_c = c + step_c, leaves_c + each_c
            if leaves_row:
                r, leaves_r = r + step_r, leaves_r + each_r
        crossed[i] = runs


@kernel
def _is_wall(wall, row, column):
    """Whether this cell is a wall; cells outside are not."""
    return 0 <= row < wall.shape[0] and 0 <= column < wall.shape[1] and wall[row, column]
