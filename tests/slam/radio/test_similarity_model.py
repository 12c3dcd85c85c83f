import logging

import numpy as np
import pytest

from twc_env.errors import DataError
from twc_env.slam.radio.similarity_model import train, train_on_path, warn_cut_off


def test_the_repaired_formula_averages_distances_and_the_printed_one_their_squares():
    similarity, distance = np.full(20, 0.8), np.tile([2.0, 4.0], 10)
    mean, variance = train(similarity, distance, 60.0).distance(np.array([0.8]))
    assert (mean[0], variance[0]) == pytest.approx((3.0, 1.0))
    mean, variance = train(similarity, distance, 60.0, formula="paper").distance(np.array([0.8]))
    assert (mean[0], variance[0]) == pytest.approx((10.0, ((2 - 10) ** 2 + (4 - 10) ** 2) / 2))


def test_bins_with_few_samples_are_ignored_and_values_beyond_the_ends_are_clamped():
    similarity = np.concatenate([np.full(20, 0.5), np.full(20, 0.9), np.full(3, 0.2)])
    distance = np.concatenate([np.full(20, 8.0), np.full(20, 2.0), np.full(3, 50.0)])
    model = train(similarity, distance, 60.0)
    mean, variance = model.distance(np.array([0.0, 0.5, 0.7, 0.9, 1.0]))
    assert mean == pytest.approx([8.0, 8.0, 5.0, 2.0, 2.0])
    assert (variance >= 0.25).all()


def test_a_window_that_truncates_distances_is_reported_once(caplog):
    warn_cut_off.cache_clear()
    random = np.random.default_rng(0)
    travel = np.arange(0.0, 300.0, 1.0)
    positions = np.column_stack([travel, np.zeros(300)])
    similarity = np.exp(-np.abs(travel[:, None] - travel[None]) / 60.0) + random.normal(0, 0.02, (300, 300))
    assert train_on_path(similarity, travel, positions, 0.7).window_m == 100.0
    with caplog.at_level(logging.WARNING):
        for _ in range(2):
            assert train_on_path(similarity, travel, positions, 0.3, window_m=30.0).is_truncated(0.3)
    assert caplog.text.count("truncated") == 1


def test_a_model_without_bins_is_not_reported_as_truncated(caplog):
    warn_cut_off.cache_clear()
    travel = np.arange(3.0)
    with caplog.at_level(logging.WARNING):
        model = train_on_path(np.full((3, 3), 0.9), travel, np.column_stack([travel, travel]), 0.7)
    assert not len(model.centre) and "truncated" not in caplog.text


@pytest.mark.parametrize("distance_m", [np.r_[np.ones(49), np.nan], np.ones(10)])
def test_training_pairs_without_a_distance_are_refused(distance_m):
    with pytest.raises(DataError, match="a finite similarity and distance each"):
        train(np.full(50, 0.5), distance_m, 60.0)
