import numpy as np
import pytest

from twc_env.config import EnvConfig
from twc_env.errors import MapError
from twc_env.maps import load_map
from twc_env.reproduce.routes import CLEARANCE_M, SIGN_PASS_RANGE_M, RoutePlanner, room_tour, walk


@pytest.fixture(scope="module")
def plan():
    return load_map("twin-01")


@pytest.fixture(scope="module")
def way(plan):
    stops = [np.array([2.0, 1.2]), *room_tour(plan.rooms[0]), np.array([6.0, 1.2])]
    return RoutePlanner(plan).route(stops)


@pytest.fixture(scope="module")
def walked(plan, way):
    return walk(EnvConfig(), plan, way, robot=1, seed=3)


def test_a_route_keeps_clear_of_walls_and_moves_cell_by_cell(plan, way):
    assert plan.wall_index.distance_m(way, 1.0).min() > CLEARANCE_M - plan.cells().resolution_m
    assert np.hypot(*np.diff(way, axis=0).T).max() <= 1.5 * plan.cells().resolution_m


def test_a_route_passes_all_its_stops(plan, way):
    for stop in room_tour(plan.rooms[0]):
        assert np.linalg.norm(way - stop, axis=1).min() < 0.5


def test_tours_of_one_room_run_both_ways(plan):
    assert np.array_equal(room_tour(plan.rooms[0]), room_tour(plan.rooms[0], clockwise=True)[::-1])


def test_the_walker_ends_where_its_way_ends_and_remembers_the_truth_beside_each_keyframe(way, walked):
    assert len(walked.poses) == len(walked.keyframes) > 20
    assert np.linalg.norm(walked.poses[-1][:2] - way[-1]) < 0.8
    assert {k.robot for k in walked.keyframes} == {1}
    assert [k.index for k in walked.keyframes] == list(range(len(walked.keyframes)))


def test_passes_are_near_the_signs_they_are_of(plan, walked):
    assert {plan.signs[s.sign].text for s in walked.sign_passes} >= {"A301 OPTICS LAB", "FIRE CABINET", "LASER IN USE"}
    for s in walked.sign_passes:
        assert len(s.keyframe.signs) == 1
        assert np.hypot(*(s.position_m - plan.signs[s.sign].position_m)) < SIGN_PASS_RANGE_M + 0.2


def test_the_same_seed_walks_alike(plan, way, walked):
    again = walk(EnvConfig(), plan, way, robot=1, seed=3)
    assert np.array_equal(np.array(again.poses), np.array(walked.poses))
    assert [s.keyframe.signs[0].text for s in again.sign_passes] == [
        s.keyframe.signs[0].text for s in walked.sign_passes
    ]


def test_a_floor_without_clear_room_is_refused(plan):
    class Narrow:
        name = "narrow"

        def cells(self, resolution_m):
            cells = plan.cells(resolution_m)
            return type(cells)(np.zeros_like(cells.free), cells.wall, cells.origin_m, cells.resolution_m)

    with pytest.raises(MapError, match="clear of walls"):
        RoutePlanner(Narrow())
