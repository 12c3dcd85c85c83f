"""Views and random trees on maps that can be checked by hand."""

import math

import numpy as np
import pytest

from twc_env.planning import RandomTree, Terrain, ViewGain
from twc_env.records.messages import GridMap

CELL_M = 0.1


def half_known(size=100) -> Terrain:
    """Free floor in the left half of a square of 10 m, unknown in the right half."""
    log_odds = np.zeros((size, size), np.int16)
    log_odds[:, : size // 2] = -50
    return Terrain(GridMap(log_odds, np.zeros(2), CELL_M), 0.2)


def test_a_view_at_the_edge_of_the_unknown_shows_half_a_disc():
    area_m2 = ViewGain(half_known(), 2.0, beams=720).area_m2(np.array([[5.0, 5.0]]))[0]
    assert area_m2 == pytest.approx(math.pi * 2.0**2 / 2, rel=0.06)


def test_known_floor_shows_nothing_and_walls_hide():
    terrain = half_known()
    views = ViewGain(terrain, 2.0)
    assert views.area_m2(np.array([[2.5, 5.0]]))[0] == 0.0
    log_odds = np.zeros((100, 100), np.int16)
    log_odds[:, :50] = -50
    log_odds[:, 50] = 50
    walled = Terrain(GridMap(log_odds, np.zeros(2), CELL_M), 0.2)
    assert ViewGain(walled, 2.0).area_m2(np.array([[4.5, 5.0]]))[0] == 0.0


@pytest.mark.parametrize("is_turned", [False, True])
def test_nothing_is_seen_through_a_slanting_wall_if_walls_are_closed(is_turned):
    rows, columns = np.mgrid[:100, :100]
    log_odds = np.where(columns + rows < 100, -50, 0).astype(np.int16)
    log_odds[columns + rows == 100] = 50
    terrain = Terrain(GridMap(log_odds[:, ::-1] if is_turned else log_odds, np.zeros(2), CELL_M), 0.2)
    places_m = np.array([[4.5, 4.5], [5.9, 3.3]])
    places_m[:, 0] = 10.0 - places_m[:, 0] if is_turned else places_m[:, 0]
    assert (ViewGain(terrain, 2.5).area_m2(places_m) > 0.5).all()
    assert (ViewGain(terrain, 2.5, closes_walls=True).area_m2(places_m) == 0.0).all()
    assert ViewGain(half_known(), 2.0, closes_walls=True).area_m2(np.array([[5.0, 5.0]]))[0] > 5.0


def test_what_another_robot_will_see_is_not_counted_again():
    views, place = ViewGain(half_known(), 2.0), np.array([5.0, 5.0])
    views.claim(place)
    assert views.area_m2(place[None])[0] == 0.0
    assert views.area_m2(np.array([[5.0, 9.5]]))[0] > 0.0


def test_a_tree_grows_over_free_floor_and_reports_where_it_meets_the_unknown():
    terrain, tree = half_known(), RandomTree(np.array([2.0, 5.0]))
    points = tree.grow(terrain, np.random.default_rng(0).random((400, 2)), 1.0)
    assert tree.count > 100
    assert len(points) > 10
    on_edge = np.min(np.abs(np.column_stack([points[:, 0] - 5.0, points, points[:, 1] - 10.0])), axis=1)
    assert on_edge.max() < 0.2


def test_the_best_views_are_those_of_all_scans():
    random = np.random.default_rng(3)
    found_any = 0
    for trial in range(30):
        log_odds = random.choice(np.array([-400, 0, 400], np.int16), (40, 50), p=[0.5, 0.3, 0.2])
        terrain = Terrain(GridMap(log_odds, np.array([-1.0, 2.0]), 0.125), 0.05)
        open_cells = np.argwhere(terrain.kind == 1)
        cells = open_cells[random.permutation(len(open_cells))[:60]]
        places_m, factors = terrain.to_metres(cells + 0.5), random.uniform(0.2, 1.0, 60)
        views = ViewGain(terrain, 1.5, beams=28, closes_walls=bool(trial % 2))
        is_claimed = np.zeros((40 + 60, 50 + 60), bool)
        if trial % 3 == 0:
            views.claim(places_m[0])
            _scan(terrain, cells[0], bool(trial % 2), is_claimed, claims=True)
        areas_m2 = np.array([_scan(terrain, cell, bool(trial % 2), is_claimed) for cell in cells]) * 0.125**2
        worth, expected = np.where(areas_m2 >= 0.3, areas_m2 * factors, 0.0), []
        while len(expected) < 4 and worth.max() > 0.0:
            expected.append(int(np.argmax(worth)))
            worth[np.hypot(*(places_m - places_m[expected[-1]]).T) < 0.5] = 0.0
        chosen, gains_m2 = views.best(places_m, factors, 0.3, 4, 0.5)
        assert chosen.tolist() == expected
        assert np.allclose(gains_m2, areas_m2[expected])
        found_any += len(expected)
    assert found_any > 60


def _scan(terrain, cell, closes_walls, is_claimed, claims=False):
    """Unknown cells that 28 rays of 12 cells from the middle of a cell show, counted one by one."""
    kind, seen = np.pad(terrain.kind, 30), set()
    if closes_walls:
        walls = kind == 2
        for down, right in ((0, 1), (1, 0), (1, 1)):
            kind = np.where(np.roll(walls, (down, right), (0, 1)), 2, kind)
    for beam in range(28):
        angle = 2.0 * math.pi * beam / 28
        for k in range(1, 13):
            row, column = np.floor(cell + 0.5 + k * np.array([math.sin(angle), math.cos(angle)])).astype(int) + 30
            if kind[row, column] == 2:
                break
            if kind[row, column] == 0 and not is_claimed[row, column]:
                seen.add((row, column))
    if claims:
        is_claimed[tuple(np.array(sorted(seen)).reshape(-1, 2).T)] = True
    return len(seen)


def test_places_outside_the_map_show_nothing_and_break_nothing():
    terrain, far_m = half_known(), np.array([[1e5, -1e5], [-300.0, 2.0]])
    views = ViewGain(terrain, 2.0, closes_walls=True)
    views.claim(far_m[0])
    assert views.area_m2(far_m).tolist() == [0.0, 0.0]
    chosen, gains_m2 = views.best(far_m, np.ones(2), 0.1, 2, 1.0)
    assert len(chosen) == len(gains_m2) == 0
