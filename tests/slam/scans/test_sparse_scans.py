"""Scans with few beams draw walls without gaps, and no walls without returns."""

import numpy as np
import pytest

from twc_env.slam.scans.occupancy_grid import OccupancyGrid
from twc_env.slam.scans.sparse_scans import SparseScans

RANGE_MAX_M = 10.0


def level_at(grid: OccupancyGrid, x: float, y: float) -> int:
    column, row = np.floor((np.array([x, y]) - grid.origin_m) / grid.resolution_m).astype(int)
    return int(grid.log_odds[row, column])


def seen(ranges_m) -> OccupancyGrid:
    grid = OccupancyGrid(0.1, RANGE_MAX_M, len(ranges_m))
    grid.integrate(np.zeros((1, 3)), ranges_m[None])
    return grid


@pytest.mark.parametrize("beams", [36, 60, 90, 180])
def test_the_walls_of_a_small_room_are_drawn_without_gaps(scan, walls, beams):
    room = walls((-1.55, -1.55), (1.55, -1.55), (1.55, 1.55), (-1.55, 1.55))
    grid = seen(scan(room, np.zeros(3), beams))
    along = np.arange(-1.25, 1.3, 0.1)
    drawn = [level_at(grid, *place) > 0 for at in along for place in ((at, -1.55), (at, 1.55), (-1.55, at), (1.55, at))]
    assert np.mean(drawn) > 0.95


def test_a_doorway_between_two_beams_stays_open(scan, walls):
    beside = np.concatenate(
        [walls((4.05, 0.35 * s), (9.0, 0.35 * s), (9.0, 6.0 * s), (4.05, 6.0 * s)) for s in (-1, 1)]
    )
    ranges_m = scan(beside, (0.0, 0.0, np.pi / 36), 36)
    grid = OccupancyGrid(0.1, RANGE_MAX_M, 36)
    grid.integrate(np.array([[0.0, 0.0, np.pi / 36]]), ranges_m[None])
    assert ranges_m[0] < 4.2 and ranges_m[-1] < 4.2
    assert all(level_at(grid, 4.05, y) <= 0 for y in np.arange(-0.25, 0.3, 0.1))


def test_no_wall_is_drawn_beside_a_beam_without_return():
    ranges_m = np.full(36, 2.0)
    ranges_m[9] = RANGE_MAX_M
    filled = SparseScans(36, RANGE_MAX_M).filled(ranges_m[None])[0].reshape(36, 5)
    assert np.all(filled[[8, 9], 1:] < 0.0) and np.all(np.delete(filled, [8, 9], axis=0) > 0.0)
    np.testing.assert_array_equal(filled[:, 0], ranges_m)


def test_interpolated_beams_end_on_the_line_between_neighbouring_end_points():
    filled = SparseScans(60, RANGE_MAX_M).filled(np.full((1, 60), 3.0))[0]
    angles = np.arange(180) % 3 * np.deg2rad(2.0) - np.deg2rad(3.0)
    np.testing.assert_allclose(filled, 3.0 * np.cos(np.deg2rad(3.0)) / np.cos(angles))


@pytest.mark.parametrize("beams", [180, 200, 720])
def test_dense_scans_are_not_changed(beams):
    scans = np.full((2, beams), 3.0)
    assert SparseScans(beams, RANGE_MAX_M).filled(scans) is scans


def test_unobserved_cells_stay_unknown():
    assert np.all(SparseScans(8, RANGE_MAX_M).filled(np.full((1, 8), -1e-6)) < 0.0)
