"""Scores of teams over many buildings: aggregates with bootstrap intervals (Agarwal et al. 2021, "Deep reinforcement
learning at the edge of the statistical precipice").

A stratum holds one value per building of one task; tasks are the strata of the bootstrap.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray as Array

RESAMPLES = 2000
CONFIDENCE = 0.95
TRIMMED = 0.25
"""Share of the values left out at each end by the interquartile mean."""
_AT_ONCE = 50
"""Resamples drawn together, which bounds the memory."""
Strata = Sequence[Array]
"""One array (buildings,) per task."""


def area_under_curve(curve: Array, count: int) -> float:
    """Mean of a curve (k,) of coverage over the `count` evaluations of a whole episode.

    An episode that ended earlier keeps its last value.
    """
    return float(padded(curve, count).mean())


def padded(curve: Array, count: int) -> Array:
    """(count,) the curve, continued by its last value; an empty one is 0 throughout."""
    last = curve[-1] if len(curve) else 0.0
    return np.concatenate([curve[:count], np.full(max(count - len(curve), 0), last)])


def time_to(curve: Array, share: float, period_s: float) -> float:
    """Simulated time [s] at which a curve (k,), evaluated every `period_s`, first reaches a share; inf if never."""
    reached = np.flatnonzero(np.asarray(curve) >= share)
    return (int(reached[0]) + 1) * period_s if len(reached) else math.inf


def normalised(values: Array, random: float, informed: float) -> Array:
    """Values on the scale on which the random team has 0 and the informed one 1.

    NaN if the informed team is not better than the random one.
    """
    return (values - random) / (informed - random) if informed > random else np.full_like(values, np.nan)


def interquartile_mean(values: Array, axis: int = -1) -> Array:
    """Mean of the middle half: of n sorted values, int(n / 4) are left out at each end."""
    from scipy.stats import trim_mean  # slow to import

    return trim_mean(values, TRIMMED, axis=axis)


def iqm_interval(strata: Strata) -> tuple[float, float]:
    """95 % interval of the interquartile mean over all values; (nan, nan) if a task has fewer than two buildings.

    Percentile bootstrap, stratified: each task's buildings are drawn again with replacement.
    """
    return _interval(strata, lambda *samples, axis=-1: interquartile_mean(np.concatenate(samples, axis=axis), axis))


def mean_interval(curves: Array) -> tuple[Array, Array]:
    """95 % interval (k,), (k,) of the mean of curves (buildings, k) over buildings, point by point.

    NaN for fewer than two buildings.
    """
    if len(curves) < 2:
        return np.full(curves.shape[1], np.nan), np.full(curves.shape[1], np.nan)
    low, high = _bootstrap((curves,), lambda sample, axis=0: sample.mean(axis=axis), axis=0)
    return low, high


def probability_of_improvement(mine: Strata, other: Strata) -> float:
    """Probability that a team scores higher than another in the same building, averaged over tasks; ties count half.

    Both have the same buildings in the same order. Agarwal et al. compare every run of one with every run of the other;
    here the two play the same building from the same starts, so that only these pairs are compared.
    """
    shares = [np.mean((a > b) + 0.5 * (a == b)) for a, b in zip(mine, other, strict=True)]
    return float(np.mean(shares))


def performance_profile(strata: Strata, thresholds: Array) -> Array:
    """(thresholds,) share of the episodes that score above each threshold, averaged over tasks."""
    return _mean_of_means(*_is_above(strata, thresholds))


def profile_interval(strata: Strata, thresholds: Array) -> tuple[Array, Array]:
    """95 % interval (thresholds,), (thresholds,) of a performance profile, point by point; NaN as `iqm_interval`."""
    if min(map(len, strata), default=0) < 2:
        return np.full(len(thresholds), np.nan), np.full(len(thresholds), np.nan)
    return _bootstrap(_is_above(strata, thresholds), _mean_of_means, axis=0)


def _is_above(strata: Strata, thresholds: Array) -> tuple[Array, ...]:
    """For each task (buildings, thresholds): 1 where a score is above a threshold."""
    return tuple((np.asarray(values)[:, None] > thresholds).astype(float) for values in strata)


def _mean_of_means(*samples: Array, axis: int = 0) -> Array:
    return np.mean([sample.mean(axis=axis) for sample in samples], axis=0)


def _interval(strata: Strata, statistic: Callable[..., Array]) -> tuple[float, float]:
    if min(map(len, strata), default=0) < 2:
        return math.nan, math.nan
    low, high = _bootstrap(tuple(strata), statistic, axis=-1)
    return float(low), float(high)


def _bootstrap(samples: tuple[Array, ...], statistic: Callable[..., Array], axis: int) -> tuple[Array, Array]:
    from scipy.stats import bootstrap  # slow to import

    found = bootstrap(
        samples, statistic, axis=axis, n_resamples=RESAMPLES, batch=_AT_ONCE, vectorized=True, method="percentile",
        confidence_level=CONFIDENCE, random_state=np.random.default_rng(0),
    )  # fmt: skip
    return found.confidence_interval.low, found.confidence_interval.high
