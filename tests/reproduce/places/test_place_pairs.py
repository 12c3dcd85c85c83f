import math

import numpy as np
import pytest

from twc_env.reproduce.places.place_pairs import (
    Counts,
    Pairs,
    all_pairs,
    average_precision,
    best_match,
    precision_recall_curve,
    recall_at_full_precision,
)


@pytest.fixture
def pairs():
    """Two places of robot 0 (0, 1) against two of robot 1 (2, 3); 0-2 and 1-3 are the same."""
    first, second = np.array([0, 0, 1, 1]), np.array([2, 3, 2, 3])
    return Pairs(first, second, np.tile([0, 1], (4, 1)), np.array([True, False, False, True]))


def test_every_accepted_pair_counts(pairs):
    counts = all_pairs(np.array([True, True, False, False]), pairs)
    assert (counts.accepted, counts.right, counts.true) == (2, 1, 2)
    assert counts.precision == 0.5 and counts.recall == 0.5


def test_only_the_best_match_of_each_place_counts(pairs):
    score = np.array([0.9, 0.5, 0.6, 0.8])
    assert all_pairs(np.ones(4, bool), pairs).precision == 0.5
    counts = best_match(np.ones(4, bool), score, pairs)
    assert (counts.accepted, counts.right, counts.true) == (4, 4, 4)


def test_the_best_match_is_among_the_accepted_only(pairs):
    counts = best_match(np.array([False, True, False, False]), np.array([0.9, 0.5, 0.6, 0.8]), pairs)
    assert (counts.accepted, counts.right) == (2, 0)


def test_nothing_accepted_has_no_precision():
    assert math.isnan(Counts(0, 0, 3).precision) and Counts(0, 0, 3).recall == 0.0
    assert math.isnan(Counts(0, 0, 0).recall)


def test_average_precision_of_known_rankings():
    truth = np.array([True, False, True, False])
    assert average_precision(np.array([4.0, 3.0, 2.0, 1.0]), truth) == pytest.approx((1 + 2 / 3) / 2)
    assert average_precision(np.array([4.0, 1.0, 3.0, 2.0]), truth) == 1.0
    assert average_precision(np.ones(4), truth) == 0.5


def test_recall_at_full_precision_stops_before_the_first_wrong_pair():
    truth = np.array([True, True, False, True])
    assert recall_at_full_precision(np.array([4.0, 3.0, 2.0, 1.0]), truth) == pytest.approx(2 / 3)
    assert recall_at_full_precision(np.array([4.0, 3.0, 4.0, 1.0]), truth) == 0.0


def test_of_no_pairs_there_is_no_curve():
    precision, recall = precision_recall_curve(np.zeros(0), np.zeros(0, bool))
    assert len(precision) == len(recall) == 0
    assert np.isnan(average_precision(np.zeros(0), np.zeros(0, bool)))
