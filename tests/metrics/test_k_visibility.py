import numpy as np
import pytest

from twc_env.metrics.k_visibility import (
    FREE,
    UNKNOWN,
    WALL,
    calibration_error,
    reliability,
    score_structure,
    walls_crossed_in_raster,
)


def test_unknown_cells_lower_the_coverage_but_not_the_free_iou():
    truth = np.full((10, 10), FREE, np.uint8)
    truth[:, 5] = WALL
    estimate = np.full((10, 10), UNKNOWN, np.uint8)
    estimate[:, :5] = FREE
    score = score_structure(estimate, truth)
    assert score.iou_free == 1.0
    assert score.coverage == 0.5
    assert score_structure(truth, truth).iou_wall == 1.0
    assert score_structure(truth, truth).mse == 0.0


def test_a_wall_estimated_as_free_lowers_the_free_iou():
    truth = np.full((10, 10), FREE, np.uint8)
    truth[:, 5] = WALL
    score = score_structure(np.full((10, 10), FREE, np.uint8), truth)
    assert score.iou_free == pytest.approx(0.9)
    assert score.brier == pytest.approx(0.1)


def test_calibrated_probabilities_have_no_calibration_error():
    probability, is_wall = np.full(100, 0.25), np.arange(100) % 4 == 0
    assert calibration_error(probability, is_wall) == pytest.approx(0.0)
    assert calibration_error(np.full(100, 0.95), is_wall) == pytest.approx(0.7)
    assert reliability(probability, is_wall)[2].sum() == 100


def test_a_wall_of_cells_that_touch_at_corners_lets_no_line_through():
    wall = np.eye(60, dtype=bool)[:, ::-1]
    targets = np.concatenate([np.random.default_rng(0).uniform(40.0, 59.0, (2000, 2)), [(54.5, 56.5), (55.0, 55.0)]])
    for start in [(5.3, 7.9), (4.5, 6.5), (5.0, 5.0)]:
        assert (walls_crossed_in_raster(wall, start, targets) == 1).all()


@pytest.mark.parametrize("gap_cells", [0.0, 3.0])
def test_walls_crossed_are_the_stretches_of_the_line_inside_wall_cells(gap_cells):
    random = np.random.default_rng(1)
    wall = random.random((30, 40)) < 0.06
    wall[12, :25] = wall[4:26, 31] = True
    targets = random.uniform((-3.0, -3.0), (33.0, 43.0), (1500, 2))
    start, expected = np.array([2.3, 3.7]), []
    corners = np.argwhere(wall)
    for target in targets:
        ends = (np.stack([corners, corners + 1]) - start) / (target - start)  # shares of the line, by slabs
        first, last = ends.min(axis=0).max(axis=1), ends.max(axis=0).min(axis=1)
        first, last = np.maximum(first, 0.0), np.minimum(last, 1.0)
        length, walls, left = np.linalg.norm(target - start), 0, -np.inf
        for a, b in sorted(zip(first[first < last], last[first < last], strict=True)):
            walls += (a - left) * length > 1e-9 and (a - left) * length >= gap_cells
            left = max(left, b)
        expected.append(walls)
    assert walls_crossed_in_raster(wall, start, targets, gap_cells).tolist() == expected
