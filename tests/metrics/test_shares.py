"""Intervals of shares, against the binomial distribution and the rule of three."""

import pytest
from scipy.stats import binom

from twc_env.errors import DataError
from twc_env.metrics.shares import share_interval


@pytest.mark.parametrize(("count", "of"), [(1, 10), (3, 8), (85, 100), (9, 10)])
def test_each_end_would_give_the_count_or_more_extreme_ones_in_a_fortieth_of_all_samples(count, of):
    low, high = share_interval(count, of)
    assert binom.sf(count - 1, of, low) == pytest.approx(0.025)
    assert binom.cdf(count, of, high) == pytest.approx(0.025)


@pytest.mark.parametrize("of", [30, 100, 1000])
def test_none_of_n_leaves_about_three_in_n(of):
    assert share_interval(0, of) == (0.0, pytest.approx(3 / of, rel=0.06))
    assert share_interval(of, of)[0] == pytest.approx(1 - share_interval(0, of)[1])


@pytest.mark.parametrize(("count", "of"), [(-1, 4), (5, 4), (0, 0)])
def test_shares_of_nothing_are_refused(count, of):
    with pytest.raises(DataError, match="one case or more"):
        share_interval(count, of)
