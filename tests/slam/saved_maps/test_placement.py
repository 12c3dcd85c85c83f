import re
from types import SimpleNamespace

import numpy as np
import pytest

from tests.slam.saved_maps.cuts import cut_building, irregular_building
from twc_env.errors import MapError
from twc_env.maps import load_map
from twc_env.offline.map_merge import read_saved_maps
from twc_env.records.geometry import between, compose, inverse
from twc_env.reproduce.maps.map_cuts import overlapping_parts, saved_parts, twice
from twc_env.reproduce.maps.saved_maps import error_of
from twc_env.slam.saved_maps.map_joining import Pair, join_maps, joined
from twc_env.slam.saved_maps.merged_grid import merged_grid
from twc_env.slam.saved_maps.placement import Agreement, Placement, agreement_at, checked, place
from twc_env.slam.saved_maps.placement_search import turns_along_walls
from twc_env.slam.saved_maps.saved_map import SavedMap, compared


@pytest.fixture(scope="module")
def office():
    """Its rooms repeat."""
    return read_saved_maps(["gen:office:400:3"])[0]


@pytest.fixture(scope="module")
def cut():
    return cut_building()


def test_two_parts_of_a_building_are_laid_over_each_other(cut):
    placement = place(cut.target, cut.source)
    assert placement.is_believed, placement.reason
    error_m, error_deg = error_of(cut, placement.best.pose)
    assert error_m < 0.1 and error_deg < 0.5
    assert placement.best.overlap == pytest.approx(cut.overlap, abs=0.08)
    assert placement.certainty > 0.7


def test_swapped_maps_have_the_inverse_placement(cut):
    forth, back = place(cut.target, cut.source), place(cut.source, cut.target)
    assert between(forth.best.pose, inverse(back.best.pose)) == pytest.approx(np.zeros(3), abs=0.05)


def test_identical_wings_are_told_apart_by_nothing(office):
    random = np.random.default_rng(1)
    pair, floor = twice(office, overlapping_parts(office, 0.2, random)[0])
    one = floor.copy()
    one[:, floor.shape[1] // 2 :] = False
    cut = saved_parts(pair, (floor, one), (0.1, 0.1), random)
    placement = place(cut.target, cut.source)
    assert not placement.is_believed
    assert "two placements explain the overlap about equally" in placement.reason


def test_different_buildings_do_not_merge(office):
    other = read_saved_maps(["sfw-e3"])[0]
    assert not place(office, other).is_believed


def test_a_plan_is_a_map_whose_cells_are_all_known(office):
    assert office.free.sum() == load_map("gen:office:400:3").cells().free.sum()
    assert not (office.free & office.walls).any()


def test_a_map_without_walls_is_refused_by_name():
    with pytest.raises(MapError, match=r"hall shows 0\.0 m of wall beside free floor"):
        compared(SavedMap("hall", np.ones((50, 50), bool), np.zeros((50, 50), bool), 0.1), 0.1)


def test_things_that_stand_free_are_no_walls():
    free, walls = np.ones((100, 100), bool), np.zeros((100, 100), bool)
    walls[10, 5:95] = walls[50:54, 50:54] = True
    free &= ~walls
    points = compared(SavedMap("room", free, walls, 0.1), 0.1).points
    assert len(points) == 90
    assert points[:, 1] == pytest.approx(1.05)


def agreement(agreeing_m, contradicting_m=0.0, x=0.0, floor_m2=50.0):
    return Agreement(np.array([x, 0.0, 0.0]), agreeing_m, contradicting_m, floor_m2, 0.5)


def test_a_wall_that_the_other_run_saw_in_pieces_does_not_contradict():
    """A thin wall through a hall: seen in pieces of half a metre it is no wall, but neither is there free floor."""
    free = np.zeros((80, 120), bool)
    free[5:75, 5:115] = True
    pieces, without = free.copy(), free.copy()
    free[10:70, 60] = False
    pieces[10:70, 61] = np.arange(60) % 8 >= 5  # a run's walls bend
    whole, broken, open_floor = (compared(SavedMap(name, each, ~each, 0.1), 0.1) for name, each in
                                 (("whole", free), ("pieces", pieces), ("open", without)))  # fmt: skip
    assert agreement_at(broken, whole, np.zeros(3)).contradicting_m == 0.0
    assert agreement_at(open_floor, whole, np.zeros(3)).contradicting_m > 2.0


@pytest.mark.parametrize(
    ("ranked", "reason"),
    [
        ([], "no placement at which walls agree"),
        ([agreement(5.0)], "too little in common"),
        ([agreement(80.0), agreement(70.0, x=9.0)], "two placements explain the overlap about equally.*9.0 m"),
        ([agreement(76.7, floor_m2=123.0), agreement(35.5, 1.4, 9.0, 241.0)], "two placements.*123 and 241 m2"),
        ([agreement(88.0, 0.5, floor_m2=566.0), agreement(55.2, 0.0, 9.0, 82.0)], "^$"),
        ([agreement(88.0, 0.5, floor_m2=100.0), agreement(55.2, 0.0, 9.0, 100.0)], "two placements"),
        ([agreement(31.2), agreement(60.9, 10.3, x=9.0)], "^$"),
        ([agreement(17.8), agreement(25.2, 3.4, x=9.0)], "two placements explain the overlap about equally"),
        ([agreement(80.0, 8.5)], "8.5 m of wall stand in the other's free floor"),
        ([agreement(80.0, 1.0), agreement(20.0)], "^$"),
    ],
)
def test_a_placement_is_believed_if_it_stands_out(ranked, reason):
    """Much wall around little floor is a row of like rooms; rivals full of contradictions tell of chance alone."""
    assert re.search(reason, checked(ranked).reason)


def room(name):
    free = np.zeros((60, 60), bool)
    free[5:55, 5:55] = True
    return SavedMap(name, free, ~free, 0.1)


def believed(x, y=0.0):
    best = Agreement(np.array([x, y, 0.0]), 40.0 - x, 0.0, 20.0, 0.5)
    return Placement(best, None, 0.95, "")


def refused():
    return Placement(agreement(3.0), None, 0.1, "too little in common")


def test_placements_that_close_a_triangle_are_joined_by_least_squares():
    maps = [room(name) for name in "abc"]
    pairs = [Pair(0, 1, believed(10.0)), Pair(1, 2, believed(10.0)), Pair(0, 2, believed(20.03))]
    (group,) = joined(maps, pairs).groups
    assert group.members == (0, 1, 2)
    assert group.poses[1:, 0] == pytest.approx([10.01, 20.02], abs=1e-3)


def test_placements_that_disagree_are_all_left_out_and_named():
    maps = [room(name) for name in "abc"]
    pairs = [Pair(0, 1, believed(10.0)), Pair(1, 2, believed(10.0)), Pair(0, 2, believed(25.0))]
    found = joined(maps, pairs)
    assert [group.members for group in found.groups] == [(0,), (1,), (2,)]
    assert all("nothing tells which is wrong" in pair.placement.reason for pair in found.pairs)


def test_one_false_placement_among_four_maps_is_left_out():
    maps = [room(name) for name in "abcd"]
    right = {(0, 1): 10.0, (1, 2): 10.0, (0, 2): 20.0, (2, 3): 10.0, (1, 3): 20.0}
    pairs = [Pair(a, b, believed(x)) for (a, b), x in right.items()] + [Pair(0, 3, believed(36.0))]
    found = joined(maps, pairs)
    assert found.groups[0].members == (0, 1, 2, 3)
    assert [not pair.placement.is_believed for pair in found.pairs] == 5 * [False] + [True]


def test_a_join_that_lays_walls_through_a_floor_is_left_out():
    maps = [room(name) for name in "abc"]
    pairs = [Pair(0, 1, believed(10.0)), Pair(1, 2, believed(-7.5)), Pair(0, 2, refused())]
    found = joined(maps, pairs)
    assert len(found.groups) == 2
    assert "so that their walls contradict" in " ".join(pair.placement.reason for pair in found.pairs)


def test_the_merged_grid_shows_all_maps_in_the_frame_of_the_first(cut):
    found = join_maps([cut.target, cut.source])
    (group,) = found.groups
    grid = merged_grid([cut.target, cut.source], group.poses)
    floor = (np.argwhere(cut.source.free)[:, ::-1] + 0.5) * cut.source.resolution_m
    pose = compose(group.poses[1], cut.source.origin)
    c, s = np.cos(pose[2]), np.sin(pose[2])
    cells = np.floor((floor @ np.array([[c, s], [-s, c]]) + pose[:2] - grid.origin_m) / grid.resolution_m).astype(int)
    assert (grid.log_odds[cells[:, 1], cells[:, 0]] < 0).mean() > 0.9
    known = cut.target.free.sum() + cut.source.free.sum() * (1 - cut.overlap)
    assert (grid.log_odds < 0).sum() == pytest.approx(known, rel=0.1)


def test_turned_grids_of_one_map_lie_at_their_origins():
    office = irregular_building()
    moved = SavedMap("moved", office.free, office.walls, office.resolution_m, np.array([3.0, -2.0, 0.7]))
    pose = place(office, moved)
    expected = compose(office.origin, inverse(moved.origin))
    best = pose.best.pose
    assert between(expected, best) == pytest.approx(np.zeros(3), abs=0.02)


def test_the_turn_of_a_common_wing_is_searched_beside_that_of_the_walls_that_dominate():
    target, source = (
        SimpleNamespace(directions_rad=np.radians(np.repeat(directions, [60, 40])))
        for directions in ((0.0, 50.0), (10.0, 70.0))
    )
    turns_deg = np.degrees(turns_along_walls(target, source)) % 90
    assert 80.0 in turns_deg.round(), "the walls that dominate"
    assert 70.0 in turns_deg.round(), "the wing"
