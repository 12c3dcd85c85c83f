"""Share of the building's floor that the robots actually observed."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.config import EnvConfig, shared_config
from twc_env.kernels.compiled import kernel
from twc_env.slam.scans.occupancy_grid import OccupancyGrid
from twc_env.slam.scans.scan_integration import WORD_CELLS, folding_room, look_through
from twc_env.slam.scans.sparse_scans import SparseScans
from twc_env.world.building.floor_cells import Cells


def seen_share(true_poses: Array, scans: Array, config: EnvConfig, cells: Cells) -> float:
    """Share of the explorable floor that scans (k, beams) [m] taken at these true poses (k, 3) observed.

    Observed are the cells that a map drawn from the scans at these poses marks as free or wall.
    """
    if len(scans) == 0:
        return 0.0
    lidar = shared_config(config).lidar
    cell_m, far_m = config.slam.resolution_m, lidar.range_max_m
    reach_m = min(float(np.abs(scans).max()), far_m) + OccupancyGrid.PADDING_M
    first = np.floor((true_poses[:, :2].min(axis=0) - reach_m) / cell_m)
    columns, rows = (np.ceil((true_poses[:, :2].max(axis=0) + reach_m) / cell_m) - first).astype(int).tolist()
    sparse = SparseScans(lidar.circle_beam_count, far_m)
    seen = np.zeros((columns // WORD_CELLS + 2, rows), np.uint64)
    marks, is_inside, _, *room = folding_room(sparse.beam_count, int(2 * far_m / cell_m) + 8)
    x, y = (first * cell_m).tolist()
    _see(seen, x, y, 1.0 / cell_m, true_poses, sparse.directions, sparse.filled(scans), far_m, marks, is_inside, *room)
    count = _count_seen(seen, x, y, cell_m, cells.free, *map(float, cells.origin_m), cells.resolution_m)
    return float(count / max(np.count_nonzero(cells.free), 1))


@kernel
def _see(
    seen, origin_x, origin_y, inverse_m, poses, directions, scans, range_max, marks, is_inside, corners, edges, rows,
    cells,
):  # fmt: skip
    """Set the bits of cells that beams pass or end in. seen (words, rows): 64 columns per word; the last is padding."""
    shape, one = (seen.shape[1], (seen.shape[0] - 1) * WORD_CELLS), np.uint64(1)
    for k in range(poses.shape[0]):
        row_low, row_count, first_column, words = look_through(
            shape, WORD_CELLS, origin_x, origin_y, inverse_m, poses[k], directions, scans[k], range_max, marks,
            is_inside, corners, edges, rows, cells,
        )  # fmt: skip
        for word in range(words):
            own, inside = seen[first_column // WORD_CELLS + word, row_low : row_low + row_count], is_inside[word]
            for row in range(row_count):
                own[row] |= inside[row]
        for i in range(cells.shape[1]):
            column, row = cells[0, i], cells[1, i]
            if 0 <= row < shape[0] and 0 <= column < shape[1]:
                seen[column // WORD_CELLS, row] |= one << np.uint64(column % WORD_CELLS)


@kernel
def _count_seen(seen, origin_x, origin_y, cell_m, free, free_x, free_y, free_cell_m):
    """Number of free cells (`free`, true grid) whose centres lie in an observed cell."""
    rows, columns, count = seen.shape[1], seen.shape[0] * WORD_CELLS, 0
    for i in range(free.shape[0]):
        row = math.floor((free_y + (i + 0.5) * free_cell_m - origin_y) / cell_m)
        if not 0 <= row < rows:
            continue
        for j in range(free.shape[1]):
            if free[i, j]:
                column = math.floor((free_x + (j + 0.5) * free_cell_m - origin_x) / cell_m)
                if 0 <= column < columns:
                    count += (seen[column // WORD_CELLS, row] >> np.uint64(column % WORD_CELLS)) & np.uint64(1)
    return count
