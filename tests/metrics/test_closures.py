import math

import numpy as np
import pytest

from twc_env.errors import DataError
from twc_env.metrics import closures_are_correct, score_closures

TRUE = np.array([1.0, 2.0, 3.1])


@pytest.mark.parametrize(
    ("error", "expected"),
    [
        ((0, 0, 0), True),
        ((0.3, 0.3, 0), True),
        ((0.4, 0.4, 0), False),
        ((0, 0, math.radians(9.9)), True),
        ((0, 0, math.radians(-10.1)), False),
    ],
)
def test_a_closure_is_correct_within_half_a_metre_and_ten_degrees(error, expected):
    assert bool(closures_are_correct(TRUE + error, TRUE)) is expected


def test_heading_errors_wrap_at_pi():
    assert closures_are_correct([0, 0, math.pi - 0.05], [0, 0, -math.pi + 0.05])


def test_precision_and_recall_follow_their_definitions():
    score = score_closures([True, True, True, False, False], [True, True, False, True, False])
    assert (score.proposed, score.accepted, score.correct) == (5, 3, 2)
    assert score.precision == pytest.approx(2 / 3)
    assert score.recall == pytest.approx(2 / 3)


def test_precision_and_recall_without_closures_are_nan():
    score = score_closures([], [])
    assert score.proposed == 0
    assert math.isnan(score.precision) and math.isnan(score.recall)


def test_arrays_of_unequal_shape_are_rejected():
    with pytest.raises(DataError, match="as many true answers"):
        score_closures([True, False], [True])
    with pytest.raises(DataError, match="as many measured"):
        closures_are_correct(np.zeros((3, 3)), np.zeros((1, 3)))
    with pytest.raises(DataError, match="as many measured"):
        closures_are_correct([0.0, 0.0], [0.0, 0.0])
