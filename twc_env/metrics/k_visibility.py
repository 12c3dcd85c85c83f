"""Metrics of maps from signal strength (papers.md K1, K2, K17-K19): walls crossed, free and wall IoU, calibration.

Maps hold 255 for free, 0 for wall and 127 for unknown cells; truth and estimate are on the same grid.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.kernels import kernel
from twc_env.metrics.mapping import score_map

FREE, UNKNOWN, WALL = 255, 127, 0


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


def calibration_error(probability: Array, is_wall: Array, bins: int = 10) -> float:
    """Expected calibration error: mean difference of probability and share of walls, weighted by count."""
    mean, share, count = reliability(probability, is_wall, bins)
    told = count > 0
    return float((np.abs(mean - share)[told] * count[told]).sum() / max(count.sum(), 1))


def walls_crossed_in_raster(wall: Array, start_cell: Array, target_cells: Array, gap_cells: float = 0.0) -> Array:
    """Walls (targets,) on the line from a start (row, column) to each target (targets, 2), in fractional cells.

    A wall is a run of occupied cells of any thickness (papers.md K1). Runs closer than `gap_cells` count once, because
    a ray that grazes a rough wall of a measured map crosses it only once.
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
    rows, columns = wall.shape
    for i in range(targets.shape[0]):
        dr, dc = targets[i, 0] - start[0], targets[i, 1] - start[1]
        length = np.sqrt(dr * dr + dc * dc)
        steps = int(length * 4.0) + 1
        runs, inside, left_at = 0, False, -1e9
        for s in range(steps + 1):
            r, c = int(np.floor(start[0] + dr * s / steps)), int(np.floor(start[1] + dc * s / steps))
            hit = 0 <= r < rows and 0 <= c < columns and wall[r, c]
            at = length * s / steps
            if hit and not inside and at - left_at >= gap:
                runs += 1
            if hit:
                left_at = at
            inside = hit
        crossed[i] = runs
