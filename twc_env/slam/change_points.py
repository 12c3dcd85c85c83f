"""Where along a path the number of walls changes, reading by reading (papers.md K24d).

A map of walls tells in which order the numbers come and nearly where they change. Where exactly the readings tell: they
drop by a wall's loss from one reading to the next, while shadowing changes slowly. A reading is

    rssi = expected - loss + shadowing + noise,

shadowing a Gauss-Markov process along the path, so that every place of a change has a likelihood (Kalman filter).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.kernels import kernel

REACH_M = 0.3
"""A change is sought so far on either side of where the map has it."""
_AROUND_M = 0.4
"""Readings this far beyond still bear on it."""
_MAP_ERROR_M = 0.05
"""How far the map's changes are off on average."""
_SWEEPS = 3
_SHADOWING_M = 0.5
"""Shadowing is forgotten over this length."""
_STD_MIN_DB = 0.5
_MEDIAN_STEP = 0.954
"""Median size of the difference of two readings, in standard deviations of one."""


def settle_changes(walls: Array, loss_db: Array, excess_db: Array, travel_m: Array) -> Array:
    """(n,) walls, each change moved to where the readings have it.

    walls (n,) and their summed loss (n,) as the map has them; excess (n,) is the level expected without walls minus the
    reading, NaN where not heard; travel (n,) the path length up to each reading.
    """
    settled = np.array(walls, np.int64)
    strayed = (excess_db - loss_db)[np.isfinite(excess_db)]
    if len(strayed) < 2:
        return settled
    noise_db2 = max(float(np.median(np.abs(np.diff(strayed)))) / _MEDIAN_STEP, _STD_MIN_DB) ** 2
    shadowing_db2 = max(float(np.var(strayed)) - noise_db2, _STD_MIN_DB**2)
    told = np.array(loss_db, float), np.asarray(excess_db, float), np.asarray(travel_m, float)
    _settle(settled, *told, noise_db2, shadowing_db2)
    return settled


@kernel
def _settle(walls, loss, excess, travel, noise, shadowing):
    """Move one change at a time to its best place between its neighbours, and drop doubtful detours, in place."""
    home = travel.copy()  # of the change before reading i, where the map had it
    for _ in range(_SWEEPS):
        _move_changes(walls, loss, home, excess, travel, noise, shadowing)
        _drop_detours(walls, loss, excess, travel, noise, shadowing)


@kernel
def _move_changes(walls, loss, home, excess, travel, noise, shadowing):
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
        left, right, came = loss[at - 1], loss[at], home[at]
        best, place = -np.inf, at
        for c in range(first + 1, last + 1):
            value = right if c < at else left
            score = _likelihood(loss, excess, travel, first, last, min(c, at), max(c, at), value, noise, shadowing)
            score -= abs(travel[c] - came) / _MAP_ERROR_M
            if score > best:
                best, place = score, c
        after, before = walls[at], walls[at - 1]
        for i in range(min(at, place), max(at, place)):
            walls[i] = after if place < at else before
            loss[i] = right if place < at else left
        home[place] = came
        at = max(at, place) + 1


@kernel
def _drop_detours(walls, loss, excess, travel, noise, shadowing):
    """Runs between two of equal numbers go unless readings call for them; long ones are for the map to judge."""
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
    """Log-likelihood of the readings around first to last if the loss from `low` to before `high` were `value`."""
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
