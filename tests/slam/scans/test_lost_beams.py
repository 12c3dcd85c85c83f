"""Lost beams are distinguished from openings; cells behind them stay unknown."""

import numpy as np
import pytest

import twc_env
from twc_env.slam.scans.lost_beams import NEAR_M, bridge, mark_lost, opening_beams

RANGE_MAX_M = 10.0


def marked(ranges: np.ndarray, opening: int) -> np.ndarray:
    is_lost, out = np.zeros(len(ranges), bool), np.empty(len(ranges))
    assert bridge(ranges, RANGE_MAX_M, opening, is_lost, out) == is_lost.any()
    mark_lost(is_lost, out)
    return out


@pytest.mark.parametrize("dropout", [0.01, 0.1, 0.5, 0.9])
@pytest.mark.parametrize("beams", [36, 180, 720])
def test_runs_of_lost_beams_as_long_as_an_opening_occur_once_in_ten_thousand_scans(dropout, beams):
    opening = opening_beams(beams, dropout)
    assert beams * dropout**opening <= 1e-4 < beams * dropout ** (opening - 1)


def test_without_lost_beams_openings_are_free_and_with_all_lost_they_are_not():
    scan = np.array([3.0, 10.0, 3.0, 10.0])
    assert opening_beams(4, 0.0) == 1 and np.array_equal(marked(scan, 1), scan)
    assert np.array_equal(marked(np.full(4, 10.0), opening_beams(4, 1.0)), np.full(4, -NEAR_M))


@pytest.mark.parametrize("turn", range(12))
def test_few_beams_without_return_are_free_up_to_the_nearer_neighbour(turn):
    scan = np.roll([3.0, 10.0, 10.0, 4.0, 10.0, 2.0, np.inf, np.inf, np.inf, 5.0, 5.0, 10.0], turn)
    expected = np.roll([3.0, -3.0, -3.0, 4.0, -2.0, 2.0, np.inf, np.inf, np.inf, 5.0, 5.0, -3.0], turn)
    assert np.array_equal(marked(scan, 3), expected)


def test_an_opening_around_a_single_return_stays_open():
    scan = np.full(12, 10.0)
    scan[5] = 2.0
    assert np.array_equal(marked(scan, 3), scan)


@pytest.mark.parametrize("filters", ["compiled", "filterpy"])
def test_a_team_that_loses_a_tenth_of_its_beams_maps_no_floor_beyond_the_walls(filters):
    lossy = {"lidar.dropout_probability": 0.1, "slam.odometry_filter.backend": filters}
    env = twc_env.parallel_env(map="twin-01", robots=2, max_cycles=60, config=lossy)
    env.reset(seed=0)
    while env.agents:
        env.step({agent: np.array([0.5, 0.3], np.float32) for agent in env.agents})
    figures = env.result().figures
    assert figures["coverage_believed"] < figures["coverage_correct"] + 0.02
    assert figures["coverage_correct"] > 0.1
