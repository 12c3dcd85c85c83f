"""Beams of old scans that newer scans contradict, because furniture was moved or a door has opened or shut."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.kernels.compiled import kernel
from twc_env.records.geometry import beam_directions
from twc_env.records.messages import UNSEEN_M, GridMap

WALL_LOG_ODDS, FREE_LOG_ODDS = 20, -12
"""Log-odds from which a cell is certainly a wall or free."""
BEHIND_M = 0.3
"""A beam that ends further than this behind a wall went through it; nearer, it may have seen the wall itself."""
NEAR_CELLS = 2
"""A wall this many cells from where a beam ended is what it saw."""


def without_outdated(poses: Array, scans_m: Array, grid: GridMap, range_max_m: float) -> Array:
    """The scans (k, beams) of poses (k, 3), as the newest evidence in the grid leaves them.

    A beam that ended where the floor is free now keeps its free space and loses its wall; one that would cross a new
    wall ends there.
    """
    out = np.array(scans_m, float)
    _shorten(
        np.ascontiguousarray(poses, float), out, grid.log_odds, np.asarray(grid.origin_m, float), grid.resolution_m,
        beam_directions(out.shape[1]), float(range_max_m),
    )  # fmt: skip
    return out


@kernel
def _has_wall(log_odds, row, column):
    """Whether a wall is within NEAR_CELLS of a cell."""
    for r in range(max(row - NEAR_CELLS, 0), min(row + NEAR_CELLS + 1, log_odds.shape[0])):
        for c in range(max(column - NEAR_CELLS, 0), min(column + NEAR_CELLS + 1, log_odds.shape[1])):
            if log_odds[r, c] > 0:
                return True
    return False


@kernel
def _shorten(poses, scans, log_odds, origin, cell, directions, range_max):
    """See `without_outdated`; scans are modified in place."""
    rows, columns = log_odds.shape
    for k in range(poses.shape[0]):
        cosine, sine = math.cos(poses[k, 2]), math.sin(poses[k, 2])
        for b in range(scans.shape[1]):
            reading = scans[k, b]
            length = min(abs(reading), range_max)
            x = cosine * directions[b, 0] - sine * directions[b, 1]
            y = sine * directions[b, 0] + cosine * directions[b, 1]
            along = 0.0
            while along < length - BEHIND_M:
                column = int(math.floor((poses[k, 0] + along * x - origin[0]) / cell))
                row = int(math.floor((poses[k, 1] + along * y - origin[1]) / cell))
                inside = 0 <= row < rows and 0 <= column < columns
                if inside and log_odds[row, column] >= WALL_LOG_ODDS:
                    scans[k, b] = min(-(along - cell), UNSEEN_M)
                    break
                along += 0.5 * cell
            if scans[k, b] != reading or not 0.0 < reading < range_max:
                continue
            column = int(math.floor((poses[k, 0] + length * x - origin[0]) / cell))
            row = int(math.floor((poses[k, 1] + length * y - origin[1]) / cell))
            if not (0 <= row < rows and 0 <= column < columns):
                continue
            if log_odds[row, column] <= FREE_LOG_ODDS and not _has_wall(log_odds, row, column):
                scans[k, b] = -reading
