import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from twc_env.errors import DataError
from twc_env.records.messages import BLOCK_SHAPE
from twc_env.slam.scans.cell_kinds import kinds_of
from twc_env.slam.scans.occupancy_grid import OccupancyGrid
from twc_env.slam.scans.scan_integration import LOG_ODDS_FREE, LOG_ODDS_HIT, LOG_ODDS_MAX, LOG_ODDS_MIN

BEAMS, RANGE_MAX_M, CELL_M = 720, 10.0, 0.1
HALF_M = 3.05
"""The walls run through the centres of cells."""


@pytest.fixture
def room(walls):
    return walls((-HALF_M, -HALF_M), (HALF_M, -HALF_M), (HALF_M, HALF_M), (-HALF_M, HALF_M))


def map_of(poses, scans, beams=BEAMS):
    grid = OccupancyGrid(CELL_M, RANGE_MAX_M, beams)
    grid.integrate(np.array(poses, float), np.array(scans, float))
    return grid.snapshot()


def centres(grid) -> np.ndarray:
    """(rows, columns, 2) centres of the cells [m]."""
    return grid.centre_of(np.stack(np.indices(grid.log_odds.shape), axis=-1))


def levels_at(grid, points):
    row, column = grid.cell_of(np.asarray(points)).T
    return grid.log_odds[row, column]


@pytest.mark.parametrize("pose", [(0.0, 0.0, 0.0), (1.2, -0.7, 0.4), (-2.0, 2.3, -2.9)])
def test_a_square_room_is_free_inside_wall_at_the_border_and_unknown_outside(room, scan, pose):
    grid = map_of([pose], [scan(room, pose, BEAMS)])
    border = np.abs(centres(grid)).max(axis=-1)
    assert np.all(grid.log_odds[border < HALF_M - 1.01 * CELL_M] < 0)
    assert np.all(grid.log_odds[border > HALF_M + 0.5 * CELL_M] == 0)
    is_wall_cell = np.abs(border - HALF_M) < 0.01
    assert np.mean(grid.log_odds[is_wall_cell] > 0) > 0.9


def test_scans_from_two_places_close_the_whole_border(room, scan):
    poses = [(x, y, 0.1) for x in (-2.0, 0.0, 2.0) for y in (-2.0, 0.0, 2.0)]
    grid = map_of(poses, [scan(room, pose, BEAMS) for pose in poses])
    border = np.abs(centres(grid)).max(axis=-1)
    corner = np.abs(centres(grid)).min(axis=-1) > HALF_M - 0.15
    assert np.all(grid.log_odds[(np.abs(border - HALF_M) < 0.01) & ~corner] > 0)


def test_the_heading_only_rotates_the_beams(room, scan):
    quarter = map_of([(0.4, 0.2, np.pi / 2)], [scan(room, (0.4, 0.2, np.pi / 2), BEAMS)])
    ahead = map_of([(0.4, 0.2, 0.0)], [scan(room, (0.4, 0.2, 0.0), BEAMS)])
    assert np.mean(quarter.log_odds != ahead.log_odds) < 0.002


@given(st.integers(0, 10_000))
def test_free_space_is_the_polygon_of_the_beams(seed):
    random = np.random.default_rng(seed)
    beams = 200
    ranges = np.minimum(random.uniform(0.3, 4.0, beams), 4.0)
    pose = random.uniform(-1, 1, 3)
    grid = map_of([pose], [ranges], beams)
    angles = pose[2] + np.arange(beams) * 2 * np.pi / beams
    reach = np.maximum(ranges - 0.5 * CELL_M, 0.0)
    corners = pose[:2] + reach[:, None] * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    points = centres(grid)
    inside = np.zeros(points.shape[:2], bool)
    for (ax, ay), (bx, by) in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        crosses = (ay > points[..., 1]) != (by > points[..., 1])
        with np.errstate(divide="ignore", invalid="ignore"):
            inside ^= crosses & (points[..., 0] < ax + (points[..., 1] - ay) * (bx - ax) / (by - ay))
    ends = pose[:2] + ranges[:, None] * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    is_end = np.zeros_like(inside)
    row, column = grid.cell_of(ends).T
    is_end[row, column] = True
    assert np.array_equal(grid.log_odds[~is_end] < 0, inside[~is_end])
    assert np.all(grid.log_odds[is_end] > 0)


def test_beams_without_return_clear_space_but_add_no_wall():
    grid = map_of([(0.0, 0.0, 0.0)], [np.full(BEAMS, RANGE_MAX_M)])
    away = np.linalg.norm(centres(grid), axis=-1)
    assert np.all(grid.log_odds <= 0)
    assert np.all(grid.log_odds[away < RANGE_MAX_M - 0.2] == LOG_ODDS_FREE)
    assert np.all(grid.log_odds[away > RANGE_MAX_M] == 0)


def test_scans_with_all_ranges_zero_clear_nothing():
    grid = map_of([(0.0, 0.0, 0.0)], [np.zeros(BEAMS)])
    assert np.count_nonzero(grid.log_odds < 0) == 0
    assert np.count_nonzero(grid.log_odds) <= 4


def test_growing_keeps_every_cell(room, scan):
    grid = OccupancyGrid(CELL_M, RANGE_MAX_M, BEAMS)
    pose = np.array([0.3, -0.2, 0.5])
    grid.integrate(pose[None], scan(room, pose, BEAMS)[None])
    before = grid.snapshot()
    points = centres(before).reshape(-1, 2)
    for far in [(40.0, 3.0), (-35.0, -50.0), (10.0, 60.0)]:
        elsewhere = np.array([*far, 0.0])
        grid.integrate(elsewhere[None], scan(room + np.array(far), elsewhere, BEAMS)[None])
    after = grid.snapshot()
    assert after.log_odds.size > before.log_odds.size
    assert np.array_equal(levels_at(after, points), before.log_odds.ravel())
    assert np.all(levels_at(after, [(40.0, 3.0), (-35.0, -50.0), (10.0, 60.0)]) < 0)


def test_integrating_scans_at_once_equals_one_by_one(room, scan):
    poses = np.array([[0, 0, 0], [1, 1, 1], [-2, 0.5, 2], [0, -2.5, 3]], float)
    scans = np.array([scan(room, pose, BEAMS) for pose in poses])
    together = map_of(poses, scans)
    single = OccupancyGrid(CELL_M, RANGE_MAX_M, BEAMS)
    for pose, ranges in zip(poses, scans, strict=True):
        single.integrate(pose[None], ranges[None])
    points = centres(together).reshape(-1, 2)
    known = together.log_odds.ravel() != 0
    assert np.array_equal(levels_at(single.snapshot(), points[known]), together.log_odds.ravel()[known])
    assert np.count_nonzero(single.snapshot().log_odds) == known.sum()


def test_the_map_does_not_depend_on_the_distance_from_the_origin(room, scan):
    near, far = np.array([0.3, 0.2, 0.1]), np.array([1000.3, -499.8, 0.1])
    here = map_of([near], [scan(room, near, BEAMS)])
    there = map_of([far], [scan(room + (far - near)[:2], far, BEAMS)])
    points = centres(here).reshape(-1, 2)
    level = levels_at(there, points + (far - near)[:2])
    assert np.mean(level != here.log_odds.ravel()) < 1e-3


def test_log_odds_are_bounded_on_both_sides(room, scan):
    pose = np.array([0.0, 0.0, 0.0])
    grid = OccupancyGrid(CELL_M, RANGE_MAX_M, BEAMS)
    for _ in range(100):
        grid.integrate(pose[None], scan(room, pose, BEAMS)[None])
    log_odds = grid.snapshot().log_odds
    assert (log_odds.min(), log_odds.max()) == (LOG_ODDS_MIN, LOG_ODDS_MAX)


def test_several_beams_of_a_scan_in_a_cell_count_as_one_hit():
    ranges = np.full(BEAMS, 0.2)
    grid = map_of([(0.05, 0.05, 0.0)], [ranges])
    assert grid.log_odds.max() <= 2 * LOG_ODDS_HIT


def test_clearing_removes_everything(room, scan):
    pose = np.zeros(3)
    grid = OccupancyGrid(CELL_M, RANGE_MAX_M, BEAMS)
    grid.integrate(pose[None], scan(room, pose, BEAMS)[None])
    grid.clear()
    assert not grid.snapshot().log_odds.any()
    grid.integrate(pose[None], scan(room, pose, BEAMS)[None])
    assert np.array_equal(grid.snapshot().log_odds, map_of([pose], [scan(room, pose, BEAMS)]).log_odds)


def test_cells_and_points_are_inverse_to_each_other(room, scan):
    grid = map_of([np.zeros(3)], [scan(room, np.zeros(3), BEAMS)])
    cells = np.stack(np.indices(grid.log_odds.shape), axis=-1).reshape(-1, 2)
    assert np.array_equal(grid.cell_of(grid.centre_of(cells)), cells)
    levels = grid.level_at(np.vstack([grid.centre_of(cells), grid.origin_m - 0.1]))
    assert levels.tolist() == [*grid.log_odds.ravel().tolist(), 0]


def test_cell_kinds_include_walls_at_the_border_when_the_map_grows():
    grid = OccupancyGrid(CELL_M, RANGE_MAX_M, 180)
    grid.integrate(np.zeros((1, 3)), np.full((1, 180), 5.0))
    border = OccupancyGrid.PADDING_M + 5.0  # left of the origin
    ahead = np.where(np.abs(np.arange(180) - 90) < 6, border - 5.0 - 0.2 * CELL_M, 0.3)  # beam 90 looks back
    grid.integrate(np.array([[-5.0, 0.0, 0.0]]), ahead[None])
    assert (grid.log_odds[:, 0] > 0).any()
    columns = grid.log_odds.shape[1]
    grid.integrate(np.array([[-5.0, 6.0, 0.0]]), np.full((1, 180), 8.0))
    seen = grid.snapshot()
    assert seen.log_odds.shape[1] > columns and np.array_equal(seen.kinds, kinds_of(seen.log_odds))


@settings(max_examples=10)
@given(st.integers(0, 10_000))
def test_cell_kinds_are_updated_by_scans_growth_and_redrawing(seed):
    random = np.random.default_rng(seed)
    grid = OccupancyGrid(CELL_M, RANGE_MAX_M, 90)
    for turn in range(8):
        if turn == 4:
            grid.clear()
        pose, scan = (
            random.uniform(-4, 4, 3),
            random.choice([0.5, 1.0, 4.0, 9.3, 10.0], 90) * random.uniform(0.9, 1, 90),
        )
        scan[random.random(90) < 0.1] *= -1
        grid.integrate(pose[None], scan[None])
        seen = grid.snapshot()
        assert np.array_equal(seen.kinds, kinds_of(seen.log_odds))


@settings(max_examples=15)
@given(st.integers(0, 10_000))
def test_blocks_with_an_unchanged_number_have_unchanged_cells(seed):
    random = np.random.default_rng(seed)
    grid, before = OccupancyGrid(CELL_M, RANGE_MAX_M, 90), None
    for _ in range(8):
        count = int(random.choice([1, 1, 3]))
        poses, scans = random.uniform(-4, 4, (count, 3)), random.uniform(0.2, 4.0, (count, 90))
        scans[random.random(scans.shape) < 0.05] = 10.0
        grid.integrate(poses, scans)
        now = grid.snapshot()
        if before is not None and now is before[0]:
            is_same = np.kron(now.touched == before[2], np.ones(BLOCK_SHAPE, bool))[tuple(map(slice, before[1].shape))]
            assert is_same.any()
            assert np.array_equal(np.sign(now.log_odds[is_same]), np.sign(before[1][is_same]))
        before = now, now.log_odds.copy(), now.touched.copy()


def test_a_grid_that_has_grown_or_was_cleared_is_a_new_map():
    grid, scan = OccupancyGrid(CELL_M, RANGE_MAX_M, 90), np.full((1, 90), 2.0)
    grid.integrate(np.zeros((1, 3)), scan)
    first = grid.snapshot()
    grid.integrate(np.array([[30.0, 0.0, 0.0]]), scan)
    assert grid.snapshot() is not first
    second = grid.snapshot()
    grid.clear()
    grid.integrate(np.zeros((1, 3)), scan)
    assert grid.snapshot() is not second


def test_scans_that_end_at_the_border_are_kept_when_the_grid_grows_elsewhere():
    random, scans = np.random.default_rng(0), np.full((2, 90), 2.0)
    for _ in range(30):
        grid = OccupancyGrid(CELL_M, RANGE_MAX_M, 90)
        grid.integrate(random.uniform(-5, 5, (1, 3)), scans[:1])
        before = grid.snapshot()
        rows, columns = before.log_odds.shape
        right_m, middle_m = before.origin_m[0] + columns * CELL_M, before.origin_m[1] + rows * CELL_M / 2
        pose = (np.nextafter(right_m - 2.0, -np.inf), middle_m, 0.0)
        grid.integrate(np.array([pose, (before.origin_m[0] - random.uniform(0, 30), middle_m, 0.0)]), scans)
        assert levels_at(grid.snapshot(), pose[:2]) < 0


@pytest.mark.parametrize("poses", [[(2**58.5 + 459 * 2**50, 0.0, 0.0)], [(0.0, 0.0, 0.0), (8e4, 5e4, 0.0)]])
def test_scans_too_far_away_for_a_grid_are_rejected(poses):
    """Cell coordinates are not exact there, or the grid would need 800 GB."""
    with pytest.raises(DataError, match=r"no grid of .* holds scans that reach .* units of odometry"):
        map_of(poses, [np.full(BEAMS, 9.0)] * len(poses))


@pytest.mark.parametrize("pose", [(np.nan, 0.0, 0.0), (0.0, np.inf, 0.0), (0.0, 0.0, np.nan)])
def test_the_error_of_invalid_poses_states_their_values(pose):
    with pytest.raises(DataError, match=r"must be finite; got \[.*(nan|inf)"):
        map_of([(0.0, 0.0, 0.0), pose], [np.full(BEAMS, 2.0)] * 2)
