import numpy as np
import pytest

from twc_env.metrics.k_visibility import FREE, UNKNOWN, WALL, calibration_error, reliability, score_structure


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
