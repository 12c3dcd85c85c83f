"""Tours that show the floor of a known plan early, and what is in view from its places."""

from __future__ import annotations

import numpy as np
import pytest

from twc_env.config import MergingConfig, SignsConfig
from twc_env.planning import FloorViews, LatencyTours, TeamState, Terrain
from twc_env.planning.floor_views import _find_marks
from twc_env.planning.latency_tours import STOPS_MAX, _insert
from twc_env.records.messages import GridMap

ROOMS = 4


@pytest.fixture(scope="module")
def views() -> FloorViews:
    """Four rooms of 6 x 5 m in a row, each with a door of 1 m to the next."""
    levels = np.ones((54, 60 * ROOMS + 4), np.int16)
    for room in range(ROOMS):
        levels[2:52, 60 * room + 2 : 60 * room + 60] = -1
    levels[22:32, 2:-2] = -1
    terrain = Terrain(GridMap(levels, np.zeros(2), 0.1), 0.2)
    return FloorViews.of(terrain, np.array([3.0, 2.5]), 1.2, 5.0, np.zeros((0, 3)))


def _team(views: FloorViews, *starts_m: tuple[float, float], common_min: int = 3, sightings_min: int = 0, links=None):
    state = TeamState.begin(len(starts_m), views)
    for robot, start_m in enumerate(starts_m):
        state.stand(robot, np.array([*start_m, 0.0]), views)
    return state, LatencyTours(
        views,
        np.ones(len(starts_m)),
        np.ones(len(starts_m)),
        np.zeros(len(starts_m), bool),
        common_min,
        sightings_min,
        links,
    )


def test_ways_pass_doors_and_are_nearly_the_shortest(views):
    places_m = views.graph.places_m
    first, last = (int(np.argmin(np.hypot(*(places_m - at).T))) for at in ((1.0, 2.7), (23.0, 2.7)))
    apart_m = np.hypot(*(places_m[first] - places_m[last]))
    assert apart_m - 1e-9 <= views.graph.lengths_m[first, last] < 1.1 * apart_m
    assert np.isfinite(views.graph.lengths_m).all()


def test_walls_hide_floor(views):
    place = int(np.argmin(np.hypot(*(views.graph.places_m - (3.0, 4.5)).T)))
    seen_m = views.cells_m[views.is_seen(place)]
    assert len(seen_m) > 100
    assert seen_m[:, 0].max() < 8.0  # its own room, and a little through the door
    words = views.as_words(views.is_seen(place))
    assert sum(int(word).bit_count() for word in words) == len(seen_m)


def test_signs_are_read_from_the_room_they_face_and_near_ones_count_as_one(views):
    signs = np.array([[2.0, 0.2, np.pi / 2], [2.5, 0.2, np.pi / 2], [3.0, 5.2, np.pi / 2], [20.0, 0.2, np.pi / 2]])
    seen = FloorViews.of(views.terrain, np.array([3.0, 2.5]), 1.2, 5.0, signs)
    bits = seen.signs[:, 2].astype(int)
    assert bits[0] == bits[1] and len(set(bits)) == 3
    here, there = (seen.marks[seen.place_at(np.array(at))] for at in ((2.2, 1.5), (20.0, 1.5)))
    assert here[0] == 1 << bits[0] and there[0] == 1 << bits[3]
    assert not (seen.marks >> np.uint64(bits[2]) & np.uint64(1)).any()  # it hangs on the outside
    assert seen.read(np.array([[2.1, 0.4], [20.2, 0.1], [10.0, 2.0]]))[0] == here[0] | there[0]


def test_each_point_of_the_floor_belongs_to_a_place_on_its_side_of_the_wall(views):
    for point in ((5.6, 0.5), (6.6, 0.5)):
        place_m = views.graph.places_m[views.place_at(np.array(point))]
        assert (place_m[0] < 6.1) == (point[0] < 6.1)


def test_turning_around_takes_time(views):
    """A robot that looks away from its only stop is there later, and floor is shown later."""
    values = []
    for heading in (0.0, np.pi):
        state, tours = _team(views, (3.0, 2.5))
        state.poses[0, 2] = heading
        tours.tours[0, 0] = views.place_at(np.array([21.0, 2.5]))
        values.append(tours.value(state, 60.0))
    assert values[0] > values[1]


def test_tours_show_all_floor_and_changes_make_them_better(views):
    state, greedy = _team(views, (3.0, 2.5), (21.0, 2.5))
    _, better = _team(views, (3.0, 2.5), (21.0, 2.5))
    unchanged = greedy.plan(state, 120.0, 0, np.random.default_rng(0))
    improved = better.plan(state, 120.0, 1000, np.random.default_rng(0))
    assert len(views.bits) > improved > unchanged > 0.5 * len(views.bits)
    assert improved == pytest.approx(better.value(state, 120.0))


def test_robots_without_a_common_map_meet(views):
    """Floor counts in the largest map only, so merging maps is worth it, and having merged them too."""
    state, apart = _team(views, (3.0, 2.5), (21.0, 2.5), common_min=10_000)
    _, meeting = _team(views, (3.0, 2.5), (21.0, 2.5))
    never = apart.plan(state, 120.0, 300, np.random.default_rng(0))
    assert meeting.plan(state, 120.0, 300, np.random.default_rng(0)) > never
    state.is_merged[:] = True
    state.seen[:] = state.seen[0] | state.seen[1]
    _, together = _team(views, (3.0, 2.5), (21.0, 2.5))
    assert together.plan(state, 120.0, 300, np.random.default_rng(0)) >= meeting.value(state, 120.0) - 1.0


def test_robots_see_each_other_without_a_wall_between_them(views):
    first, near, behind = (views.place_at(np.array(at)) for at in ((2.0, 1.0), (4.5, 1.0), (7.5, 1.0)))
    assert views.sights[first, near] and not views.sights[first, behind]
    assert np.array_equal(views.sights, views.sights.T)
    state, _ = _team(views, (2.0, 1.0), (7.5, 1.0), (4.5, 1.0))
    assert state.sightings.tolist() == [[0, 0, 1], [0, 0, 0], [1, 0, 0]]
    state.stand(0, np.array([2.01, 1.0, 0.0]), views)
    assert state.sightings.sum() == 2  # it stands where it stood


def test_without_signs_robots_that_never_see_each_other_share_no_map(views):
    """As much common floor as may be merges nothing until the two have been in view of each other as often as asked."""
    values = []
    for seen_before, sightings_min in ((0, 0), (3, 3), (0, 3)):
        state, tours = _team(views, (2.0, 1.0), (22.0, 1.0), sightings_min=sightings_min)
        state.read[0] = np.bitwise_or.reduce(views.marks)
        state.sightings[:] = seen_before
        tours.tours[0, 0], tours.tours[1, 0] = (views.place_at(np.array(at)) for at in ((2.0, 4.5), (10.0, 2.7)))
        values.append(tours.value(state, 60.0))
    assert values[0] == values[1] > 1.05 * values[2]


def test_with_a_mapper_each_maps_are_passed_on_in_range_only(views):
    state, _ = _team(views, (3.0, 2.5), (9.0, 2.5))
    state.is_merged[:] = True
    places = len(views.graph.places_m)
    values = []
    for links in (np.ones((places, places), bool), np.eye(places, dtype=bool)):
        _, tours = _team(views, (3.0, 2.5), (9.0, 2.5), links=links)
        tours.tours[:, 0] = [
            int(np.argmin(np.hypot(*(views.graph.places_m - at).T))) for at in ((1.0, 1.0), (21.0, 2.5))
        ]
        values.append(tours.value(state, 60.0))
    assert values[0] > values[1]


def test_the_same_seed_gives_the_same_tours(views):
    found = []
    for _ in range(2):
        state, tours = _team(views, (3.0, 2.5), (21.0, 2.5))
        tours.plan(state, 120.0, 200, np.random.default_rng(3))
        found.append(tours.tours)
    assert np.array_equal(*found)


def test_a_robot_that_stands_in_unseen_floor_still_gets_a_tour(views):
    """What is in view from where it stands shows most for no way at all."""
    for place_m in views.graph.places_m:
        state, tours = _team(views, tuple(place_m))
        tours.plan(state, 120.0, 0, np.random.default_rng(0))
        assert tours.tours[0, 1] >= 0


@pytest.mark.parametrize("position", [STOPS_MAX - 1, STOPS_MAX])
def test_a_full_tour_loses_its_last_stop_and_that_of_the_next_robot_stays(position):
    tours = np.zeros((2, STOPS_MAX), np.int64)
    _insert(tours[0], position, 7)
    assert tours[0].sum() == (7 if position < STOPS_MAX else 0) and not tours[1].any()


def test_places_lie_in_the_part_of_the_floor_in_which_the_start_does():
    """A shut closet behind the wall has the nearest place."""
    levels = np.ones((44, 120), np.int16)
    levels[2:42, 2:92] = -1
    levels[2:42, 95:108] = -1
    seen = FloorViews.of(
        Terrain(GridMap(levels, np.zeros(2), 0.1), 0.2), np.array([9.0, 2.1]), 3.0, 5.0, np.zeros((0, 3))
    )
    assert len(seen.graph.places_m) > 3 and seen.graph.places_m[:, 0].max() < 9.2


def test_signs_are_read_as_far_and_as_askew_as_the_camera_can(views):
    sign = np.array([[3.0, 0.2, np.pi / 2]])
    counts = [
        int(np.count_nonzero(FloorViews.of(views.terrain, np.array([3.0, 2.5]), 1.2, 5.0, sign, camera).marks))
        for camera in (SignsConfig(range_max_m=2.0), SignsConfig(), SignsConfig(incidence_max_rad=0.3))
    ]
    assert 0 < counts[0] < counts[1] > counts[2] > 0


def test_signs_within_the_setting_of_the_merging_count_as_one(views):
    signs = np.array([[2.0, 0.2, np.pi / 2], [4.5, 0.2, np.pi / 2]])
    for apart_m, count in ((MergingConfig().spread_min_m, 2), (3.0, 1)):
        seen = FloorViews.of(views.terrain, np.array([3.0, 2.5]), 1.2, 5.0, signs, apart_m=apart_m)
        assert len(set(seen.signs[:, 2])) == count


def test_a_far_sighted_scanner_sees_all_floor_of_an_empty_hall():
    levels = np.ones((404, 404), np.int16)
    levels[2:402, 2:402] = -1
    seen = FloorViews.of(
        Terrain(GridMap(levels, np.zeros(2), 0.1), 0.2), np.array([20.0, 20.0]), 5.0, 30.0, np.zeros((0, 3))
    )
    assert seen.is_seen(seen.place_at(np.array([20.0, 20.0]))).mean() > 0.99


def test_signs_outside_the_map_are_not_read(views):
    kind = views.terrain.kind
    places = np.ascontiguousarray(views.terrain.to_cells(views.graph.places_m), float)
    marks = np.zeros((len(places), 1), np.uint64)
    for row in (-20.0, len(kind) + 20.0):
        sign = np.array([[row, 30.0, 1.0 if row < 0 else -1.0, 0.0]])
        _find_marks.py_func(kind, places, sign, np.zeros(1, int), 60.0, 0.5, marks)
    assert not marks.any()
