"""Number of walls between a router and each reading, from signal strength along a path (papers.md K24d).

A hidden Markov model along the path. Its state is the number of walls k; a reading is

    rssi = power - 10 n log10(distance) - wall_loss k + noise.

Expectation maximisation estimates power, n, wall_loss and noise together with k; BIC selects the largest k.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.errors import DataError
from twc_env.kernels.compiled import kernel
from twc_env.slam.walls.path_bins import PathBins

DISTANCE_MIN_M = 0.5
K_MAX = 5
_EXPONENT_PRIOR = (2.0, 0.4)
"""Mean and standard deviation of the path loss exponent indoors, without the loss of walls."""
_WALL_LOSS_PRIOR_DB = (9.0, 2.5)
_WALL_LOSS_MIN_DB = 7.0
"""Smaller losses cannot be distinguished from shadowing: several such walls count as one."""
_WALL_LOSS_STARTS_DB = (5.0, 8.0, 12.0, 18.0)
_STAY_M = 1.5
"""Mean path length between changes of k, for paths along walls."""
_IDENTICAL_EXPONENT_PRIOR, _IDENTICAL_STAY_M, _IDENTICAL_SHARE = (0.6, 0.1), 20.0, 0.4
"""The same for identical transmitters in a furnished flat (multipath, robot moves freely), and the prior ratio of the
probabilities of k + 1 and k walls: weak readings behind many walls are rarely received."""
_JUMP_DECAY = 0.15
"""Probability ratio of a change of k by one wall more."""
_STEP_SHARE_MAX = 0.25
"""Longest step, as a share of the mean path length, with at most one change of k; longer ones are subdivided."""
_CORRELATION_M = 0.3
"""Binned readings within this length count as one: their shadowing is correlated."""
_TYPICAL_EXPONENT, _TYPICAL_LOSS_DB, _TYPICAL_CLEAR = 1.6, 8.0, 0.9
"""Of `typical_signal`: exponent, wall loss, and quantile of the distance-corrected RSSI that is free of walls."""
_NOISE_MIN_DB = 1.0
_GRID_STEPS_M, _REFINED = (0.5, 0.5 / 3, 0.5 / 9), (5, 1)
"""Of `locate_router`: grid steps, and how many of the best places of one are searched around in the next."""


@dataclass(frozen=True, slots=True, eq=False)
class SignalFit:
    """Signal model of one router and the number of walls along the path."""

    power_at_1m_dbm: float
    exponent: float
    wall_loss_db: float
    noise_db: float
    """Standard deviation of a binned reading around the model."""
    probability: Array
    """(bins, k_max + 1) probability of each number of walls."""
    log_likelihood: float
    """Of all bins, correlated ones counted once, including priors."""

    @property
    def walls(self) -> Array:
        """(bins,) most probable number of walls."""
        return np.argmax(self.probability, axis=1)


def fit_signal(bins: PathBins, router: int, router_m: Array) -> SignalFit:
    """Fit the signal model and walls of one router at a known position (2,), with the largest k selected by BIC.

    Raises DataError when the router was heard in fewer than five bins.
    """
    readings = _readings_of(bins, router, router_m)
    most = max(
        (_fit(bins, readings, K_MAX, start) for start in _WALL_LOSS_STARTS_DB), key=lambda fit: fit.log_likelihood
    )
    fits = [*(_fit(bins, readings, k, most.wall_loss_db) for k in range(K_MAX)), most]
    effective = max(len(readings[0]) * min(1.0, bins.step_m / _CORRELATION_M), 2.0)
    return max(fits, key=lambda fit: fit.log_likelihood - 0.5 * np.log(effective) * fit.probability.shape[1])


def typical_signal(bins: PathBins, router: int, router_m: Array) -> SignalFit:
    """Initial guess for further estimation: typical exponent and wall loss, power from the strongest readings."""
    rows, decades, level = _readings_of(bins, router, router_m)
    power = float(np.quantile(level + _TYPICAL_EXPONENT * decades, _TYPICAL_CLEAR))
    walls = np.clip(np.round((power - _TYPICAL_EXPONENT * decades - level) / _TYPICAL_LOSS_DB), 0, K_MAX).astype(int)
    probability = _for_all_bins(bins, rows, np.eye(K_MAX + 1)[walls])
    return SignalFit(power, _TYPICAL_EXPONENT, _TYPICAL_LOSS_DB, 3.0, probability, -np.inf)


def fit_identical_routers(bins: PathBins, router_m: Array, k_max: int) -> list[SignalFit]:
    """Joint fit of identical routers at positions (routers, 2), with common power, exponent and wall loss."""
    parts = []
    for router, place in enumerate(np.asarray(router_m, float)):
        rows, decades, level = _readings_of(bins, router, place)
        steps = np.diff(bins.travel_m[rows], prepend=-np.inf)  # infinite: independent of the previous router
        parts.append((rows, decades, level, steps))
    decades, level, steps = (np.concatenate([part[i] for part in parts]) for i in (1, 2, 3))
    fits = []
    for start in _WALL_LOSS_STARTS_DB:
        score, parameters, probability = _fitted(
            decades,
            level,
            steps,
            bins.step_m,
            k_max,
            start,
            _IDENTICAL_EXPONENT_PRIOR,
            _IDENTICAL_STAY_M,
            40,
            _IDENTICAL_SHARE,
        )
        score += _log_prior(parameters[1], _IDENTICAL_EXPONENT_PRIOR) + _log_prior(parameters[2], _WALL_LOSS_PRIOR_DB)
        fits.append((score, parameters, probability))
    score, parameters, probability = max(fits, key=lambda tried: tried[0])
    shares = np.split(probability, np.cumsum([len(part[0]) for part in parts])[:-1])
    return [
        _signal(parameters, _for_all_bins(bins, part[0], own), score) for part, own in zip(parts, shares, strict=True)
    ]


def locate_router(bins: PathBins, router: int) -> tuple[Array, SignalFit]:
    """Maximum-likelihood position (2,) of a router from its readings (papers.md K24g), and the fit there.

    Grid search within 4 m of the strongest readings and 1 m of the path's bounding box, then around several of its best
    places: near the path the likelihood changes within one step of the grid.
    """
    strongest = bins.position_m[np.argsort(np.nan_to_num(bins.rssi_dbm[:, router], nan=-200.0))[-5:]].mean(axis=0)
    low = np.maximum(bins.position_m.min(axis=0) - 1.0, strongest - 4.0)
    high = np.minimum(bins.position_m.max(axis=0) + 1.0, strongest + 4.0)
    places, step_m = _searched(bins, router, low, high, _GRID_STEPS_M[0]), _GRID_STEPS_M[0]
    for finer_m, kept in zip(_GRID_STEPS_M[1:], _REFINED, strict=True):
        found = sorted(places, key=lambda tried: -tried[0])[:kept]
        places = [own for _, at in found for own in _searched(bins, router, at - step_m, at + step_m, finer_m)]
        step_m = finer_m
    best, centre = max(places, key=lambda tried: tried[0])
    if best == -np.inf:
        raise DataError("no place of the router explains the readings; check the units of positions and strengths")
    return centre, fit_signal(bins, router, centre)


def _searched(bins: PathBins, router: int, low: Array, high: Array, step_m: float) -> list[tuple[float, Array]]:
    """Log-likelihood, -inf if not finite, and position (2,) of a router at each place of a grid between corners."""
    tried = []
    for x in np.arange(low[0], high[0] + 1e-9, step_m):
        for y in np.arange(low[1], high[1] + 1e-9, step_m):
            place = np.array([x, y])
            readings = _readings_of(bins, router, place)
            fits = (_fit(bins, readings, 3, start, iterations=6).log_likelihood for start in _WALL_LOSS_STARTS_DB[1:3])
            tried.append((max((score for score in fits if np.isfinite(score)), default=-np.inf), place))
    return tried


def _readings_of(bins: PathBins, router: int, router_m: Array) -> tuple[Array, Array, Array]:
    """Indices of the bins where a router at this position was heard, their 10 log10 distance and their RSSI."""
    rows = np.flatnonzero(np.isfinite(bins.rssi_dbm[:, router]))
    if len(rows) < 5:
        raise DataError(f"router {router} was heard in {len(rows)} places only; at least 5 are needed")
    distance_m = np.linalg.norm(bins.position_m[rows] - router_m, axis=1)
    return rows, 10.0 * np.log10(np.maximum(distance_m, DISTANCE_MIN_M)), bins.rssi_dbm[rows, router]


def _for_all_bins(bins: PathBins, rows: Array, probability: Array) -> Array:
    """(bins, k + 1) from the probabilities (rows, k + 1) of bins that heard a router; others copy the next such bin."""
    return probability[np.clip(np.searchsorted(rows, np.arange(len(bins.position_m))), 0, len(rows) - 1)]


def _fit(
    bins: PathBins, readings: tuple[Array, Array, Array], k_max: int, start_db: float, iterations: int = 25
) -> SignalFit:
    """Model of one router from the output of `_readings_of`, starting at a wall loss."""
    rows, decades, level = readings
    steps = np.diff(bins.travel_m[rows], prepend=bins.travel_m[rows[0]])
    score, parameters, probability = _fitted(
        decades, level, steps, bins.step_m, k_max, start_db, _EXPONENT_PRIOR, _STAY_M, iterations
    )
    prior = _log_prior(parameters[1], _EXPONENT_PRIOR)
    if k_max:
        prior += _log_prior(parameters[2], _WALL_LOSS_PRIOR_DB)
    return _signal(parameters, _for_all_bins(bins, rows, probability), float(score + prior))


def _signal(parameters: Array, probability: Array, log_likelihood: float) -> SignalFit:
    power, exponent, loss, noise = parameters.tolist()
    return SignalFit(power, exponent, loss, noise, probability, log_likelihood)


def _log_prior(value: float, prior: tuple[float, float]) -> float:
    return -0.5 * ((value - prior[0]) / prior[1]) ** 2


def _fitted(
    decades: Array, level: Array, steps: Array, step_m: float, k_max: int, start_db: float,
    exponent_prior: tuple[float, float], stay_m: float, iterations: int, share: float = 1.0,
) -> tuple[float, Array, Array]:  # fmt: skip
    """Log-likelihood, parameters (4,) and probability (n, k_max + 1) of each number of walls for readings (n,).

    share: prior probability ratio of k + 1 and k walls. The likelihood of correlated readings is tempered to one
    reading per correlation length.
    """
    power = float(np.quantile(level + exponent_prior[0] * decades, 0.9))
    parameters = np.array([power, exponent_prior[0], start_db if k_max else 0.0, 4.0])
    probability = np.empty((len(level), k_max + 1))
    temper = min(1.0, max(step_m, 1e-3) / _CORRELATION_M)
    score = _expectation_maximisation(
        decades, level, steps, temper, iterations, k_max > 0, exponent_prior, stay_m, share, parameters, probability
    )
    return score, parameters, probability


@kernel
def _expectation_maximisation(
    decades, level, steps, temper, iterations, has_walls, exponent_prior, stay, share, parameters, probability
):
    """Baum-Welch with a robust regression as its M step (Student's t, 4 degrees of freedom).

    parameters (4,): power, exponent, wall loss, noise, updated in place; returns the log-likelihood.
    """
    count, states = probability.shape
    log_emit = np.empty((count, states))
    forward = np.empty((count, states))
    total = 0.0
    for _ in range(iterations):
        power, exponent, loss, noise = parameters
        for i in range(count):
            for k in range(states):
                e = (level[i] - power + exponent * decades[i] + loss * k) / noise
                log_emit[i, k] = temper * (-2.5 * np.log(1.0 + e * e / 4.0) - np.log(noise))
        total = _forward_backward(log_emit, steps, stay, share, forward, probability)
        # Normal equations of (power, exponent, loss) with Gaussian priors, in units of the noise.
        a = np.zeros((3, 3))
        b = np.zeros(3)
        for i in range(count):
            for k in range(states):
                e = (level[i] - power + exponent * decades[i] + loss * k) / noise
                w = probability[i, k] * 5.0 / (4.0 + e * e) * temper / (noise * noise)
                x = (1.0, -decades[i], -1.0 * k)
                for r in range(3):
                    b[r] += w * x[r] * level[i]
                    for c in range(r, 3):
                        a[r, c] += w * x[r] * x[c]
        a[1, 0], a[2, 0], a[2, 1] = a[0, 1], a[0, 2], a[1, 2]
        a[0, 0] += 1e-6
        a[1, 1] += 1.0 / exponent_prior[1] ** 2
        b[1] += exponent_prior[0] / exponent_prior[1] ** 2
        a[2, 2] += 1.0 / _WALL_LOSS_PRIOR_DB[1] ** 2
        b[2] += _WALL_LOSS_PRIOR_DB[0] / _WALL_LOSS_PRIOR_DB[1] ** 2
        solution = np.linalg.solve(a, b)
        parameters[0], parameters[1] = solution[0], max(solution[1], 0.0)
        parameters[2] = max(solution[2], _WALL_LOSS_MIN_DB) if has_walls else 0.0
        spread, mass = 0.0, 0.0
        for i in range(count):
            for k in range(states):
                e = level[i] - parameters[0] + parameters[1] * decades[i] + parameters[2] * k
                w = probability[i, k] * 5.0 / (4.0 + (e / noise) ** 2)
                spread += w * e * e
                mass += probability[i, k]
        parameters[3] = max(np.sqrt(spread / max(mass, 1e-9)), _NOISE_MIN_DB)
    return total


@kernel
def _forward_backward(log_emit, steps, stay, share, forward, probability):
    """Write the posterior of each state (count, states); returns the log-likelihood.

    The first bin has the stationary distribution as its prior.
    """
    count, states = log_emit.shape
    transition = np.empty((states, states))
    backward = np.ones(states)
    total = 0.0
    emit = np.empty(states)
    for i in range(count):
        top = log_emit[i].max()
        scale = 0.0
        _transitions(steps[i] if i > 0 else np.inf, stay, share, transition)
        for k in range(states):
            if i == 0:
                predicted = transition[0, k]
            else:
                predicted = 0.0
                for j in range(states):
                    predicted += forward[i - 1, j] * transition[j, k]
            forward[i, k] = predicted * np.exp(log_emit[i, k] - top)
            scale += forward[i, k]
        for k in range(states):
            forward[i, k] /= scale
        total += np.log(scale) + top
    for i in range(count - 1, -1, -1):
        norm = 0.0
        for k in range(states):
            probability[i, k] = forward[i, k] * backward[k]
            norm += probability[i, k]
        for k in range(states):
            probability[i, k] /= norm
        if i == 0:
            break
        top = log_emit[i].max()
        _transitions(steps[i], stay, share, transition)
        for k in range(states):
            emit[k] = np.exp(log_emit[i, k] - top) * backward[k]
        norm = 0.0
        for j in range(states):
            value = 0.0
            for k in range(states):
                value += transition[j, k] * emit[k]
            backward[j] = value
            norm += value
        for j in range(states):
            backward[j] /= norm
    return total


@kernel
def _transitions(step, stay, share, transition):
    """Write the transition matrix of k over one step; stay: mean path length between changes.

    Increases are accepted with probability share ** increase (Metropolis et al. 1953): the stationary distribution is
    proportional to share ** k. An infinite step gives that distribution.
    """
    states = transition.shape[0]
    if np.isinf(step):
        shares = share ** np.arange(states)
        transition[:] = shares / shares.sum()
        return
    halvings = max(int(np.ceil(np.log2(max(step, 1e-6) / (_STEP_SHARE_MAX * stay)))), 0)
    leave = 1.0 - np.exp(-max(step, 1e-6) / 2.0**halvings / stay)
    for j in range(states):
        total = 0.0
        for k in range(states):
            if k != j:
                total += _JUMP_DECAY ** (abs(k - j) - 1)
        refused = 0.0
        for k in range(states):
            if k != j:
                value = leave * _JUMP_DECAY ** (abs(k - j) - 1) / total
                transition[j, k] = value * share ** max(k - j, 0)
                refused += value - transition[j, k]
        transition[j, j] = 1.0 - leave + refused if states > 1 else 1.0
    for _ in range(halvings):
        transition[:] = transition @ transition
