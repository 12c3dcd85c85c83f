import math

import numpy as np
import pytest

import twc_env
from twc_env.exploration.observation import map_view
from twc_env.records.geometry import between
from twc_env.records.messages import GridMap
from twc_env.slam.scans.cell_kinds import kinds_of

CELLS, CELL_M = 32, 0.25
HALF = CELLS // 2


@pytest.fixture
def room() -> GridMap:
    """A map of 10 m by 8 m of free floor within walls, unknown outside; its centre is at (5, 4)."""
    log_odds = np.zeros((120, 140), np.int16)
    log_odds[20:102, 20:122] = 10
    log_odds[21:101, 21:121] = -4
    return GridMap(log_odds, np.array([-2.1, -2.1]), 0.1)


def seen(grid: GridMap, x_m: float, y_m: float, heading_rad: float) -> np.ndarray:
    return map_view.crop_around(grid, np.array([x_m, y_m, heading_rad]), CELLS, CELL_M)


@pytest.mark.parametrize("heading_rad", [0.0, 0.4, 1.1, -2.3])
@pytest.mark.parametrize("place_m", [(5.0, 4.0), (0.4, 7.5), (9.8, 0.2), (-30.0, 4.0), (5.0, 40.0)])
def test_every_pixel_shows_the_kind_of_the_map_cells_at_its_centre(room, place_m, heading_rad):
    picture = seen(room, *place_m, heading_rad)
    assert (picture[: map_view.FRONTIER].astype(int).sum(axis=0) == 255).all()
    at = (np.indices((CELLS, CELLS))[::-1] + 0.5 - HALF) * CELL_M  # ahead, left of each pixel's centre
    c, s = math.cos(heading_rad), math.sin(heading_rad)
    points = np.array(place_m) + np.stack([c * at[0] - s * at[1], s * at[0] + c * at[1]], axis=-1)
    column, row = np.moveaxis(np.floor((points - room.origin_m) / room.resolution_m - 0.5).astype(int), -1, 0)
    rows, columns = room.log_odds.shape
    is_inside = (row >= 0) & (row < rows) & (column >= 0) & (column < columns)
    kinds = kinds_of(room.log_odds)[np.clip(row, 0, rows - 1), np.clip(column, 0, columns - 1)]
    expected = np.where(is_inside, np.array([map_view.UNKNOWN, map_view.FREE, map_view.WALL])[kinds], map_view.UNKNOWN)
    assert np.mean(np.argmax(picture[: map_view.FRONTIER], axis=0) == expected) > 0.999  # but for rounding


def test_frontiers_are_free_pixels_next_to_unknown_ones(room):
    room.log_odds[20:60, 110:] = 0  # a corner of the room is unknown
    picture = seen(room, 8.0, 3.0, 0.3).astype(bool)
    free, unknown, frontier = (picture[k] for k in (map_view.FREE, map_view.UNKNOWN, map_view.FRONTIER))
    expected = np.zeros_like(free)
    beside = unknown[:-2, 1:-1] | unknown[2:, 1:-1] | unknown[1:-1, :-2] | unknown[1:-1, 2:]
    expected[1:-1, 1:-1] = free[1:-1, 1:-1] & beside
    assert frontier.any() and np.array_equal(frontier, expected)


def test_walls_one_cell_thick_have_few_gaps_in_the_image(room):
    room.log_odds[60, 21:121] = 10
    gaps = []
    for k in range(50):
        wall = seen(room, 5.0, 2.5 + 0.01 * k, 0.02 * k)[map_view.WALL]
        gaps.append(np.mean(~wall[HALF:, HALF - 4 : HALF + 4].any(axis=0)))
    assert np.mean(gaps) < 0.25


def test_an_empty_map_is_all_unknown():
    empty = GridMap(np.zeros((0, 0), np.int16), np.zeros(2), 0.1)
    picture = seen(empty, 1.0, 2.0, 0.3)
    assert (picture[map_view.UNKNOWN] == 255).all() and picture.any(axis=(1, 2)).sum() == 1


def test_path_teammates_and_signs_are_drawn_in_the_robot_frame(room):
    poses = np.zeros((1, 3, 3))
    poses[0, 0], poses[0, 2] = (5.0, 4.0, 0.5 * math.pi), (1.0, 1.0, 0.0)
    path, teammates = (
        np.array([[[2.1, 1.1, 90.0], [1.1, 0.4, 0.0]]]),
        np.array([[[1.1, math.nan], [-1.1, 0.0], [0.0, 0.0]]]),
    )
    maps = map_view.BelievedMaps.of([room], [np.array([[5.1], [6.1]])])
    views = map_view.MapViews(CELLS, CELL_M, path, np.array([3]), teammates).draw(maps, poses)
    cells = [np.argwhere(views[0, k]).tolist() for k in (map_view.PATH, map_view.TEAMMATES, map_view.SIGNS)]
    assert cells == [[[HALF - 3, HALF], [HALF, HALF + 4]], [[HALF - 5, HALF + 4]], [[HALF - 1, HALF + 8]]]


def test_the_overview_shows_the_map_of_the_present_step(wander):
    env = twc_env.parallel_env(robots=2, max_cycles=60, config={"observation.overview": True})
    observations, _ = env.reset(seed=0)
    pictures = []
    while env.agents:
        actions = {a: wander(o["lidar"] * 10, env.episode.steps) for a, o in observations.items()}
        observations = env.step(actions)[0]
        for agent, seen in observations.items():
            free_and_wall, corner_m, cell_m = map_view.shrink(env.belief(agent).grid, seen["overview"].shape[1])
            assert np.array_equal(seen["overview"][:2], free_and_wall)
            column, row = np.floor((env.belief(agent).pose_map_robot[:2] - corner_m) / cell_m).astype(int)
            assert np.argwhere(seen["overview"][2]).tolist() == [[row, column]]
        pictures.append(observations["robot_0"]["overview"][:2].tobytes())
    assert len(set(pictures)) > 3


def test_the_overview_of_an_empty_map_has_the_robot_in_its_middle():
    env = twc_env.parallel_env(robots=2, max_cycles=20, config={"observation.overview": True, "slam.mode": "off"})
    observations, _ = env.reset(seed=0)
    while env.agents:
        for seen in observations.values():
            cells = seen["overview"].shape[1]
            assert np.argwhere(seen["overview"]).tolist() == [[2, cells // 2, cells // 2]]
        observations = env.step({agent: np.array([1.0, 0.2]) for agent in env.agents})[0]


def test_a_robot_beside_the_known_part_of_the_map_is_marked_at_the_rim_of_the_overview():
    outage = {"failure.link_begin_step": 1, "failure.link_end_step": 10_000}
    config = {"observation.overview": True, "lidar.range_max_m": 1.0, **outage}
    env, are_beside = twc_env.parallel_env(robots=1, max_cycles=40, config=config), set()
    env.reset(seed=0, options={"starts": [(9.0, 1.2, 0.0)]})
    while env.agents:
        seen, belief = env.step({"robot_0": np.array([1.0, 0.0])})[0]["robot_0"], env.belief("robot_0")
        cells = seen["overview"].shape[1]
        _, corner_m, cell_m = map_view.shrink(belief.grid, cells)
        column, row = np.floor((belief.pose_map_robot[:2] - corner_m) / cell_m).astype(int)
        are_beside.add(not (0 <= row < cells and 0 <= column < cells))
        assert np.argwhere(seen["overview"][2]).tolist() == [np.clip([row, column], 0, cells - 1).tolist()]
    assert are_beside == {False, True}


@pytest.mark.parametrize(("speed_m_s", "time_step_s"), [(3.0, 0.2), (1.0, 0.1), (0.3, 0.1)])
def test_the_own_path_is_shown_as_far_back_as_the_config_says_at_any_speed(wander, speed_m_s, time_step_s):
    config = {
        "slam.mode": "off", "odometry.drift": 0.0, "observation.path_m": 4.0, "observation.map_cells": 256,
        "observation.map_cell_m": 0.1, "dynamics.speed_max_m_s": speed_m_s, "dynamics.time_step_s": time_step_s,
    }  # fmt: skip
    env = twc_env.parallel_env(robots=1, max_cycles=250, config=config)
    seen = env.reset(seed=1)[0]["robot_0"]
    places, shown_m = [env.belief("robot_0").pose_map_robot], []
    while env.agents:
        seen = env.step({"robot_0": wander(seen["lidar"] * 10, env.episode.steps)})[0]["robot_0"]
        places.append(here := env.belief("robot_0").pose_map_robot)
        path = np.array(places)
        back_m = np.append(np.cumsum(np.linalg.norm(np.diff(path[::-1, :2], axis=0), axis=1))[::-1], 0.0)
        in_robot = between(np.tile(here, (len(path), 1)), path)[:, :2]
        cells = np.argwhere(seen["map"][map_view.PATH])[:, ::-1]
        away_m = np.linalg.norm((cells[:, None] + 0.5 - 128) * 0.1 - in_robot, axis=2)  # (cells, places)
        is_under = away_m < 0.1
        assert is_under.any(axis=1).all()
        shown_m.append(np.where(is_under, back_m, np.inf).min(axis=1).max())  # the way back to the furthest mark
    step_m = speed_m_s * time_step_s
    assert back_m[0] > 6.0
    assert max(shown_m) < 4.0 + 0.6 + step_m  # a path is a little longer than the pieces that are noted
    assert min(shown_m[-20:]) > 4.0 - 2 * (0.2 + step_m)
