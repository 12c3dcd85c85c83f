"""Where the robots of another map are likely to have been, by the access points that both have heard.

Of each transmitter, the readings along one's own path give a likelihood of its position under log-distance path loss
(Rappaport, "Wireless communications", 2002, Eq. 4.69), with its power as an unknown of Gaussian prior; hence the
strength that is expected anywhere, with its variance. The other robots' fingerprints are compared with that (Bayesian
radio localisation as in Haeberlen et al., "Practical robust localization over large-scale 802.11 wireless networks",
MobiCom 2004, with the radio map extrapolated rather than surveyed). Extrapolation is coarse: a straight path leaves
transmitters undecided between both of its sides, so the result is a probability over cells, not a position.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.kernels.blas_threads import one_blas_thread
from twc_env.records.messages import Fingerprint, RadioTrail

PATH_LOSS_EXPONENT, POWER_AT_1M_DBM, POWER_STD_DB, SHADOWING_STD_DB = 3.85, -30.0, 4.0, 6.0
"""Path loss with walls: fitted to what is heard in the validation buildings 0 to 7 of ExploreQuick-v1."""
FLOOR_DBM = -88.0
"""Strength at which a transmitter is heard in half of the scans."""
READINGS = 20.0
"""Readings along a path share their shadowing: at most so many count as independent."""
MARGIN_M, CELLS_ACROSS, SPACING_M = 30.0, 20, 0.5
"""The cells reach this far beyond one's own path: a square of so many across, at a multiple of this spacing."""
PLACES_MAX = 40
"""Of a path, at most so many places are used, at even intervals."""


@dataclass(frozen=True, slots=True, eq=False)
class Whereabouts:
    """Probability of the places of another map's robots, over cells in one's own map frame."""

    cells_m: Array
    """(cells, 2)."""
    share: Array
    """(cells,) adds up to 1."""

    def distance_m(self, places_m: Array) -> Array:
        """(k,) expected distance from each of places_m (k, 2) to a place of theirs."""
        return _distances(places_m, self.cells_m) @ self.share


@one_blas_thread()
def whereabouts(own: RadioTrail, other: RadioTrail) -> Whereabouts | None:
    """Where the places of the other trail are, by what was heard along one's own; None if nothing was heard there, or
    nothing is known of the other yet."""
    mine, theirs = _evenly(len(own.fingerprints)), _evenly(len(other.fingerprints))
    heard = [own.fingerprints[k] for k in mine]
    macs = np.unique(np.concatenate([each.macs for each in heard])) if heard else np.zeros(0, np.int64)
    if not len(macs) or not len(theirs):
        return None
    cells_m, spacing_m = _lattice(own.places_m[mine])
    expected = _expected(own.places_m[mine], _readings(heard, macs), cells_m, spacing_m)
    likely = _log_likelihood(_readings([other.fingerprints[k] for k in theirs], macs), *expected)
    share = np.exp(likely - likely.max(axis=1, keepdims=True))
    share /= share.sum(axis=1, keepdims=True)
    return Whereabouts(cells_m, share.mean(axis=0))


def _evenly(count: int) -> Array:
    """At most PLACES_MAX of `count` indices."""
    return np.unique(np.linspace(0, count - 1, min(count, PLACES_MAX)).astype(int))


def _readings(fingerprints: Sequence[Fingerprint], macs: Array) -> Array:
    """(k, macs) RSSI; nan for transmitters that are not heard."""
    rssi_dbm = np.full((len(fingerprints), len(macs)), math.nan)
    for row, each in zip(rssi_dbm, fingerprints, strict=True):
        at = np.minimum(np.searchsorted(macs, each.macs), len(macs) - 1)
        is_known = macs[at] == each.macs
        row[at[is_known]] = each.rssi_dbm[is_known]
    return rssi_dbm


def _lattice(places_m: Array) -> tuple[Array, float]:
    """A square lattice around places (k, 2): its cells (cells, 2), and their spacing."""
    low, high = places_m.min(axis=0) - MARGIN_M, places_m.max(axis=0) + MARGIN_M
    spacing_m = SPACING_M * math.ceil(float((high - low).max()) / (CELLS_ACROSS - 1) / SPACING_M)
    steps = spacing_m * (np.arange(CELLS_ACROSS) - (CELLS_ACROSS - 1) / 2)
    return (low + high) / 2 + np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2), spacing_m


@lru_cache(maxsize=4)
def _losses_between(spacing_m: float) -> tuple[Array, Array]:
    """(cells, cells) path loss between the cells of a lattice, and its square."""
    numbers = np.arange(CELLS_ACROSS, dtype=float)
    cells_m = spacing_m * np.stack(np.meshgrid(numbers, numbers), axis=-1).reshape(-1, 2)
    losses = _losses_db(cells_m, cells_m)
    return losses, losses**2


def _distances(a_m: Array, b_m: Array) -> Array:
    """(a, b) distances between points."""
    return np.hypot(*(a_m[:, None] - b_m[None]).transpose(2, 0, 1))


def _losses_db(a_m: Array, b_m: Array) -> Array:
    """(a, b) path loss between points, over that at 1 m."""
    return 10.0 * PATH_LOSS_EXPONENT * np.log10(np.maximum(_distances(a_m, b_m), 1.0))


def _expected(places_m: Array, rssi_dbm: Array, cells_m: Array, spacing_m: float) -> tuple[Array, Array]:
    """Mean and variance (macs, cells) of the strength in each cell, by readings (k, macs) at places (k, 2)."""
    is_heard = np.isfinite(rssi_dbm)
    levels, losses = np.where(is_heard, rssi_dbm, 0.0), _losses_db(places_m, cells_m)
    count = is_heard.sum(axis=0)[:, None].astype(float)
    # Per transmitter and cell where it may stand: sums of its power by each reading, and of its square.
    powers = levels.sum(axis=0)[:, None] + is_heard.T @ losses
    squares = (levels**2).sum(axis=0)[:, None] + 2.0 * levels.T @ losses + is_heard.T @ losses**2
    weight = np.minimum(1.0, READINGS / np.maximum(count, 1.0)) / SHADOWING_STD_DB**2
    prior = 1.0 / POWER_STD_DB**2
    power = (weight * powers + POWER_AT_1M_DBM * prior) / (weight * count + prior)
    errors = weight * (squares - 2.0 * power * powers + count * power**2) + prior * (power - POWER_AT_1M_DBM) ** 2
    stands = np.exp(-0.5 * (errors - errors.min(axis=1, keepdims=True)))
    stands /= stands.sum(axis=1, keepdims=True)
    between, between_squared = _losses_between(spacing_m)
    mean = (stands * power).sum(axis=1)[:, None] - stands @ between
    square = (stands * power**2).sum(axis=1)[:, None] - 2.0 * (stands * power) @ between + stands @ between_squared
    return mean, np.maximum(square - mean**2, 0.0) + SHADOWING_STD_DB**2


def _log_likelihood(rssi_dbm: Array, mean: Array, variance: Array) -> Array:
    """(k, cells) of fingerprints (k, macs): Gaussian where a transmitter is heard, else the chance not to hear it."""
    is_heard, weight = np.isfinite(rssi_dbm), 1.0 / variance
    levels = np.where(is_heard, rssi_dbm, 0.0)
    errors = levels**2 @ weight - 2.0 * levels @ (mean * weight) + is_heard @ (mean**2 * weight + np.log(variance))
    silent = -np.logaddexp(0.0, 1.7 * (mean - FLOOR_DBM) / np.sqrt(variance))  # a logistic for the Gaussian integral
    likelihood: Array = -0.5 * errors + ~is_heard @ silent
    return likelihood
