"""Positions along a path at which the number of walls changes, to a single reading (papers.md K24d).

A wall map gives the sequence of wall counts and the approximate change points. The readings give the exact ones: RSSI
drops by a wall's loss from one reading to the next, while shadowing changes slowly. Model:

    rssi = expected - loss + shadowing + noise,

with shadowing a first-order Gauss-Markov process along the path. A Kalman filter gives the likelihood of each change
point.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.kernels.compiled import kernel

REACH_M = 0.3
"""Search range of a change point on either side of its current position."""
_AROUND_M = 0.4
"""Readings up to this far beyond the search range enter the likelihood."""
_MAP_ERROR_M = 0.05
"""Mean absolute error of the map's change points (Laplace prior)."""
_SWEEPS = 3
_SHADOWING_M = 0.5
"""Correlation length of the shadowing."""
_STD_MIN_DB = 0.5
_MEDIAN_STEP = 0.954
"""Median absolute difference of two readings with independent normal noise, in standard deviations of one reading."""


def refine_changes(walls: Array, loss_db: Array, excess_db: Array, travel_m: Array) -> Array:
    """(n,) wall counts with each change point moved to its most likely reading.

    walls (n,) and their summed loss (n,) according to the map; excess (n,): RSSI expected without walls minus the
    reading, NaN where not heard; travel (n,): path length up to each reading.
    """
    refined = np.array(walls, np.int64)
    residual_db = (excess_db - loss_db)[np.isfinite(excess_db)]
    if len(residual_db) < 2:
        return refined
    noise_db2 = max(float(np.median(np.abs(np.diff(residual_db)))) / _MEDIAN_STEP, _STD_MIN_DB) ** 2
    shadowing_db2 = max(float(np.var(residual_db)) - noise_db2, _STD_MIN_DB**2)
    readings = np.array(loss_db, float), np.asarray(excess_db, float), np.asarray(travel_m, float)
    _refine(refined, *readings, noise_db2, shadowing_db2)
    return refined


@kernel
def _refine(walls, loss, excess, travel, noise, shadowing):
    """Alternately move the change points and remove unsupported short runs, in place; noise and shadowing [dB2]."""
    map_travel = travel.copy()  # position according to the map of the change point before reading i
    for _ in range(_SWEEPS):
        _move_changes(walls, loss, map_travel, excess, travel, noise, shadowing)
        _drop_detours(walls, loss, excess, travel, noise, shadowing)


@kernel
def _move_changes(walls, loss, map_travel, excess, travel, noise, shadowing):
    """Coordinate ascent: move one change point at a time to its most probable position between its neighbours."""
    count, at = walls.shape[0], 1
    while at < count:
        if walls[at] == walls[at - 1]:
            at += 1
            continue
        first, last = at - 1, at
        while first > 0 and walls[first - 1] == walls[at - 1] and travel[at] - travel[first] < REACH_M:
            first -= 1
        while last < count - 1 and walls[last + 1] == walls[at] and travel[last] - travel[at] < REACH_M:
            last += 1
        left, right, origin = loss[at - 1], loss[at], map_travel[at]
        best, moved_to = -np.inf, at
        for c in range(first + 1, last + 1):
            value = right if c < at else left
            score = _likelihood(loss, excess, travel, first, last, min(c, at), max(c, at), value, noise, shadowing)
            score -= abs(travel[c] - origin) / _MAP_ERROR_M
            if score > best:
                best, moved_to = score, c
        after, before = walls[at], walls[at - 1]
        for i in range(min(at, moved_to), max(at, moved_to)):
            walls[i] = after if moved_to < at else before
            loss[i] = right if moved_to < at else left
        map_travel[moved_to] = origin
        at = max(at, moved_to) + 1


@kernel
def _drop_detours(walls, loss, excess, travel, noise, shadowing):
    """Remove runs shorter than 2 `REACH_M` between two equal wall counts if the readings do not support them."""
    count, at = walls.shape[0], 1
    while at < count:
        if walls[at] == walls[at - 1]:
            at += 1
            continue
        end = at
        while end < count and walls[end] == walls[at]:
            end += 1
        if end < count and walls[end] == walls[at - 1] and travel[end] - travel[at] < 2 * REACH_M:
            value = 0.5 * (loss[at - 1] + loss[end])
            kept = _likelihood(loss, excess, travel, at, end, at, at, 0.0, noise, shadowing)
            without = _likelihood(loss, excess, travel, at, end, at, end, value, noise, shadowing)
            if without >= kept:
                for i in range(at, end):
                    walls[i], loss[i] = walls[end], value
        at = end


@kernel
def _likelihood(loss, excess, travel, first, last, low, high, value, noise, shadowing):
    """Log-likelihood of the readings around first to last, with the loss of readings low to high - 1 set to value."""
    count = loss.shape[0]
    begin, end = first, last
    while begin > 0 and travel[first] - travel[begin] < _AROUND_M:
        begin -= 1
    while end < count - 1 and travel[end] - travel[last] < _AROUND_M:
        end += 1
    mean, variance, total = 0.0, shadowing, 0.0
    for i in range(begin, end + 1):
        if i > begin:
            keep = np.exp(-(travel[i] - travel[i - 1]) / _SHADOWING_M)
            mean *= keep
            variance = variance * keep * keep + shadowing * (1.0 - keep * keep)
        if not np.isfinite(excess[i]):
            continue
        error = excess[i] - (value if low <= i < high else loss[i]) - mean
        spread = variance + noise
        total -= 0.5 * (error * error / spread + np.log(spread))
        mean += variance / spread * error
        variance -= variance * variance / spread
    return total
