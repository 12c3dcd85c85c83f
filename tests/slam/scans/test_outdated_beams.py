import numpy as np

from twc_env.records.messages import GridMap
from twc_env.slam.scans.outdated_beams import without_outdated


def floor(walls: dict[int, int]) -> GridMap:
    """A free floor of 10 x 10 m from (-5, -5) with log-odds of some columns, counted from the left."""
    cells = np.full((100, 100), -40, np.int16)
    for column, level in walls.items():
        cells[:, column] = level
    return GridMap(cells, np.array([-5.0, -5.0]), 0.1)


def shortened(reading: float, grid: GridMap) -> float:
    """What becomes of the beam ahead of a scan at the origin."""
    scan = np.array([[reading, -0.001, -0.001, -0.001]])
    return float(without_outdated(np.zeros((1, 3)), scan, grid, 10.0)[0, 0])


def test_a_beam_keeps_the_wall_that_still_stands():
    assert shortened(2.04, floor({70: 40})) == 2.04


def test_a_beam_loses_the_wall_where_the_floor_is_free_now():
    assert shortened(2.04, floor({})) == -2.04


def test_a_beam_ends_before_a_new_wall():
    assert -2.0 <= shortened(4.04, floor({70: 40, 90: 40})) <= -1.8


def test_a_wall_that_one_scan_alone_has_seen_changes_nothing():
    assert shortened(4.04, floor({70: 10, 90: 40})) == 4.04


def test_unknown_floor_contradicts_nothing():
    grid = floor({})
    grid.log_odds[:] = 0
    assert shortened(2.04, grid) == 2.04
