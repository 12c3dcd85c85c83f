"""Intervals of means over few episodes."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike


def mean_interval(values: ArrayLike) -> tuple[float, float, float]:
    """Mean of values (k,) and its 95 % interval by Student's t; one value has no interval (NaN).

    A bootstrap over five values holds the mean of what they were drawn from in five cases of six only.
    """
    from scipy.stats import t  # slow to import

    values = np.asarray(values, float)
    mean = float(values.mean())
    if len(values) < 2:
        return mean, math.nan, math.nan
    half_width = float(t.ppf(0.975, len(values) - 1) * values.std(ddof=1)) / math.sqrt(len(values))
    return mean, mean - half_width, mean + half_width
