"""What of a building and of points beside it is shown."""

import numpy as np

from twc_env.exploration.drawing.extent import extent_m, grown_extent_m, wall_points_m
from twc_env.records.messages import GridMap

HALL_M = np.array([[0.0, 0.0], [20.0, 10.0]])


def test_what_is_shown_holds_the_building_and_points_beside_it_but_ends_at_a_third_of_its_size():
    assert np.array_equal(extent_m(HALL_M, np.zeros((0, 2))), HALL_M)
    assert np.array_equal(extent_m(HALL_M, np.array([[5.0, 5.0], [np.nan, 3.0]])), HALL_M)
    assert np.array_equal(extent_m(HALL_M, np.array([[23.0, -1.0], [5.0, 5.0]])), [[0.0, -1.0], [23.0, 10.0]])
    assert np.allclose(extent_m(HALL_M, np.array([[500.0, -500.0]])), [[0.0, -3.0], [26.0, 10.0]])


def test_a_view_grows_in_three_steps_on_each_side_and_never_shrinks():
    shown, widths = HALL_M, []
    for x_m in np.arange(20.0, 30.0, 0.1):
        shown = grown_extent_m(HALL_M, shown, np.array([[x_m, 5.0]]))
        widths.append(round(float(np.ptp(shown[:, 0])), 9))
        assert x_m <= shown[1, 0] + 1e-9 or widths[-1] == 26.0
    assert sorted(set(widths)) == widths[:1] + [22.0, 24.0, 26.0] == [20.0, 22.0, 24.0, 26.0]
    assert np.array_equal(grown_extent_m(HALL_M, shown, np.array([[10.0, 5.0]])), shown)


def test_walls_of_a_map_are_told_in_the_building_frame():
    log_odds = np.array([[-5, 0, 9]], np.int16)
    assert np.allclose(
        wall_points_m(GridMap(log_odds, np.zeros(2), 0.1), np.array([1.0, 2.0, np.pi / 2])), [[0.95, 2.25]]
    )
