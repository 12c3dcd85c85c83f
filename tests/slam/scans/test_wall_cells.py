"""Cells of a line field: encoding, and the nearest wall in each cell."""

import numpy as np
import pytest

from twc_env.slam.matching.scan_matching import LineField
from twc_env.slam.scans.wall_cells import FAR_M, LINES_MAX, NO_WALL, distance_in, line_in, wall_cell
from twc_env.slam.scans.wall_drawing import REACH_M

RANGE_MAX_M = 10.0


@pytest.mark.parametrize("distance_m", [0.0, 0.1, 0.2345, REACH_M])
@pytest.mark.parametrize("line", [0, 1, LINES_MAX - 1])
def test_a_cell_encodes_distance_and_index_of_its_line(distance_m, line):
    cell = wall_cell(np.float32(distance_m), np.uint32(line))
    assert distance_in(np.uint32(cell)) == pytest.approx(distance_m, abs=1e-5)
    assert line_in(np.uint32(cell)) == line


def test_the_value_of_a_cell_without_wall_is_the_largest():
    assert distance_in(NO_WALL) == FAR_M
    assert line_in(NO_WALL) == LINES_MAX
    assert wall_cell(np.float32(REACH_M), np.uint32(LINES_MAX - 1)) < NO_WALL
    assert wall_cell(np.float32(0.1), np.uint32(LINES_MAX - 1)) < wall_cell(np.float32(0.2), np.uint32(0))


def test_cells_hold_the_nearest_wall_within_reach(walls, scan):
    """A corridor along the x axis, with both walls within reach of its centre line."""
    corridor = walls((-8, -0.4), (8, -0.4), (8, 0.4), (-8, 0.4))
    field = LineField(26.0, 0.1, RANGE_MAX_M)
    poses = np.array([[x, 0.0, 0.0] for x in (-2.0, 0.0, 2.0)])
    field.add(poses, np.array([scan(corridor, pose) for pose in poses]))
    for y in np.arange(-1.2, 1.3, 0.1):
        away_m = min(abs(y - 0.4), abs(y + 0.4))
        facing = field.facing_at((0.05, y + 1e-6), (0.05, 0.0))
        if away_m < 0.2:
            assert facing == pytest.approx(-np.sign(y) * np.pi / 2, abs=0.02)
        elif away_m > 0.4:
            assert np.isnan(facing)


def test_a_field_with_no_lines_left_is_not_changed(walls, scan):
    """Walls beyond the maximum number of lines are ignored; earlier cells are kept."""
    room = walls((-4, -3), (4, -3), (4, 3), (-4, 3))
    field = LineField(26.0, 0.1, RANGE_MAX_M)
    pose = np.zeros((1, 3))
    field.add(pose, scan(room, pose[0])[None])
    field._drawn[4] = LINES_MAX
    before = field._cells.copy()
    field.add(pose, scan(walls((-2, -2), (2, -2), (2, 2), (-2, 2)), pose[0])[None])
    assert (field._cells == before).all()
