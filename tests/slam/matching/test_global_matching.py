import itertools
import math
import tracemalloc

import numpy as np
import pytest

from twc_env.errors import DataError
from twc_env.records.geometry import between, inverse, transform_points, wrap_angle
from twc_env.records.messages import GridMap
from twc_env.slam.matching.global_matching import (
    CELL_M,
    FULL,
    LEVELS,
    WALL_RAD,
    lattice_headings,
    match_globally,
    possible_places,
    score_fields,
    subsampled,
    turn_along_walls,
    walls_run,
)


def room(width=6.0, height=4.0, spacing=0.05):
    """Points along the walls of a room with a niche and a pillar, so that only one pose matches."""
    corners = [(0, 0), (width, 0), (width, height), (2.5, height), (2.5, height - 0.8), (0, height - 0.8), (0, 0)]
    pillar = [(4.0, 1.0), (4.6, 1.0), (4.6, 1.4), (4.0, 1.4), (4.0, 1.0)]
    pieces = []
    for chain in (corners, pillar):
        for (x0, y0), (x1, y1) in itertools.pairwise(chain):
            share = np.arange(0, 1, spacing / math.hypot(x1 - x0, y1 - y0))[:, None]
            pieces.append(np.array([x0, y0]) + share * np.array([x1 - x0, y1 - y0]))
    return np.concatenate(pieces) - [2.0, 1.5]


def brute_force(target, source, reach, headings):
    """(score, heading, column, row) of the best pose of the search grid, by exhaustive search."""
    fields, origin_m = score_fields(target)
    field = np.pad(fields[0].astype(np.int64), 2 * reach + 200)
    best = (-1, 0.0, 0, 0)
    for heading in headings:
        turned = transform_points([0.0, 0.0, heading], source)
        columns, rows = np.floor((turned - origin_m) / CELL_M).astype(int).T + 2 * reach + 200
        for row in range(-reach, reach + 1):
            sums = [int(field[rows + row, columns + column].sum()) for column in range(-reach, reach + 1)]
            if max(sums) > best[0]:
                best = (max(sums), heading, int(np.argmax(sums)) - reach, row)
    return best


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"target_points": np.full((9, 2), np.nan)}, "points must be finite"),
        ({"source_points": np.full((9, 2), np.inf)}, "points must be finite"),
        ({"source_points": np.zeros((9, 3))}, r"points must have shape \('n', 2\)"),
        ({"window_m": float("nan")}, "window_m must lie in"),
        ({"window_m": -1.0}, "window_m must lie in"),
        ({"window_m": 1e6}, "window_m must lie in"),
        ({"target_points": np.array([[0.0, 0.0], [1e7, 1e7]])}, "within 500 m of their own origin"),
        ({"source_points": np.array([[0.0, 0.0], [1e6, 1e6]])}, "check their unit"),
        ({"score_min": float("nan")}, "score_min must be 0 or more"),
    ],
)
def test_invalid_arguments_are_rejected(changes, message):
    points = np.random.default_rng(0).uniform(-3.0, 3.0, (40, 2))
    with pytest.raises(DataError, match=message):
        match_globally(**{"target_points": points, "source_points": points, "window_m": 2.0, **changes})


@pytest.mark.parametrize("seed", range(4))
def test_branch_and_bound_equals_exhaustive_search(seed):
    random = np.random.default_rng(seed)
    pose = np.array([*random.uniform(-0.5, 0.5, 2), random.uniform(-3, 3)])
    target = room()
    source = subsampled(transform_points(inverse(pose), target) + random.normal(0, 0.02, target.shape), 40)
    found = match_globally(target, source, window_m=0.7, score_min=0.0)
    best, heading, column, row = brute_force(target, source, 7, lattice_headings(source))
    assert round(found.score * FULL * len(source)) == best
    if found.pose != pytest.approx([column * CELL_M, row * CELL_M, heading]):  # another pose with an equal score
        assert brute_force(target, source, 7, [found.pose[2]])[0] == best
    assert found.evaluated < 0.5 * len(lattice_headings(source)) * 15 * 15


@pytest.mark.parametrize("lays_walls_along", [False, True])
@pytest.mark.parametrize("seed", range(6))
def test_a_scan_is_found_at_any_heading(seed, lays_walls_along):
    random = np.random.default_rng(seed)
    pose = np.array([*random.uniform(-2.5, 2.5, 2), random.uniform(-math.pi, math.pi)])
    source = transform_points(inverse(pose), room()) + random.normal(0, 0.01, room().shape)
    turn_rad = turn_along_walls(walls_run(room()), walls_run(source)) if lays_walls_along else None
    found = match_globally(room(), source, window_m=3.0, turn_rad=turn_rad)
    error = between(pose, found.pose)
    assert math.hypot(*error[:2]) < 0.15 and abs(wrap_angle(error[2])) < 0.05


@pytest.mark.parametrize(("window_m", "moved_m"), [(0.0, 0.0), (0.04, 0.0), (0.1, 0.1)])
def test_shifts_stay_within_the_window_rounded_to_cells(window_m, moved_m):
    source = transform_points(inverse(np.array([0.4, 0.0, 0.0])), room())
    found = match_globally(room(), source, window_m=window_m, score_min=0.0)
    assert np.abs(found.pose[:2]).max() == pytest.approx(moved_m)


def test_a_turn_along_walls_leaves_headings_near_it_and_its_right_angles():
    source = transform_points(np.array([0.0, 0.0, 0.7]), room())
    turn_rad = turn_along_walls(walls_run(room()), walls_run(source))
    assert abs(wrap_angle(4 * (turn_rad + 0.7))) < 0.04
    everywhere, along = (match_globally(room(), source, 3.0, turn_rad=turn) for turn in (None, turn_rad))
    assert abs(wrap_angle(along.pose[2] + 0.7)) < WALL_RAD
    assert np.array_equal(along.pose, everywhere.pose) and along.evaluated < everywhere.evaluated / 8


def test_without_main_directions_there_is_no_turn_along_walls():
    turn = np.arange(0, 6.28, 0.02)
    circle = 3.0 * np.stack([np.cos(turn), np.sin(turn)], axis=1)
    for pair in ((room(), circle), (circle, room()), (room(), circle[:1])):
        assert turn_along_walls(*(walls_run(points) for points in pair)) is None


def test_only_possible_places_are_searched():
    source = transform_points(inverse(np.array([1.0, 0.5, 0.2])), room())
    anywhere = match_globally(room(), source, 3.0)
    near = match_globally(
        room(), source, 3.0, places=possible_places(lambda m: np.hypot(*(m - [1, 0.5]).T).T < 0.5, 3.0)
    )
    assert np.array_equal(near.pose, anywhere.pose) and near.evaluated < anywhere.evaluated / 4
    left = match_globally(room(), source, 3.0, score_min=0.0, places=possible_places(lambda m: m[..., 0] < 0, 3.0))
    assert left.pose[0] < 0 and left.score < anywhere.score
    assert match_globally(room(), source, 3.0, places=possible_places(lambda m: m[..., 0] > 9, 3.0)) is None


def test_possible_places_of_a_large_map_take_little_more_memory_than_they_are_large():
    grid = GridMap(np.full((900, 900), -20, np.int16), np.full(2, -45.0), CELL_M)
    tracemalloc.start()
    places = possible_places(lambda shifts_m: grid.level_at(shifts_m) < 0, 50.0)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    shifts_m = CELL_M * np.arange(-500, 501)
    assert np.array_equal(places[0], grid.level_at(np.stack(np.meshgrid(shifts_m, shifts_m), axis=-1)) < 0)
    assert peak < 2 * places.nbytes


def test_every_level_is_an_upper_bound_for_all_shifts_of_its_box():
    fields, _ = score_fields(room())
    for level in range(1, LEVELS):
        side = 2**level
        rows, columns = fields.shape[1:]
        for row, column in ((0, 0), (rows // 2, columns // 3), (rows - side, columns - side)):
            assert fields[level, row, column] == fields[0, row : row + side, column : column + side].max()


def test_another_room_is_not_found():
    circle = 3.0 * np.stack([np.cos(np.arange(0, 6.28, 0.02)), np.sin(np.arange(0, 6.28, 0.02))], axis=1)
    assert match_globally(room(), circle, window_m=1.0, score_min=0.7) is None
    assert match_globally(np.zeros((0, 2)), circle, window_m=1.0) is None
