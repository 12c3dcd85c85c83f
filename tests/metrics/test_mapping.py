import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from twc_env.errors import DataError
from twc_env.metrics import mapping
from twc_env.records import geometry

ORIGIN_M = np.array([0.0, 0.0])
FREE, WALL = -50, 50


def room(rows: int = 12, columns: int = 16) -> tuple[np.ndarray, np.ndarray]:
    """A closed room with walls one cell thick: (free, wall)."""
    wall = np.zeros((rows, columns), bool)
    wall[[0, -1], :] = wall[:, [0, -1]] = True
    return ~wall, wall


def drawn(free: np.ndarray, wall: np.ndarray) -> np.ndarray:
    return (FREE * free + WALL * wall).astype(np.int16)


def score(log_odds, free, wall, pose=(0.0, 0.0, 0.0), origin=ORIGIN_M, resolution=0.1):
    return mapping.score_map(log_odds, origin, resolution, np.array(pose, float), free, wall, ORIGIN_M, 0.1)


def test_a_perfect_map_scores_one():
    free, wall = room()
    result = score(drawn(free, wall), free, wall)
    assert (result.coverage_correct, result.map_iou, result.wall_iou) == (1.0, 1.0, 1.0)
    assert result.correct_area_m2 == pytest.approx(result.believed_area_m2) == pytest.approx(10 * 14 * 0.01)


@pytest.mark.parametrize("shape", [(5, 5), (0, 0)])
def test_an_empty_map_scores_zero(shape):
    free, wall = room()
    result = score(np.zeros(shape, np.int16), free, wall)
    assert (result.correct_area_m2, result.coverage_correct, result.map_iou, result.wall_iou) == (0, 0, 0, 0)


def test_half_a_room_is_half_covered():
    free, wall = room()
    seen = free.copy()
    seen[:, 8:] = False
    result = score(drawn(seen, wall), free, wall)
    assert result.coverage_correct == pytest.approx(0.5)
    assert result.map_iou == pytest.approx(0.5)


def test_free_space_beyond_the_building_lowers_the_iou_but_not_the_coverage():
    free, wall = room()
    log_odds = np.full((12, 32), FREE, np.int16)
    log_odds[:, :16] = drawn(free, wall)
    result = score(log_odds, free, wall)
    assert result.coverage_correct == 1.0
    assert result.map_iou == pytest.approx(140 / (140 + 12 * 16))


def test_a_wall_one_cell_off_matches_and_two_cells_off_does_not():
    free, wall = room()
    assert score(drawn(free, wall), free, wall, origin=np.array([0.1, 0.0])).wall_iou == 1.0
    only_left, elsewhere = np.zeros_like(wall), np.zeros_like(wall)
    only_left[:, 0] = elsewhere[:, 2] = True
    assert score(drawn(0 * free, elsewhere), free, only_left).wall_iou == 0.0


def test_a_map_in_a_rotated_frame_scores_one_with_the_correct_alignment():
    free, wall = room(40, 40)
    turned = drawn(free, wall)[:, ::-1].T  # x of the map frame points along y of the building
    pose_building_map = (0.0, 4.0, -np.pi / 2)
    assert score(turned, free, wall, pose_building_map).map_iou == pytest.approx(1.0)
    assert score(turned, free, wall, (0.0, 4.0, np.pi / 2)).map_iou == 0.0


def test_a_map_of_finer_cells_covers_the_same_area():
    free, wall = room()
    fine = np.repeat(np.repeat(drawn(free, wall), 2, axis=0), 2, axis=1)
    result = score(fine, free, wall, resolution=0.05)
    assert result.map_iou == 1.0
    assert result.believed_area_m2 == pytest.approx(1.4)


@settings(max_examples=40)
@given(st.integers(-200, 200), st.integers(-200, 200), st.floats(-3, 3), st.integers(0, 1000))
def test_the_score_does_not_depend_on_the_map_frame(x_cm, y_cm, heading, seed):
    rng = np.random.default_rng(seed)
    free, wall = room(20, 20)
    log_odds = (drawn(free, wall) * (rng.random((20, 20)) < 0.8)).astype(np.int16)
    alignment = np.array([x_cm / 100 + 0.003, y_cm / 100 + 0.003, heading])  # no centre lies on a border of cells
    shift_m = np.array([3.0, -7.0])  # the map frame moves by whole cells of the same grid
    moved = geometry.compose(alignment, np.array([*(-shift_m), 0.0]))
    before, after = score(log_odds, free, wall, alignment), score(log_odds, free, wall, moved, origin=shift_m)
    assert after.correct_area_m2 == pytest.approx(before.correct_area_m2, abs=0.02)
    assert after.map_iou == pytest.approx(before.map_iou, abs=0.02)
    assert after.wall_iou == pytest.approx(before.wall_iou, abs=0.05)


@settings(max_examples=40)
@given(st.integers(-200, 200), st.integers(-200, 200), st.floats(-3, 3), st.integers(0, 1000))
def test_shares_lie_between_zero_and_one_and_match_a_plain_loop(x_cm, y_cm, heading, seed):
    rng = np.random.default_rng(seed)
    free, wall = room(15, 18)
    log_odds = rng.integers(-2, 3, (13, 21)).astype(np.int16)
    pose = np.array([x_cm / 100 + 0.003, y_cm / 100 + 0.003, heading])  # no centre lies on a border of cells
    result = score(log_odds, free, wall, pose)
    assert 0 <= result.map_iou <= 1 and 0 <= result.wall_iou <= 1 and 0 <= result.coverage_correct <= 1
    cells = np.argwhere(free)
    centres = geometry.transform_points(geometry.inverse(pose), (cells[:, ::-1] + 0.5) * 0.1)
    rows_columns = np.floor(centres[:, ::-1] / 0.1).astype(int)
    inside = ((rows_columns >= 0) & (rows_columns < log_odds.shape)).all(axis=1)
    expected = sum(log_odds[r, c] < 0 for r, c in rows_columns[inside]) * 0.01
    assert result.correct_area_m2 == pytest.approx(expected, abs=0.011)
    alone = mapping.correct_area_m2(log_odds, ORIGIN_M, 0.1, pose, free, ORIGIN_M, 0.1)
    assert alone == result.correct_area_m2


@settings(max_examples=20)
@given(st.integers(0, 10_000))
def test_the_area_under_a_mask_of_the_floor_is_the_area_counted_on_the_floor(seed):
    random = np.random.default_rng(seed)
    free = np.zeros((150, 200), bool)
    free[10:140, 10:190] = True
    free[60:64, 10:150] = False
    log_odds = np.zeros((180, 170), np.int16)
    log_odds[20:150, 15 : int(random.integers(60, 160))] = FREE
    log_odds[40:50, 30:40] = WALL
    pose, origin = random.uniform((-3, -3, -3), (12, 10, 3)), random.uniform(-5, 2, 2)
    counted = mapping.correct_area_m2(log_odds, origin, 0.1, pose, free, ORIGIN_M, 0.1)
    mask = mapping.floor_mask(log_odds.shape, origin, 0.1, pose, free, ORIGIN_M, 0.1)
    assert 0.01 * np.count_nonzero(mask & (log_odds < 0)) == pytest.approx(counted, abs=0.6)


@settings(max_examples=30)
@given(st.integers(0, 10_000))
def test_recounting_only_touched_blocks_gives_the_full_count(seed):
    random = np.random.default_rng(seed)
    shape = tuple(random.integers(1, 200, 2))
    log_odds, mask = random.integers(-60, 80, shape).astype(np.int16), random.random(shape) < 0.7
    touched = np.zeros(tuple(-(-np.array(shape) // mapping.BLOCK_SHAPE)), np.int64)
    known, counts = np.full(touched.shape, -1), np.zeros(touched.shape, np.int64)
    for number in range(1, 6):
        assert mapping.recount_free(log_odds, mask, touched, known, counts) == np.count_nonzero(mask & (log_odds < 0))
        for row, column in random.integers(0, shape, (5, 2)):
            log_odds[row, column] *= -1
            touched[row // mapping.BLOCK_ROWS, column // mapping.BLOCK_COLUMNS] = number


def test_untouched_blocks_are_not_recounted():
    log_odds, mask = np.full((40, 200), -1, np.int16), np.ones((40, 200), bool)
    touched = np.zeros((3, 4), np.int64)
    known, counts = np.full(touched.shape, -1), np.zeros(touched.shape, np.int64)
    assert mapping.recount_free(log_odds, mask, touched, known, counts) == 8000
    log_odds[:] = 0
    touched[1, 2] = 1
    assert mapping.recount_free(log_odds, mask, touched, known, counts) == 8000 - 16 * 64


class Odd:
    """Of another library."""

    def __array__(self, *_, **__):
        raise RuntimeError("no array")


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"pose_building_map": np.full(3, np.nan)}, "must lie in one place"),
        ({"pose_building_map": np.array([1e14, 0.0, 0.0])}, "must lie in one place"),
        ({"pose_building_map": np.zeros(2)}, r"a pose \(3,\)"),
        ({"origin_m": np.zeros(1)}, r"origin_m must be a corner"),
        ({"truth_origin_m": 0.0}, r"truth_origin_m must be a corner"),
        ({"resolution_m": 0.0}, "a size above 0"),
        ({"truth_resolution_m": -0.1}, "a size above 0"),
        ({"log_odds": np.zeros(9, np.int16)}, "log_odds must be a grid"),
        ({"log_odds": [[1], [2, 3]]}, "log_odds must be a grid .rows, columns.: "),
        ({"log_odds": Odd()}, "log_odds must be a grid .rows, columns.: no array"),
        ({"truth_wall": np.zeros((3, 4), bool)}, "must have one shape"),
    ],
)
def test_maps_that_cannot_be_compared_are_rejected(changes, message):
    free, wall = room()
    parts = {
        "log_odds": drawn(free, wall), "origin_m": ORIGIN_M, "resolution_m": 0.1, "pose_building_map": np.zeros(3),
        "truth_free": free, "truth_wall": wall, "truth_origin_m": ORIGIN_M, "truth_resolution_m": 0.1,
    }  # fmt: skip
    with pytest.raises(DataError, match=message):
        mapping.score_map(**{**parts, **changes})
    if "truth_wall" not in changes:
        parts.pop("truth_wall")
        with pytest.raises(DataError, match=message):
            mapping.correct_area_m2(**{**parts, **changes})
