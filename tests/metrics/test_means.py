import math

import numpy as np
import pytest

from twc_env.metrics.means import mean_interval


def test_the_interval_holds_the_mean_in_95_of_100_cases_also_with_few_values():
    random, held = np.random.default_rng(0), {}
    for count in (2, 5, 20):
        intervals = np.array([mean_interval(random.normal(3.0, 2.0, count)) for _ in range(4000)])
        held[count] = float(((intervals[:, 1] <= 3.0) & (intervals[:, 2] >= 3.0)).mean())
    assert held == pytest.approx(dict.fromkeys(held, 0.95), abs=0.015)


def test_one_value_has_no_interval():
    mean, low, high = mean_interval([2.5])
    assert mean == 2.5 and math.isnan(low) and math.isnan(high)


def test_a_bootstrap_over_five_values_holds_the_mean_in_five_of_six_cases():
    """Why it is not used."""
    random, held = np.random.default_rng(0), 0
    for _ in range(1000):
        values = random.normal(3.0, 2.0, 5)
        low, high = np.quantile(values[random.integers(0, 5, (400, 5))].mean(axis=1), [0.025, 0.975])
        held += low <= 3.0 <= high
    assert held / 1000 == pytest.approx(5 / 6, abs=0.03)
