"""Frontiers, clearance and paths on small maps with known results."""

import numpy as np
import pytest
from scipy import ndimage

from twc_env.planning import Disc, PathFinder, Terrain, is_frontier
from twc_env.planning.terrain import OPEN_COST
from twc_env.records.messages import UNSEEN_M, GridMap

CELL_M = 0.1


def grid_of(kind):
    """Grid with origin (3, -2) m from cell kinds: 0 unknown, 1 free, 2 wall."""
    return GridMap(np.array([0, -8, 10], np.int16)[kind], np.array([3.0, -2.0]), CELL_M)


def room(rows=60, columns=80):
    kind = np.ones((rows, columns), int)
    kind[[0, -1]] = 2
    kind[:, [0, -1]] = 2
    return kind


def two_rooms(door_cells):
    """Two rooms, joined by a door `door_cells` wide in the middle of their wall."""
    kind = room()
    kind[:, 40] = 2
    first = 30 - door_cells // 2
    kind[first : first + door_cells, 40] = 1
    return kind


def point(row, column):
    return np.array([3.0 + (column + 0.5) * CELL_M, -2.0 + (row + 0.5) * CELL_M])


def goal_labels(terrain, place_m):
    labels = np.zeros_like(terrain.labels)
    row, column = np.floor(terrain.to_cells(place_m)).astype(int)
    labels[row, column] = 1
    return labels


def plan_between(kind, start, goal, discs=(), radius_m=0.2):
    terrain = Terrain(grid_of(kind), radius_m)
    finder = PathFinder()
    return terrain, finder.cheapest(terrain, start, goal_labels(terrain, goal), np.zeros(2), discs)


@pytest.mark.parametrize(("radius_m", "clear_cells", "easy_cells"), [(0.2, 2.3, 6), (0.5, 5.3, 7), (1.0, 10.3, 12)])
def test_open_cells_are_those_with_enough_exact_clearance(radius_m, clear_cells, easy_cells):
    rng = np.random.default_rng(0)
    kind = np.where(rng.random((70, 90)) < 0.01 * (0.2 / radius_m) ** 2, 2, 1)
    terrain = Terrain(grid_of(kind), radius_m)
    distance = ndimage.distance_transform_edt(terrain.kind != 2)
    expected = (distance >= clear_cells) & (terrain.kind == 1)
    assert expected.any() and np.array_equal(terrain.cost > 0, expected)
    assert np.all(terrain.cost[expected & (distance >= easy_cells)] == OPEN_COST)


def test_a_path_over_open_floor_is_straight_and_has_the_length_of_the_line():
    _, plan = plan_between(room(), point(30, 20), point(30, 60))
    assert plan.length_m == pytest.approx(4.0, abs=0.01)
    assert len(plan.path_m) == 2
    assert np.allclose(plan.path_m, [point(30, 20), point(30, 60)])


@pytest.mark.parametrize(("door_cells", "is_passable"), [(9, True), (7, True), (5, True), (3, False)])
def test_a_robot_passes_doors_wider_than_itself_only(door_cells, is_passable):
    _, plan = plan_between(two_rooms(door_cells), point(20, 15), point(40, 65))
    assert (plan is not None) == is_passable


def test_a_path_goes_through_the_middle_of_a_door():
    terrain, plan = plan_between(two_rooms(9), point(10, 15), point(50, 65))
    at_door = np.interp(point(30, 40)[0], plan.path_m[:, 0], plan.path_m[:, 1])
    assert abs(at_door - point(30, 40)[1]) < 0.16
    assert terrain.is_open(plan.path_m).all()


def test_a_path_keeps_its_distance_from_walls_where_there_is_room():
    kind = room()
    kind[1:40, 40] = 2
    _, plan = plan_between(kind, point(10, 15), point(10, 65))
    corner = point(39, 40)
    along = np.linspace(0, 1, 50)[:, None]
    points = np.concatenate([a + along * (b - a) for a, b in zip(plan.path_m[:-1], plan.path_m[1:], strict=True)])
    assert np.hypot(*(points - corner).T).min() > 0.38


def test_the_frontier_of_a_half_known_room_is_one_line():
    kind = room()
    kind[:, 50:] = 0
    terrain = Terrain(grid_of(kind), 0.2)
    assert len(terrain.frontier_sizes) == 2
    assert terrain.frontier_centres_m[1] == pytest.approx(point(29.5, 49), abs=0.06)
    assert terrain.label_near(point(30, 47), 0.3) == 1
    assert terrain.label_near(point(30, 20), 0.3) == 0


def test_unknown_cells_in_and_behind_walls_are_no_frontier():
    kind = room()
    kind[0, 10:70:3] = 0
    kind[0, 30:33] = 0
    assert len(Terrain(grid_of(kind), 0.2).frontier_sizes) == 1


def test_a_known_room_has_no_frontier_and_an_empty_grid_none_either():
    assert len(Terrain(grid_of(room()), 0.2).frontier_sizes) == 1
    empty = Terrain(grid_of(np.zeros((0, 0), int)), 0.2)
    assert len(empty.frontier_sizes) == 1
    assert PathFinder().cheapest(empty, np.zeros(2), empty.labels, np.zeros(1)) is None


def test_the_goal_of_least_path_length_wins_over_that_of_least_euclidean_distance():
    kind = two_rooms(0)
    kind[52:57, 40] = 1
    terrain = Terrain(grid_of(kind), 0.2)
    labels = goal_labels(terrain, point(10, 44))
    labels += 2 * goal_labels(terrain, point(10, 10))
    plan = PathFinder().cheapest(terrain, point(10, 36), labels, np.zeros(3))
    assert plan.label == 2


def test_penalties_count_as_path_length_and_infinite_ones_exclude_a_label():
    terrain = Terrain(grid_of(room()), 0.2)
    labels = goal_labels(terrain, point(30, 30)) + 2 * goal_labels(terrain, point(30, 60))
    finder, start = PathFinder(), point(30, 20)
    assert finder.cheapest(terrain, start, labels, np.array([0, 0, 0])).label == 1
    assert finder.cheapest(terrain, start, labels, np.array([0, 3.5, 0])).label == 2
    assert finder.cheapest(terrain, start, labels, np.array([0, 2.5, 0])).label == 1
    assert finder.cheapest(terrain, start, labels, np.array([0, np.inf, 0])).label == 2
    assert finder.cheapest(terrain, start, labels, np.array([0, np.inf, np.inf])) is None


def test_a_reused_finder_returns_the_same_plans_as_a_new_one():
    rng = np.random.default_rng(1)
    finder = PathFinder()
    for _ in range(20):
        kind = room(int(rng.integers(30, 70)), int(rng.integers(30, 90)))
        kind[rng.random(kind.shape) < 0.008] = 2
        terrain = Terrain(grid_of(kind), 0.2)
        start, goal = (point(*rng.integers(5, 25, 2)) for _ in range(2))
        plans = [f.cheapest(terrain, start, goal_labels(terrain, goal), np.zeros(2)) for f in (finder, PathFinder())]
        assert (plans[0] is None) == (plans[1] is None)
        if plans[0] is not None:
            assert np.array_equal(plans[0].path_m, plans[1].path_m)


def patchy(rng):
    """A room with walls and unknown cells strewn over it."""
    kind = room(int(rng.integers(40, 70)), int(rng.integers(40, 90)))
    kind[rng.random(kind.shape) < 0.006] = 2
    kind[rng.random(kind.shape) < 0.01] = 0
    return kind


def test_a_search_that_goes_on_where_the_last_one_has_ended_finds_the_same_as_a_new_one():
    rng, found = np.random.default_rng(3), 0
    for _ in range(10):
        terrain = Terrain(grid_of(patchy(rng)), 0.2)
        finder, count = PathFinder(), len(terrain.clusters)
        starts = [point(*rng.integers(10, 30, 2)) for _ in range(2)]
        around = [Disc(*point(*rng.integers(10, 30, 2)), 0.6, 30)], []
        for k in range(12):
            start, discs = starts[k // 6], around[k // 3 % 2]
            penalty = np.where(rng.random(count) < 0.7, np.inf, rng.uniform(0.0, 3.0, count))
            asked = terrain, start, terrain.labels, penalty, discs
            plan, new = finder.cheapest(*asked), PathFinder().cheapest(*asked)
            assert (plan is None) == (new is None)
            if plan is not None:
                found += 1
                assert np.array_equal(plan.path_m, new.path_m)
                assert (plan.length_m, plan.label) == (new.length_m, new.label)
        new = PathFinder()
        for each in (finder, new):
            assert each.spread(terrain, start, discs)
        nearest = [each.nearest_of_labels(terrain, terrain.labels, count - 1) for each in (finder, new)]
        assert np.array_equal(nearest[0][0], nearest[1][0]) and np.array_equal(nearest[0][1], nearest[1][1])
    assert found > 20


def test_of_several_cells_of_a_label_that_are_as_near_the_first_that_was_reached_counts():
    terrain, finder = Terrain(grid_of(room()), 0.2), PathFinder()
    labels = np.zeros_like(terrain.labels)
    around = (-5, 0), (0, -5), (0, 5), (5, 0)  # of the start, in the order of memory
    pairs = [(a, b) for a in range(4) for b in range(a)]
    assert finder.spread(terrain, point(30, 20))
    opened, is_last_in_memory = finder._opened[: finder._counts[2]].tolist(), []
    for pair in pairs:
        labels[:] = 0
        cells = [(31 + around[k][0], 21 + around[k][1]) for k in pair]
        for cell in cells:
            labels[cell] = 1
        lengths_m, places_m = finder.nearest_of_labels(terrain, labels, 1)
        first = min(cells, key=lambda cell: opened.index(cell[0] * labels.shape[1] + cell[1]))
        assert lengths_m[1] == pytest.approx(0.5)
        assert np.allclose(terrain.to_cells(places_m[1]) - 0.5, first)
        is_last_in_memory.append(first == max(cells))
    assert any(is_last_in_memory)


def test_the_label_of_most_cells_near_each_of_many_places_is_the_least_of_several_as_frequent():
    terrain, rng = Terrain(grid_of(patchy(np.random.default_rng(5))), 0.2), np.random.default_rng(6)
    places_m, expected = point(20, 20) + rng.uniform(-8.0, 8.0, (500, 2)), []
    for place in places_m:
        near = terrain.labels[terrain.patch(place, 0.5)]
        expected.append(np.bincount(near[near > 0]).argmax() if (near > 0).any() else 0)
    assert len(set(expected)) > 10
    assert np.array_equal(terrain.labels_near(places_m, 0.5), expected)


def test_lengths_to_frontiers_are_searched_once_per_place_and_are_those_of_a_search():
    rng = np.random.default_rng(4)
    terrain, finder = Terrain(grid_of(patchy(rng)), 0.2), PathFinder()
    lengths_m = finder.lengths_to_frontiers_m(terrain, point(20, 20))
    assert PathFinder().lengths_to_frontiers_m(terrain, point(20, 20)) is lengths_m
    finder.spread(terrain, point(20, 20))
    assert np.array_equal(finder.nearest_of_labels(terrain, terrain.labels, len(lengths_m) - 1)[0], lengths_m)
    assert np.isfinite(lengths_m).sum() > 3
    assert finder.lengths_to_frontiers_m(terrain, np.array([-50.0, -50.0])) is None


def test_a_full_queue_of_a_search_grows(monkeypatch):
    terrain = Terrain(grid_of(room()), 0.2)
    monkeypatch.setattr("twc_env.planning.path_finder.WAITING", 40)
    finder, ample = PathFinder(), PathFinder()
    ample._waiting = np.empty((4000, 2), np.int32)
    asked = terrain, point(30, 20), goal_labels(terrain, point(50, 70)), np.zeros(2)
    assert np.array_equal(finder.cheapest(*asked).path_m, ample.cheapest(*asked).path_m)
    assert len(finder._waiting) > 40


def test_path_costs_equal_those_of_a_plain_dijkstra():
    kind = two_rooms(8)
    kind[20:22, 50:60] = 2
    terrain, plan = plan_between(kind, point(20, 15), point(40, 70))
    assert plan.length_m == pytest.approx(dijkstra_m(terrain.cost, (21, 16), (41, 71)), abs=1e-6)


def dijkstra_m(cost, start, goal):
    import heapq

    best, queue = {start: 0}, [(0, start)]
    while queue:
        spent, (r, c) = heapq.heappop(queue)
        if (r, c) == goal:
            return spent / 10 * CELL_M
        if spent > best[r, c]:
            continue
        for dr, dc in [(1, 0), (-1, 0), (0, 1), (0, -1), (1, 1), (1, -1), (-1, 1), (-1, -1)]:
            there = (r + dr, c + dc)
            if cost[there] == 0 or (dr and dc and (cost[r + dr, c] == 0 or cost[r, c + dc] == 0)):
                continue
            through = spent + (7 if dr and dc else 5) * int(cost[there])
            if through < best.get(there, 10**9):
                best[there] = through
                heapq.heappush(queue, (through, there))
    return None


def test_a_disc_is_driven_around_and_leaves_the_terrain_as_it_was():
    terrain = Terrain(grid_of(room()), 0.2)
    before = terrain.cost.copy()
    disc = Disc(*point(30, 40), 0.5, 40)
    plan = PathFinder().cheapest(terrain, point(30, 20), goal_labels(terrain, point(30, 60)), np.zeros(2), [disc])
    assert np.hypot(*(plan.path_m - point(30, 40)).T).min() > 0.45
    assert np.array_equal(terrain.cost, before)


def test_walls_at_a_robots_position_are_ignored():
    kind = room()
    kind[29:32, 29:32] = 2
    assert Terrain(grid_of(kind), 0.2).is_open(point(30, 30)[None])[0] == np.False_
    assert Terrain(grid_of(kind), 0.2, point(30, 30)[None]).is_open(point(30, 30)[None])[0] == np.True_


def test_a_robot_closer_to_a_wall_than_its_margin_finds_a_path():
    _, plan = plan_between(room(), point(1, 20), point(30, 60))
    assert plan is not None


def test_points_far_outside_the_map_are_accepted():
    terrain = Terrain(grid_of(room()), 0.2)
    far = np.array([1e4, -1e4])
    assert not terrain.is_open(far[None])[0]
    assert terrain.label_near(far, 0.5) == 0
    assert PathFinder().cheapest(terrain, far, terrain.labels, np.zeros(1)) is None
    assert not is_frontier(grid_of(room()), far, 0.3)


def test_a_frontier_ends_when_the_unknown_beside_it_becomes_known():
    kind = room()
    kind[:, 50:] = 0
    assert is_frontier(grid_of(kind), point(30, 49), 0.3)
    assert not is_frontier(grid_of(kind), point(30, 30), 0.3)
    assert not is_frontier(grid_of(room()), point(30, 49), 0.3)


@pytest.mark.timed
def test_planning_on_a_large_map_stays_within_a_few_milliseconds(slowdown):
    import time

    rng = np.random.default_rng(2)
    kind = np.ones((300, 400), int)
    kind[::60], kind[:, ::80] = 2, 2
    for row in range(0, 300, 60):
        for column in range(0, 400, 80):
            kind[row + 25 : row + 35, column] = 1
            kind[row, column + 35 : column + 45] = 1
    kind[rng.random(kind.shape) < 0.0005] = 0
    terrain, finder = Terrain(grid_of(kind), 0.2), PathFinder()
    labels = goal_labels(terrain, point(280, 380))
    finder.cheapest(terrain, point(20, 20), labels, np.zeros(2))
    start = time.process_time()
    for _ in range(5):
        Terrain(grid_of(kind), 0.2)
        finder.cheapest(terrain, point(20, 20), labels, np.zeros(2))
    assert (time.process_time() - start) / 5 < 0.05 * slowdown


def scan_in(kind, row, column, heading_rad, beams=360, reach_m=10.0):
    """Ranges (beams,) of a scan from the middle of a cell."""
    ranges_m = np.full(beams, -reach_m)
    x, y = point(row, column)
    for k in range(beams):
        angle = heading_rad + 2 * np.pi * k / beams
        for away in np.arange(0.0, reach_m, 0.02):
            r, c = int((y + away * np.sin(angle) + 2.0) / CELL_M), int((x + away * np.cos(angle) - 3.0) / CELL_M)
            if kind[r, c] == 2:
                ranges_m[k] = away
                break
    return ranges_m


def test_a_door_that_the_scan_sees_through_is_open_and_other_walls_stay():
    shut, pose = room(), np.array([*point(30, 20), 0.7])
    shut[:, 40] = 2
    ranges_m = scan_in(two_rooms(9), 30, 20, 0.7)
    before, after = Terrain(grid_of(shut), 0.2), Terrain(grid_of(shut), 0.2, None, (pose, ranges_m))
    opened = np.argwhere((before.kind == 2) & (after.kind == 1)) - 1  # without the border
    assert set(opened[:, 1]) == {40} and set(opened[:, 0]) <= set(range(26, 35))
    plans = [
        PathFinder().cheapest(terrain, pose[:2], goal_labels(terrain, point(40, 65)), np.zeros(2))
        for terrain in (before, after)
    ]
    assert plans[0] is None and plans[1] is not None


def test_a_scan_without_information_or_that_ends_at_the_walls_opens_none():
    shut, pose = room(), np.array([*point(30, 20), 0.7])
    shut[:, 40] = 2
    without = Terrain(grid_of(shut), 0.2)
    for ranges_m in (scan_in(shut, 30, 20, 0.7), np.full(360, UNSEEN_M), np.zeros(0)):
        assert np.array_equal(Terrain(grid_of(shut), 0.2, None, (pose, ranges_m)).kind, without.kind)
