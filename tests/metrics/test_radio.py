import numpy as np
import pytest

from twc_env.metrics.radio import (
    cosine_similarity,
    detection_rates,
    distance_at_similarity,
    fit_path_loss,
    mean_rssi_by_walls,
    spread_at_points,
)


def test_the_fit_recovers_exponent_wall_loss_and_residual():
    random = np.random.default_rng(0)
    distance, walls = random.uniform(1, 40, 4000), random.integers(0, 4, 4000)
    rssi = -38.0 - 27.0 * np.log10(distance) - 5.5 * walls + random.normal(0, 4.0, 4000)
    fit = fit_path_loss(distance, rssi, walls)
    assert fit.power_at_1m_dbm == pytest.approx(-38.0, abs=1.0)
    assert fit.exponent == pytest.approx(2.7, abs=0.1)
    assert fit.wall_loss_db == pytest.approx(5.5, abs=0.2)
    assert fit.residual_std_db == pytest.approx(4.0, rel=0.05)
    assert np.isnan(fit_path_loss(distance, rssi).wall_loss_db)


def test_detection_rates_are_shares_per_distance_band():
    rates = detection_rates(np.array([1, 2, 12, 13, 14, 99]), np.array([1, 0, 1, 1, 0, 1]), np.array([0, 10, 20, 30]))
    assert rates[:2] == pytest.approx([0.5, 2 / 3])
    assert np.isnan(rates[2])


def test_spread_at_points_ignores_rarely_heard_transmitters():
    rssi = np.array([[-50.0, -70.0], [-54.0, np.nan], [-60.0, np.nan], [-60.0, np.nan]])
    assert spread_at_points(np.array([0, 0, 1, 1]), rssi, 2) == pytest.approx((np.sqrt(8.0) + 0.0) / 2)


def test_mean_rssi_is_grouped_by_number_of_walls():
    means = mean_rssi_by_walls(np.array([0, 0, 1]), np.array([-50.0, -52.0, -60.0]), 2)
    assert means[:2].tolist() == [-51.0, -60.0]
    assert np.isnan(means[2])


def test_cosine_is_one_for_equal_zero_for_disjoint_and_invariant_to_scale():
    rssi = np.array([[-50.0, -60.0, np.nan], [-75.0, -80.0, np.nan], [np.nan, np.nan, -40.0]])
    similarity = cosine_similarity(rssi)
    assert np.diag(similarity) == pytest.approx(1.0)
    assert similarity[0, 1] == pytest.approx(1.0)
    assert similarity[0, 2] == 0.0
    assert np.array_equal(similarity, similarity.T)


def test_distance_at_similarity_takes_the_pairs_of_the_bin():
    position = np.column_stack([np.arange(20.0), np.zeros(20)])
    gap = np.abs(position[:, None, 0] - position[None, :, 0])
    similarity = np.where(gap == 3, 0.8, 0.2)
    mean, std = distance_at_similarity(position, similarity, np.ones((20, 20), bool), 0.8)
    assert (mean, std) == (3.0, 0.0)
    assert np.isnan(distance_at_similarity(position, similarity, np.ones((20, 20), bool), 0.5)).all()


def test_pairs_half_a_width_from_a_similarity_count_and_no_further_ones():
    position = np.column_stack([np.arange(21.0), np.zeros(21)])
    similarity = np.full((21, 21), 0.84)
    similarity[0] = 0.82
    mean, std = distance_at_similarity(position, similarity, np.ones((21, 21), bool), 0.8, 0.05)
    assert (mean, std) == pytest.approx((10.5, np.arange(1.0, 21.0).std()))
