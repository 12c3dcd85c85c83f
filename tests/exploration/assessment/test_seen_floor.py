"""The observed share of the floor, compared with independent computations."""

from __future__ import annotations

import numpy as np
import pytest

from twc_env.config import EnvConfig, override
from twc_env.exploration.assessment.seen_floor import seen_share
from twc_env.slam.scans.occupancy_grid import OccupancyGrid
from twc_env.world.building.floor_cells import Cells

SIDE_M = 12.0
BEAMS = 180


def floor(cell_m):
    """A square of free floor around (0, 0), offset so that no cell centre lies on an edge between map cells."""
    shape = (round(SIDE_M / cell_m),) * 2
    return Cells(np.ones(shape, bool), np.zeros(shape, bool), np.full(2, 0.013 - SIDE_M / 2), cell_m)


def settings(cell_m, beams=BEAMS):
    return override(EnvConfig(), {"lidar.beam_count": beams, "lidar.range_max_m": 4.0, "slam.resolution_m": cell_m})


@pytest.mark.parametrize("cell_m", [0.1, 0.25])
@pytest.mark.parametrize("seed", range(3))
def test_observed_cells_are_those_that_beams_pass_or_end_in(seed, cell_m):
    random, config, cells = np.random.default_rng(seed), settings(cell_m), floor(cell_m)
    poses = np.column_stack([random.uniform(-3, 3, (6, 2)), random.uniform(-4, 4, 6)])
    scans = np.clip(random.uniform(0.5, 5.0, (6, 1)) + random.normal(0.0, 0.4, (6, BEAMS)), 0.1, 4.0)
    scans[random.random(scans.shape) < 0.1] *= -1
    grid = OccupancyGrid(cell_m, 4.0, BEAMS)
    grid.integrate(poses, -np.abs(scans))
    seen, (y, x) = grid.log_odds < 0, np.indices(cells.free.shape) * cell_m + cells.origin_m[0] + cell_m / 2
    angles = poses[:, 2:] + np.arange(BEAMS) * (2 * np.pi / BEAMS)
    ends = poses[:, :2, None] + scans[:, None] * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    ends = ends.swapaxes(1, 2)[(scans >= 0) & (scans < 4.0)]
    column, row = np.floor((ends - grid.origin_m) / cell_m).astype(int).T
    seen[row, column] = True
    inside = seen[
        tuple(np.floor((at - low) / cell_m).astype(int) for at, low in zip((y, x), grid.origin_m[::-1], strict=True))
    ]
    assert 0.1 < inside.mean() < 0.9
    assert seen_share(poses, scans, config, cells) == pytest.approx(inside.mean(), abs=1e-12)


def test_cells_with_balanced_evidence_count_as_observed():
    config, cells = settings(0.1), floor(0.1)
    through, met = np.full((5, BEAMS), 2.5), np.full((2, BEAMS), 2.0)
    poses = np.zeros((7, 3))
    alone = seen_share(poses[:5], through, config, cells)
    assert seen_share(poses, np.concatenate([through, met]), config, cells) == alone > 0.0


def test_nothing_is_observed_without_scans():
    assert seen_share(np.zeros((0, 3)), np.zeros((0, BEAMS)), settings(0.1), floor(0.1)) == 0.0
