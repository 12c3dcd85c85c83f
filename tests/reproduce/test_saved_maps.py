import numpy as np
import pytest
from scipy.spatial import cKDTree

from tests.real_data import needs_data
from tests.slam.saved_maps.cuts import cut_building, irregular_building
from twc_env.errors import DataError
from twc_env.records.geometry import compose, transform_points
from twc_env.reproduce.maps import map_cuts, saved_maps
from twc_env.reproduce.runner import data_folder
from twc_env.slam.saved_maps.saved_map import SavedMap


@pytest.mark.parametrize("share", [0.2, 0.5, 0.8])
def test_parts_share_what_is_asked(share):
    hall = np.pad(np.ones((80, 120), bool), 2)
    parts = map_cuts.overlapping_parts(SavedMap("hall", hall, ~hall, 0.1), share, np.random.default_rng(0))
    assert map_cuts.overlap_of(parts) == pytest.approx(share, abs=0.02)


def test_parts_with_a_gap_share_nothing():
    building = irregular_building()
    assert map_cuts.overlap_of(map_cuts.overlapping_parts(building, -0.15, np.random.default_rng(0))) == 0.0


def test_a_shift_of_all_walls_of_a_run_is_a_shift_of_its_pose(monkeypatch):
    bends_m = iter([0.0, 0.4])
    monkeypatch.setattr(map_cuts, "_bend", lambda shape, resolution_m, random: np.full((*shape, 2), next(bends_m)))
    cut = cut_building()
    walls = [
        transform_points(compose(pose, run.origin), (np.argwhere(run.walls)[:, ::-1] + 0.5) * run.resolution_m)
        for run, pose in ((cut.target, np.zeros(3)), (cut.source, cut.pose))
    ]
    apart_m, _ = cKDTree(walls[0]).query(walls[1])
    assert np.quantile(apart_m, 0.4) < 0.1


def test_a_pair_is_ambiguous_if_its_parts_fit_elsewhere_as_well_without_any_error():
    """Three equal rooms in a row: two and two of them fit at two places; a wall in the shared room tells."""
    free = np.zeros((60, 200), bool)
    for first in (10, 70, 130):
        free[10:50, first : first + 50] = True
    free[28:32, 5:185] = True  # doors
    for is_odd in (False, True):
        if is_odd:
            free[10:26, 100:103] = False
        row = SavedMap("row", free, ~free, 0.1)
        parts = [free & (np.arange(200) < 125), free & (np.arange(200) >= 65)]
        cut = map_cuts.saved_parts(row, (parts[0], parts[1]), (0.1, 0.1), np.random.default_rng(0))
        assert saved_maps.is_ambiguous(cut) == (not is_odd)


@needs_data
def test_the_table_counts_what_is_right_wrong_and_left(rows_of):
    rows = rows_of(saved_maps, "--pairs", "4", "--false-pairs", "3", "--jobs", "1")
    assert [row["pairs"] for row in rows] == 7 * [1]
    assert all(row["accepted"] + row["abstained"] == row["pairs"] for row in rows)
    assert sum(row["wrong"] for row in rows) == 0
    assert sum(row["right"] for row in rows) >= 2


@needs_data
def test_no_building_of_the_table_was_calibrated_on():
    shown, used = (set(saved_maps.buildings(data_folder(), flag)) for flag in (False, True))
    assert shown and used and not shown & used


@needs_data
def test_calibration_pairs_are_of_buildings_that_the_table_does_not_show(monkeypatch, rows_of):
    tried = []
    monkeypatch.setattr(saved_maps, "make_pair", lambda case: tried.append(case) or cut_building())
    rows_of(saved_maps, "--calibration", "--first", "7", "--pairs", "2", "--false-pairs", "1", "--jobs", "1")
    assert [case.number for case in tried] == [7, 8, 7]
    assert {case.building for case in tried} <= set(saved_maps.buildings(data_folder(), True))


@needs_data
def test_equal_cases_give_equal_maps():
    case = saved_maps.Case(saved_maps.band_name(saved_maps.BANDS[2]), 2, saved_maps.buildings(data_folder())[2])
    first, second = saved_maps.make_pair(case), saved_maps.make_pair(case)
    assert np.array_equal(first.source.walls, second.source.walls)
    assert 0.5 <= first.overlap <= 0.65


def test_without_data_the_table_says_what_it_needs(rows_of, monkeypatch):
    monkeypatch.delenv("TWC_DATA", raising=False)
    with pytest.raises(DataError, match="set the environment variable TWC_DATA"):
        rows_of(saved_maps, "--pairs", "1")
