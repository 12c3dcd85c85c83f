"""Scores of teams against values worked out by hand."""

import itertools
import math

import numpy as np
import pytest

from twc_env.metrics import team_scores as scores


def test_the_area_under_a_curve_keeps_the_last_value_of_an_episode_that_ended():
    assert scores.area_under_curve(np.array([0.2, 0.4, 0.9]), 3) == pytest.approx(0.5)
    assert scores.area_under_curve(np.array([0.2, 0.4, 0.9]), 5) == pytest.approx((0.2 + 0.4 + 3 * 0.9) / 5)
    assert scores.area_under_curve(np.array([0.2, 0.4, 0.9]), 2) == pytest.approx(0.3)
    assert scores.area_under_curve(np.array([]), 4) == 0.0


def test_the_time_to_a_share_is_that_of_the_first_evaluation_that_reaches_it():
    curve = np.array([0.1, 0.5, 0.4, 0.9])
    assert [scores.time_to(curve, share, 2.0) for share in (0.1, 0.5, 0.6, 0.9)] == [2.0, 4.0, 8.0, 8.0]
    assert scores.time_to(curve, 0.91, 2.0) == math.inf
    assert scores.time_to(np.array([]), 0.5, 2.0) == math.inf


def test_the_random_team_scores_0_and_the_informed_one_1():
    assert scores.normalised(np.array([0.2, 0.5, 0.8, 0.95]), 0.2, 0.8) == pytest.approx([0.0, 0.5, 1.0, 1.25])
    assert np.isnan(scores.normalised(np.array([0.5]), 0.5, 0.5)).all()


def test_the_interquartile_mean_leaves_out_a_quarter_at_each_end():
    assert scores.interquartile_mean(np.array([0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 100.0])) == pytest.approx(3.5)
    assert scores.interquartile_mean(np.array([9.0, 1.0, 2.0])) == pytest.approx(4.0), "of three none is left out"
    assert scores.interquartile_mean(np.array([-50.0, 1.0, 2.0, 90.0])) == pytest.approx(1.5)


def test_the_interval_is_that_of_all_resamples_of_two_buildings():
    # Of [0, 1] the means 0, 0.5, 1 have probabilities 1/4, 1/2, 1/4: the 2.5 % quantile is 0, the 97.5 % quantile 1.
    assert scores.iqm_interval([np.array([0.0, 1.0])]) == (0.0, 1.0)
    assert scores.iqm_interval([np.array([0.3, 0.3, 0.3])]) == pytest.approx((0.3, 0.3))
    assert all(map(math.isnan, scores.iqm_interval([np.array([0.0, 1.0]), np.array([0.5])])))


def test_the_bootstrap_draws_within_tasks_only():
    # Across the two tasks the values differ greatly, within them not at all: a bootstrap over everything would spread.
    strata = [np.zeros(10), np.ones(10)]
    assert scores.iqm_interval(strata) == pytest.approx((0.5, 0.5))


def test_the_interval_agrees_with_an_enumeration_of_all_resamples():
    values = np.array([0.1, 0.2, 0.4, 0.9])
    means = [scores.interquartile_mean(np.array(draw)) for draw in itertools.product(values, repeat=4)]
    low, high = np.quantile(means, [0.025, 0.975])
    assert scores.iqm_interval([values]) == pytest.approx((low, high), abs=0.03)


def test_the_band_of_the_mean_curve_is_found_point_by_point():
    curves = np.array([[0.0, 0.2, 0.5], [1.0, 0.2, 0.7]])
    low, high = scores.mean_interval(curves)
    assert low == pytest.approx([0.0, 0.2, 0.5]) and high == pytest.approx([1.0, 0.2, 0.7])
    assert np.isnan(scores.mean_interval(curves[:1])).all()


def test_the_band_holds_the_mean_and_shrinks_with_the_number_of_episodes():
    draws = np.random.default_rng(1).normal(0.5, 0.1, (400, 3))
    widths = []
    for count in (25, 400):
        low, high = scores.mean_interval(draws[:count])
        mean = draws[:count].mean(axis=0)
        assert (low < mean).all() and (mean < high).all()
        widths.append((high - low).mean())
        assert widths[-1] == pytest.approx(2 * 1.96 * 0.1 / np.sqrt(count), rel=0.25)
    assert widths[1] < 0.35 * widths[0]


def test_the_probability_of_improvement_counts_buildings_and_half_of_the_ties():
    mine = [np.array([0.5, 0.6, 0.7, 0.8]), np.array([0.1, 0.1])]
    other = [np.array([0.4, 0.6, 0.9, 0.1]), np.array([0.2, 0.3])]
    assert scores.probability_of_improvement(mine, other) == pytest.approx((2.5 / 4 + 0.0) / 2)
    assert scores.probability_of_improvement(other, mine) == pytest.approx(1.0 - 2.5 / 8)
    assert scores.probability_of_improvement(mine, mine) == 0.5


def test_the_profile_is_the_share_of_episodes_above_each_threshold():
    strata = [np.array([0.2, 0.4, 0.6, 0.8]), np.array([0.9, 0.95])]
    found = scores.performance_profile(strata, np.array([0.0, 0.4, 0.85, 0.95]))
    assert found == pytest.approx([1.0, (0.5 + 1.0) / 2, (0.0 + 1.0) / 2, 0.0])


def test_the_interval_of_a_profile_is_wide_only_where_episodes_differ():
    low, high = scores.profile_interval([np.array([0.2, 0.8])], np.array([0.1, 0.5, 0.9]))
    assert low == pytest.approx([1.0, 0.0, 0.0]) and high == pytest.approx([1.0, 1.0, 0.0])
    assert np.isnan(scores.profile_interval([np.array([0.2])], np.array([0.1]))).all()
