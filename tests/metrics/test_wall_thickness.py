import numpy as np
import pytest

from twc_env.errors import DataError
from twc_env.metrics import wall_thickness_m
from twc_env.records.geometry import transform_points

WALL_M = np.array([[[1.0, 1.0], [3.0, 1.0]]])


def thickness(rows, pose=(0.0, 0.0, 0.0), walls_m=WALL_M):
    """Wall thickness of a map that shows the wall from (1, 1) to (3, 1) in these rows of cells."""
    log_odds = np.zeros((40, 40), np.int16)
    log_odds[np.array(rows), 10:30] = 50
    return wall_thickness_m(log_odds, np.zeros(2), 0.1, np.array(pose, float), walls_m)


def test_a_wall_drawn_twice_is_twice_as_thick_as_one_drawn_once():
    assert thickness([10]) == pytest.approx(0.1, rel=0.02)
    assert thickness([10, 13]) == pytest.approx(0.2, rel=0.02)
    assert thickness([10, 11, 12]) == pytest.approx(0.3, rel=0.02)


def test_cells_far_from_all_walls_are_ignored():
    assert thickness([10, 35]) == pytest.approx(0.1, rel=0.02)
    assert np.isnan(thickness([35]))


def test_walls_missing_in_the_map_do_not_lower_the_thickness():
    with_unseen = np.concatenate([WALL_M, [[[1.0, 20.0], [30.0, 20.0]]]])
    assert thickness([10], walls_m=with_unseen) == pytest.approx(thickness([10]))


def test_thickness_uses_the_alignment_of_the_map():
    pose = np.array([2.0, -1.0, 0.7])
    turned = np.stack([transform_points(pose, WALL_M[0])])
    assert thickness([10, 12], pose, turned) == pytest.approx(thickness([10, 12]), rel=0.03)


def test_walls_that_are_not_segments_are_rejected():
    with pytest.raises(DataError, match="both ends of each"):
        thickness([10], walls_m=np.zeros((1, 4)))
