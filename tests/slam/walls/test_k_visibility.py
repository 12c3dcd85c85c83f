"""Walls from signal strength: the published rules, the signal model, and walls sampled against rays."""

import itertools

import numpy as np
import pytest

from twc_env.errors import DataError
from twc_env.metrics.k_visibility import walls_crossed_in_raster, walls_crossed_map
from twc_env.records.geometry import points_along, travelled_m
from twc_env.slam.walls import k_visibility_rules as rules
from twc_env.slam.walls.k_clusters import compensate_distance, k_means, predict_walls, silhouette_k, sliding_window
from twc_env.slam.walls.k_visibility import EXPLAINED_MIN, map_structure
from twc_env.slam.walls.k_visibility_grid import cell_probabilities
from twc_env.slam.walls.k_visibility_signal import (
    _forward_backward,
    _transitions,
    fit_identical_routers,
    fit_signal,
    locate_router,
)
from twc_env.slam.walls.path_bins import bin_along_path
from twc_env.slam.walls.wall_candidates import WallCandidates, wall_candidates

ROUTER = np.array([0.8, 1.2])


def two_rooms():
    """One lap along the walls of two rooms of 4 x 4 m, with a wall between them at x = 4 that ends at y = 3."""
    corners = [
        (0.3, 0.3),
        (3.7, 0.3),
        (3.7, 3.3),
        (4.3, 3.3),
        (4.3, 0.3),
        (7.7, 0.3),
        (7.7, 3.7),
        (0.3, 3.7),
        (0.3, 0.3),
    ]
    travel = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(corners, axis=0), axis=1))])
    at = np.linspace(0, travel[-1], 1500)
    path = np.column_stack([np.interp(at, travel, np.array(corners)[:, k]) for k in (0, 1)])
    height = ROUTER[1] + (path[:, 1] - ROUTER[1]) * (4.0 - ROUTER[0]) / np.maximum(path[:, 0] - ROUTER[0], 1e-9)
    walls = ((path[:, 0] > 4.0) & (height < 3.0)).astype(int)
    distance = np.maximum(np.linalg.norm(path - ROUTER, axis=1), 0.5)
    noise = np.random.default_rng(0).normal(0, 2.0, len(path))
    return path, (-30 - 18 * np.log10(distance) - 9.0 * walls + noise)[:, None], walls


def test_clusters_are_ranked_by_strength_and_a_value_on_a_threshold_counts_one_more_wall():
    centroids = k_means(np.array([-70.0, -71, -50, -51, -30, -31]), 3)
    assert centroids.tolist() == [-30.5, -50.5, -70.5]
    assert predict_walls(np.array([-40.4, -40.5, -61.0]), centroids).tolist() == [0, 1, 2]
    assert silhouette_k(np.repeat([-70.0, -50.0, -30.0], 9) + np.tile(np.linspace(-1, 1, 9), 3), 3) == 2


def test_the_sliding_window_keeps_the_length_and_the_mean_of_a_constant():
    assert np.array_equal(sliding_window(np.full(9, -40.0), 5), np.full(9, -40.0))
    assert sliding_window(np.array([0.0, 0, 9, 0, 0]), 3, median=True).max() == 0.0


def test_distance_compensated_readings_differ_by_walls_only():
    path, rssi, walls = two_rooms()
    apart_m = np.linalg.norm(path - ROUTER, axis=1)
    flat = compensate_distance(rssi[:, 0], apart_m, 1.8)
    assert flat[walls == 0].mean() - flat[walls == 1].mean() == pytest.approx(9.0, abs=0.3)
    assert flat[walls == 0].std() < rssi[walls == 0, 0].std() - 1.0
    assert np.mean(predict_walls(flat, k_means(flat, 2)) == walls) > 0.95


def test_a_thick_wall_counts_once_and_each_further_wall_adds_one():
    wall = np.zeros((5, 30), bool)
    wall[:, 10:12] = wall[:, 20] = True
    start = np.array([2.5, 0.5])
    targets = np.array([[2.5, 5.5], [2.5, 15.5], [2.5, 25.5]])
    assert walls_crossed_in_raster(wall, start, targets).tolist() == [0, 1, 2]
    assert walls_crossed_in_raster(wall, start, targets, gap_cells=15).tolist() == [0, 1, 1]


def test_the_dense_inverse_recovers_walls_visible_from_the_router():
    wall = np.zeros((41, 61), bool)
    wall[[0, -1]] = wall[:, [0, -1]] = True
    wall[5:30, 30] = True
    k_map = walls_crossed_map(wall, ~wall, np.array([20.5, 10.5]))
    found = rules.walls_from_k_map(k_map, np.array([20.5, 10.5]))
    seen = wall.copy()
    seen[[0, -1], 31:] = False
    seen[:, -1] = False
    seen[10:30, -1] = found[10:30, -1]
    assert (found & wall).sum() / (found | seen).sum() >= 0.9


def test_rays_without_walls_are_free_and_walls_are_searched_between_unequal_readings():
    cells, walls = np.array([[5, 10], [5, 20]]), np.array([0, 1])
    classes, mu = rules.map_by_rules(cells, walls, np.zeros(2, int), np.array([[5.5, 0.5]]), (11, 30))
    assert (classes[5, :11] == rules.FREE).all()
    assert (classes[5, 11:20] == rules.WALL).all()
    assert np.nansum(mu[5]) == pytest.approx(1.0)
    literal, mu = rules.map_by_rules(
        cells, walls, np.zeros(2, int), np.array([[5.5, 0.5]]), (11, 30), rules.RuleSettings(equation_4="literal")
    )
    assert np.nanmax(mu) == pytest.approx(np.exp(0) / 10)
    assert np.array_equal(literal, classes)


def test_two_rays_through_a_cell_are_fused_by_their_lengths():
    cells, walls, routers = np.array([[5, 10], [5, 4]]), np.ones(2, int), np.array([[5.5, 0.5], [5.5, 20.5]])
    alone = [rules.map_by_rules(cells[k : k + 1], walls[:1], np.array([k]), routers, (11, 30))[1][5, 7] for k in (0, 1)]
    _, both = rules.map_by_rules(cells, walls, np.arange(2), routers, (11, 30))
    assert alone[0] != pytest.approx(alone[1])
    assert both[5, 7] == pytest.approx((16**2 * alone[0] + 10**2 * alone[1]) / (16**2 + 10**2))


def test_a_reading_with_more_walls_than_one_beyond_it_does_not_cut_the_ray():
    cells, walls = np.array([[5, 5], [5, 10], [5, 20]]), np.array([0, 2, 1])
    classes, _ = rules.map_by_rules(cells, walls, np.zeros(3, int), np.array([[5.5, 0.5]]), (11, 30))
    assert (classes[5, :6] == rules.FREE).all() and (classes[5, 11:20] == rules.WALL).all()


def test_algorithm_1_raises_cells_between_readings_with_equal_walls():
    cells, walls, level = np.array([[5, 10], [5, 20]]), np.ones(2, int), np.full((2, 1), -50.0)
    levels = rules.map_by_algorithm_1(cells, walls, level, np.array([[5.5, 0.5]]), (11, 30))
    assert levels[5, 5] < rules.UNKNOWN < levels[5, 15]


def test_algorithm_1_raises_cells_on_clear_rays_and_lowers_cells_before_a_wall():
    cells, walls = np.array([[5, 10], [5, 20]]), np.array([0, 1])
    levels = rules.map_by_algorithm_1(cells, walls, np.array([[-30.0], [-50.0]]), np.array([[5.5, 0.5]]), (11, 30))
    assert levels[5, 5] > rules.UNKNOWN > levels[5, 15]
    assert levels[5, 10] == rules.FREE


def test_the_signal_model_estimates_power_path_loss_and_walls_jointly():
    path, rssi, walls = two_rooms()
    bins = bin_along_path(path, rssi)
    fit = fit_signal(bins, 0, ROUTER)
    assert fit.wall_loss_db == pytest.approx(9.0, abs=1.5)
    assert np.mean(fit.walls[bins.bin_of] == walls) > 0.95
    assert fit.probability.sum(axis=1) == pytest.approx(1.0)


def past_a_wall(routers_m, noise_db=1.5):
    """A straight path of 10 m past a wall at x = 5, with routers (r, 2): positions, readings, walls crossed."""
    path = np.column_stack([np.linspace(0.0, 10.0, 101), np.zeros(101)])
    walls = ((path[:, :1] > 5.0) != (routers_m[:, 0] > 5.0)).astype(int)
    distance = np.linalg.norm(path[:, None] - routers_m, axis=2)
    noise = np.random.default_rng(1).normal(0.0, noise_db, distance.shape)
    return path, -40.0 - 8.0 * np.log10(distance) - 9.0 * walls + noise, walls


def test_outliers_hardly_change_the_signal_model():
    router_m = np.array([[-1.0, 0.0]])
    path, rssi, walls = past_a_wall(router_m, 1.0)
    clean = fit_signal(bin_along_path(path, rssi), 0, router_m[0])
    rssi[3::10] -= 25.0
    bins = bin_along_path(path, rssi)
    fit = fit_signal(bins, 0, router_m[0])
    assert fit.wall_loss_db == pytest.approx(clean.wall_loss_db, abs=1.0)
    assert fit.power_at_1m_dbm == pytest.approx(clean.power_at_1m_dbm, abs=1.0)
    assert np.mean(fit.walls[bins.bin_of] == walls[:, 0]) > 0.97


def test_the_mean_of_censored_readings_is_corrected_downwards():
    random = np.random.default_rng(0)
    path = np.column_stack([np.linspace(0.0, 5.0, 2000), np.zeros(2000)])
    level = -88.0 + 3.0 * random.normal(size=(2000, 1))
    heard = np.where(level > -88.0, level, np.nan)
    assert np.nanmean(heard) > -86.0 > -86.7 > np.nanmean(bin_along_path(path, heard).rssi_dbm) > -88.0


def test_there_is_no_wall_on_the_path_of_the_robot():
    path = np.column_stack([np.linspace(0.0, 4.0, 81), np.zeros(81)])
    across = WallCandidates(
        np.array([[2.0, -1.0, 2.0, 1.0]]), np.zeros(1, int), np.zeros(1, bool), np.full(1, -1), np.full(1, -1),
        np.zeros(1, int), np.ones(1),
    )  # fmt: skip
    heard = np.ones((81, 1), bool)
    grid = cell_probabilities(path, np.array([[0.0, 3.0]]), heard, across, np.ones(1), None, 0.3, 0.1)
    column, row = np.floor((np.array([2.0, 0.0]) + 1e-6 - grid.origin_m) / 0.1).astype(int)
    assert grid.classes()[row, column] == rules.FREE
    assert grid.classes()[row + 5, column] == rules.WALL


def transitions(step_m, stay_m, share, states=3):
    table = np.empty((states, states))
    _transitions(step_m, stay_m, share, table)
    return table


def test_probabilities_of_wall_counts_sum_over_all_sequences():
    random, ways = np.random.default_rng(0), list(itertools.product(range(3), repeat=5))
    told, steps = random.normal(size=(5, 3)), random.uniform(0.1, 4.0, 5)
    tables = [transitions(np.inf, 1.5, 0.4), *(transitions(step, 1.5, 0.4) for step in steps[1:])]
    weight = np.array(
        [
            np.prod([np.exp(told[i, k]) * tables[i][way[i - 1] if i else 0, k] for i, k in enumerate(way)])
            for way in ways
        ]
    )
    probability = np.empty((5, 3))
    total = _forward_backward(told, steps, 1.5, 0.4, np.empty((5, 3)), probability)
    assert total == pytest.approx(np.log(weight.sum()))
    for i, k in itertools.product(range(5), range(3)):
        assert probability[i, k] == pytest.approx(weight[[way[i] == k for way in ways]].sum() / weight.sum())


def test_many_short_transitions_equal_one_long_one_and_more_walls_are_less_probable():
    assert np.linalg.matrix_power(transitions(0.25, 1.0, 0.4), 8) == pytest.approx(transitions(2.0, 1.0, 0.4))
    far = transitions(100.0, 1.0, 0.4)
    assert far[0] == pytest.approx(far[2]) and far[0, 0] > far[0, 1] > far[0, 2]
    assert transitions(np.inf, 1.0, 0.5)[1] == pytest.approx(np.array([4.0, 2.0, 1.0]) / 7.0)
    assert transitions(np.inf, 1.0, 1.0) == pytest.approx(1 / 3)


def test_equal_transmitters_share_a_signal_model_but_not_their_wall_counts():
    routers_m = np.array([[-1.0, 0.0], [11.0, 0.0]])
    path, rssi, walls = past_a_wall(routers_m)
    bins = bin_along_path(path, rssi)
    fits = fit_identical_routers(bins, routers_m, 1)
    assert np.mean([fit.walls[bins.bin_of] == k for fit, k in zip(fits, walls.T, strict=True)]) > 0.98
    assert fits[0].wall_loss_db == fits[1].wall_loss_db == pytest.approx(9.0, abs=1.0)
    assert fits[0].probability[-1, 1] > 0.99 and fits[1].probability[0, 1] > 0.99


def test_the_wall_count_is_correct_after_a_long_gap_without_readings():
    router_m = np.array([[-1.0, 0.0]])
    path, rssi, _ = past_a_wall(router_m)
    aside = np.column_stack([np.full(100, 8.0), 10.0 - np.abs(np.linspace(-10.0, 10.0, 100))])
    path, rssi = np.insert(path, [80], aside, axis=0), np.insert(rssi, [80], np.full((100, 1), np.nan), axis=0)
    bins = bin_along_path(path, rssi)
    fit, after = fit_signal(bins, 0, router_m[0]), bins.bin_of[180]
    assert fit.probability.shape[1] == 2 and bins.travel_m[after] > 25.0
    assert fit.probability[after, 1] > 0.99


def test_an_unknown_router_is_located_within_a_metre():
    path, rssi, _ = two_rooms()
    place, _ = locate_router(bin_along_path(path, rssi), 0)
    assert np.linalg.norm(place - ROUTER) < 1.0


@pytest.mark.parametrize("turns", range(4))
def test_an_unknown_router_a_step_off_the_path_is_found_however_the_plan_is_turned(turns):
    router_m = np.array([1.0, 1.0])
    first = [(0.3, 2.0), (0.3, 0.3), (4.7, 0.3), (4.7, 2.0)]  # two rooms of 5 x 4 m with a door at (5, 2)
    second = [(5.3, 2.0), (5.3, 0.3), (9.7, 0.3), (9.7, 3.7), (5.3, 3.7), (5.3, 2.0)]
    corners = np.array([*first, *second, (4.7, 2.0), (4.7, 3.7), (0.3, 3.7), (0.3, 2.0)])
    path = points_along(corners, np.linspace(0.0, travelled_m(corners)[-1], 600))
    share = (5.0 - router_m[0]) / np.maximum(path[:, 0] - router_m[0], 1e-9)
    is_behind = (path[:, 0] > 5.0) & (np.abs(router_m[1] + share * (path[:, 1] - router_m[1]) - 2.0) > 0.5)
    distance_m = np.maximum(np.linalg.norm(path - router_m, axis=1), 0.5)
    rssi = -30.0 - 18.0 * np.log10(distance_m) - 9.0 * is_behind + np.random.default_rng(6).normal(0.0, 1.0, 600)
    turned = np.linalg.matrix_power(np.array([[0.0, -1.0], [1.0, 0.0]]), turns)
    place, _ = locate_router(bin_along_path(path @ turned.T, rssi[:, None]), 0)
    assert np.linalg.norm(place - turned @ router_m) < 0.2


def test_the_wall_between_two_rooms_is_found_at_the_signal_drop():
    path, rssi, walls = two_rooms()
    found = map_structure(path, rssi, ROUTER[None])
    assert np.mean(found.walls[:, 0] == walls) > 0.97
    middle = (found.candidates.ends_m[:, :2] + found.candidates.ends_m[:, 2:]) / 2
    on_wall = (np.abs(middle[:, 0] - 4.0) < 0.05) & (middle[:, 1] > 0.5) & (middle[:, 1] < 2.8)
    assert on_wall.sum() > 20
    assert found.probability[on_wall].mean() > 0.9
    again = map_structure(path, rssi, ROUTER[None])
    assert np.array_equal(found.probability, again.probability)


def test_strengths_that_say_nothing_tell_no_walls():
    path, rssi, _ = two_rooms()
    assert map_structure(path, rssi, ROUTER[None]).explained > 2 * EXPLAINED_MIN
    found = map_structure(path, np.random.default_rng(1).permutation(rssi), ROUTER[None])
    assert found.explained < EXPLAINED_MIN and not found.walls.any()
    assert not (found.grid.classes() == rules.WALL).any()


def test_too_few_readings_are_rejected_with_a_reason():
    with pytest.raises(DataError, match="heard in 2 places"):
        fit_signal(bin_along_path(np.array([[0.0, 0], [1, 0]]), np.array([[-40.0], [-41.0]])), 0, ROUTER)


def test_unequal_numbers_of_positions_and_routers_are_rejected():
    along = np.column_stack([np.linspace(0.0, 8.0, 50), np.zeros(50)])
    with pytest.raises(DataError, match="each of the 1 routers that were heard; got 2"):
        map_structure(along, np.full((50, 1), -50.0), router_m=np.zeros((2, 2)))


def test_a_long_run_slightly_off_the_main_direction_gives_wall_candidates():
    corners = np.array([(0.0, 0), (10, 0), (10, 1), (0, 1), (0, 2), (3, 2.75)])
    assert (wall_candidates(corners, 0.3).ends_m[:, 1] > 2.1).any()


@pytest.mark.parametrize("outside", [[(-1, -1)], [(-1, 40)], [(40, 5), (-3, 5)]])
def test_readings_off_the_grid_cast_rays_and_mark_no_other_cell(outside):
    cells, router = np.array([(5, 9), *outside]), np.array([[5.5, 2.5]])
    walls, focus = np.ones(len(cells), int), np.zeros(len(cells), int)
    classes, _ = rules.map_by_rules(cells, walls, focus, router, (10, 12))
    levels = rules.map_by_algorithm_1(cells, walls, np.zeros((len(cells), 1)), router, (10, 12))
    assert np.argwhere(classes == rules.FREE).tolist() == [[5, 9]]
    assert np.argwhere(levels > rules.UNKNOWN).tolist() == [[5, 9]]


def test_rays_from_a_router_far_off_the_grid_reach_their_readings():
    cells, router, nothing = np.array([(5, 3)]), np.array([[5.5, 400.5]]), np.zeros(1, int)
    classes, _ = rules.map_by_rules(cells, nothing, nothing, router, (10, 12))
    levels = rules.map_by_algorithm_1(cells, nothing, np.zeros((1, 1)), router, (10, 12))
    assert (classes[5, 3:] == rules.FREE).all()
    assert (levels[5, 3:] > rules.UNKNOWN).all()
    k_map = np.where(np.arange(12) > 5, 0, 1) * np.ones((10, 1), int)
    k_map[:, 5] = -1
    assert rules.walls_from_k_map(k_map, router[0])[5].nonzero()[0].tolist() == [5]


def test_no_readings_leave_everything_unknown():
    nothing = np.zeros(0, int)
    classes, _ = rules.map_by_rules(np.zeros((0, 2), int), nothing, nothing, np.array([[2.0, 2.0]]), (4, 5))
    assert (classes == rules.UNKNOWN).all()


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"position_m": np.full((60, 2), np.nan)}, "positions must be finite; row 0"),
        ({"position_m": np.zeros((60, 3))}, "positions must have shape"),
        ({"position_m": 1e6 * np.random.default_rng(0).random((60, 2))}, "check their unit"),
        ({"router_m": [[np.nan, 0.0]]}, "places of routers must be finite"),
        ({"rssi_dbm": np.zeros((60, 0))}, "a router at least"),
        ({"resolution_m": 0.0}, "resolution_m must be finite and above 0"),
        ({"resolution_m": np.inf}, "resolution_m must be finite and above 0"),
        ({"resolution_m": "fine"}, "resolution_m must be real numbers"),
        ({"origin_m": [np.nan, 0.0]}, "a corner of the grid must be finite"),
        ({"origin_m": [0.0, 0.0, 0.0]}, "a corner of the grid must have shape"),
        ({"rssi_dbm": np.full((60, 1), 50.0)}, "readings have strengths from 50 to 50: give dBm, such as -67"),
        ({"rssi_dbm": np.zeros((60, 1))}, "readings have strengths from 0 to 0: give dBm"),
        ({"rssi_dbm": np.full((60, 1), -50.0 + 1j)}, "readings must be real numbers"),
    ],
)
def test_invalid_readings_are_rejected(changes, message):
    readings = {"position_m": np.zeros((60, 2)), "rssi_dbm": np.full((60, 1), -50.0), "router_m": [[1.0, 2.0]]}
    with pytest.raises(DataError, match=message):
        map_structure(**{**readings, **changes})


@pytest.mark.parametrize("not_heard", [100.0, 0.0, -999.0])
def test_readings_of_what_was_not_heard_are_refused(not_heard):
    position_m = np.stack([np.linspace(0.0, 5.0, 50), np.zeros(50)], axis=1)
    rssi_dbm = np.where(np.arange(50) % 3 == 0, not_heard, -50.0)[:, None]
    with pytest.raises(DataError, match=f"a strength of {not_heard:g} dBm: leave out what was not heard"):
        map_structure(position_m, rssi_dbm)


def test_what_was_not_heard_has_no_number_of_walls():
    values = np.array([-40.0, np.nan, -60.0])
    for call in (lambda: k_means(values, 2), lambda: predict_walls(values, np.array([-40.0, -60.0]))):
        with pytest.raises(DataError, match="leave out those in which it was not heard"):
            call()


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"router_of": np.array([0, 1])}, "numbers 1 routers from 0; got 0 to 1"),
        ({"router_of": np.array([0, -1])}, "numbers 1 routers from 0; got -1 to 0"),
        ({"walls": np.array([0])}, "a router for each of 2 cells"),
        ({"walls": np.array([0.0, np.nan])}, "walls must be"),
        ({"cells": np.zeros((2, 3), int)}, "cells must have shape"),
        ({"router_cells": np.array([[np.nan, 0.0]])}, "places of routers must be finite"),
    ],
)
def test_readings_that_do_not_belong_together_are_rejected(changes, message):
    readings = {"cells": np.array([[1, 1], [2, 3]]), "walls": np.array([0, 1]), "router_of": np.zeros(2, int)}
    with pytest.raises(DataError, match=message):
        rules.map_by_rules(**{**readings, "router_cells": np.array([[0.5, 0.5]]), "shape": (4, 5), **changes})


def test_algorithm_1_refuses_strengths_of_more_routers_than_there_are():
    with pytest.raises(DataError, match="numbers 1 routers from 0"):
        rules.map_by_algorithm_1([[1, 1]], [0], np.array([[-60.0, -50.0]]), np.array([[0.5, 0.5]]), (4, 5))
