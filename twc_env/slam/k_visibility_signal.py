"""How many walls lie between a router and each reading, from signal strength along a path (papers.md K24d).

A hidden Markov model along the path whose state is the number of walls k and whose reading is

    rssi = power - 10 n log10(distance) - wall_loss k + noise,

with power, n, wall_loss and noise estimated together with k by expectation maximisation, and the largest k by BIC.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.errors import DataError
from twc_env.kernels import kernel
from twc_env.slam.path_bins import PathBins

DISTANCE_MIN_M = 0.5
K_MAX = 5
_EXPONENT_PRIOR = (2.0, 0.4)
"""Mean and standard deviation: indoors, with walls counted apart."""
_WALL_LOSS_PRIOR_DB = (9.0, 2.5)
_WALL_LOSS_MIN_DB = 7.0
"""Walls that take less cannot be told from shadowing: several of them are counted as one."""
_WALL_LOSS_STARTS_DB = (5.0, 8.0, 12.0, 18.0)
_STAY_M = 1.5
"""Mean path length over which k stays what it is, for a walker along walls."""
_ALIKE_EXPONENT_PRIOR, _ALIKE_STAY_M = (0.8, 0.3), 5.0
"""Of transmitters of one make in a furnished flat, where echoes fill the rooms and a robot crosses them freely."""
_JUMP_DECAY = 0.15
"""How much rarer each further wall in one jump of k is."""
_CORRELATION_M = 0.3
"""Binned readings within this length count as one, for their shadowing is the same."""
_TYPICAL_EXPONENT, _TYPICAL_LOSS_DB, _TYPICAL_CLEAR = 1.6, 8.0, 0.9
_NOISE_MIN_DB = 1.0


@dataclass(frozen=True, slots=True, eq=False)
class SignalFit:
    """What one router's readings say about its signal and the walls."""

    power_at_1m_dbm: float
    exponent: float
    wall_loss_db: float
    noise_db: float
    """Standard deviation of a binned reading around the model."""
    probability: Array
    """(bins, k_max + 1) of each number of walls."""
    log_likelihood: float
    """Of all bins, correlated ones counted once, priors included."""

    @property
    def walls(self) -> Array:
        """(bins,) most probable number of walls."""
        return np.argmax(self.probability, axis=1)


def smooth_along_path(log_evidence: Array, travel_m: Array) -> Array:
    """(bins, k + 1) probability of each number of walls, from each bin's own log evidence and how rarely k changes."""
    probability = np.empty(log_evidence.shape)
    steps = np.diff(travel_m, prepend=travel_m[0])
    evidence = np.ascontiguousarray(log_evidence, float)
    _forward_backward(evidence, steps, _STAY_M, np.empty(log_evidence.shape), probability)
    return probability


def _signal(parameters: Array, probability: Array, log_likelihood: float) -> SignalFit:
    power, exponent, loss, noise = parameters.tolist()
    return SignalFit(power, exponent, loss, noise, probability, log_likelihood)


def fit_signal(bins: PathBins, router: int, router_m: Array, k_max: int | None = None) -> SignalFit:
    """Estimate signal and walls for one router at a known place; k_max None: chosen by BIC.

    Raises DataError when the router was heard in fewer than five bins.
    """
    distance = np.linalg.norm(bins.position_m - np.asarray(router_m, float), axis=1)
    rows, decades, level = _heard(bins, router, distance)
    best = max(
        (_fit(decades, level, bins, rows, K_MAX if k_max is None else k_max, start)
         for start in _WALL_LOSS_STARTS_DB),
        key=lambda fit: fit.log_likelihood,
    )  # fmt: skip
    if k_max is None:
        smaller = [_fit(decades, level, bins, rows, k, best.wall_loss_db) for k in range(K_MAX)]
        effective = max(len(rows) * min(1.0, bins.step_m / _CORRELATION_M), 2.0)
        best = max(
            [*smaller, best],
            key=lambda fit: fit.log_likelihood - 0.5 * np.log(effective) * fit.probability.shape[1],
        )
    return best


def typical_signal(bins: PathBins, router: int, router_m: Array) -> SignalFit:
    """A start for those who estimate further: usual exponent and wall loss, power from the strongest readings."""
    distance = np.linalg.norm(bins.position_m - router_m, axis=1)
    rows, decades, level = _heard(bins, router, distance)
    power = float(np.quantile(level + _TYPICAL_EXPONENT * decades, _TYPICAL_CLEAR))
    walls = np.clip(np.round((power - _TYPICAL_EXPONENT * decades - level) / _TYPICAL_LOSS_DB), 0, K_MAX).astype(int)
    probability = np.eye(K_MAX + 1)[walls]
    everywhere = probability[np.clip(np.searchsorted(rows, np.arange(len(distance))), 0, len(rows) - 1)]
    return SignalFit(power, _TYPICAL_EXPONENT, _TYPICAL_LOSS_DB, 3.0, everywhere, -np.inf)


def fit_alike(bins: PathBins, router_m: Array, k_max: int) -> list[SignalFit]:
    """One fit for all routers (routers, 2) of one make: power, exponent and wall loss are shared."""
    parts = []
    for router, place in enumerate(np.asarray(router_m, float)):
        rows, decades, level = _heard(bins, router, np.linalg.norm(bins.position_m - place, axis=1))
        steps = np.diff(bins.travel_m[rows], prepend=bins.travel_m[rows[0]] - 1e3)  # nothing carries over
        parts.append((rows, decades, level, steps))
    decades, level, steps = (np.concatenate([part[i] for part in parts]) for i in (1, 2, 3))
    best: tuple[float, Array, Array] | None = None
    for start in _WALL_LOSS_STARTS_DB:
        exponent = _ALIKE_EXPONENT_PRIOR[0]
        power = float(np.quantile(level + exponent * decades, 0.9))
        parameters, probability = np.array([power, exponent, start, 4.0]), np.empty((len(level), k_max + 1))
        temper = min(1.0, max(bins.step_m, 1e-3) / _CORRELATION_M)
        score = _expectation_maximisation(
            decades, level, steps, temper, 40, True, _ALIKE_EXPONENT_PRIOR, _ALIKE_STAY_M,
            parameters, probability,
        )  # fmt: skip
        score -= 0.5 * ((parameters[2] - _WALL_LOSS_PRIOR_DB[0]) / _WALL_LOSS_PRIOR_DB[1]) ** 2
        if best is None or score > best[0]:
            best = score, parameters, probability
    assert best is not None
    fits, first = [], 0
    for rows, *_ in parts:
        own = best[2][first : first + len(rows)]
        everywhere = own[np.clip(np.searchsorted(rows, np.arange(len(bins.position_m))), 0, len(rows) - 1)]
        fits.append(_signal(best[1], everywhere, float(best[0])))
        first += len(rows)
    return fits


def locate_router(bins: PathBins, router: int, margin_m: float = 1.0, step_m: float = 0.5) -> tuple[Array, SignalFit]:
    """Where a router stands (2,), from signal alone (papers.md K24g): the place whose model explains the readings best.

    Tried are places within 4 m of the strongest readings and `margin_m` around the path; the best is refined.
    """
    strongest = bins.position_m[np.argsort(np.nan_to_num(bins.rssi_dbm[:, router], nan=-200.0))[-5:]].mean(axis=0)
    low = np.maximum(bins.position_m.min(axis=0) - margin_m, strongest - 4.0)
    high = np.minimum(bins.position_m.max(axis=0) + margin_m, strongest + 4.0)
    best, centre = -np.inf, strongest
    result: tuple[Array, SignalFit] | None = None
    while step_m > 0.05:
        for x in np.arange(low[0], high[0] + 1e-9, step_m):
            for y in np.arange(low[1], high[1] + 1e-9, step_m):
                place = np.array([x, y])
                rows, decades, level = _heard(bins, router, np.linalg.norm(bins.position_m - place, axis=1))
                for start in _WALL_LOSS_STARTS_DB[1:3]:
                    fit = _fit(decades, level, bins, rows, 3, start, iterations=6)
                    if fit.log_likelihood > best:
                        best, centre, result = fit.log_likelihood, place, (place, fit)
        low, high, step_m = centre - step_m, centre + step_m, step_m / 3
    if result is None:
        raise DataError("no place of the router explains the readings; check the units of positions and strengths")
    return centre, fit_signal(bins, router, centre)


def _heard(bins: PathBins, router: int, distance_m: Array) -> tuple[Array, Array, Array]:
    """Rows of the bins that heard the router, their 10 log10 distance and their level."""
    rows = np.flatnonzero(np.isfinite(bins.rssi_dbm[:, router]))
    if len(rows) < 5:
        raise DataError(f"router {router} was heard in {len(rows)} places only; at least 5 are needed")
    decades = 10.0 * np.log10(np.maximum(distance_m[rows], DISTANCE_MIN_M))
    return rows, decades, bins.rssi_dbm[rows, router]


def _fit(
    decades: Array, level: Array, bins: PathBins, rows: Array, k_max: int, start_db: float,
    iterations: int = 25,
) -> SignalFit:  # fmt: skip
    states = k_max + 1
    steps = np.diff(bins.travel_m[rows], prepend=bins.travel_m[rows[0]])
    # Correlated readings say the same thing again: their likelihood is tempered to one per correlation length.
    temper = min(1.0, max(bins.step_m, 1e-3) / _CORRELATION_M)
    power = float(np.quantile(level + _EXPONENT_PRIOR[0] * decades, 0.9))
    parameters = np.array([power, _EXPONENT_PRIOR[0], start_db if k_max else 0.0, 4.0])
    probability = np.empty((len(rows), states))
    log_likelihood = _expectation_maximisation(
        decades, level, steps, temper, iterations, k_max > 0, _EXPONENT_PRIOR, _STAY_M,
        parameters, probability,
    )  # fmt: skip
    everywhere = probability[np.clip(np.searchsorted(rows, np.arange(len(bins.position_m))), 0, len(rows) - 1)]
    prior = -0.5 * ((parameters[1] - _EXPONENT_PRIOR[0]) / _EXPONENT_PRIOR[1]) ** 2
    if k_max:
        prior -= 0.5 * ((parameters[2] - _WALL_LOSS_PRIOR_DB[0]) / _WALL_LOSS_PRIOR_DB[1]) ** 2
    return _signal(parameters, everywhere, float(log_likelihood + prior))


@kernel
def _expectation_maximisation(
    decades, level, steps, temper, iterations, has_walls, exponent_prior, stay, parameters, probability
):
    """Baum-Welch with a regression as its M step; parameters (4,) power, exponent, wall loss, noise, in and out."""
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
        total = _forward_backward(log_emit, steps, stay, forward, probability)
        # Normal equations of (power, exponent, loss) with Gaussian priors, in units of the noise.
        a = np.zeros((3, 3))
        b = np.zeros(3)
        for i in range(count):
            for k in range(states):
                e = (level[i] - power + exponent * decades[i] + loss * k) / noise
                w = probability[i, k] * 5.0 / (4.0 + e * e) * temper / (noise * noise)
                x0, x1, x2 = 1.0, -decades[i], -1.0 * k
                a[0, 0] += w * x0 * x0
                a[0, 1] += w * x0 * x1
                a[0, 2] += w * x0 * x2
                a[1, 1] += w * x1 * x1
                a[1, 2] += w * x1 * x2
                a[2, 2] += w * x2 * x2
                b[0] += w * x0 * level[i]
                b[1] += w * x1 * level[i]
                b[2] += w * x2 * level[i]
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
def _forward_backward(log_emit, steps, stay, forward, probability):
    """Posterior of each state (count, states); gives the log-likelihood. The first bin prefers no state."""
    count, states = log_emit.shape
    transition = np.empty((states, states))
    backward = np.ones(states)
    total = 0.0
    emit = np.empty(states)
    for i in range(count):
        top = log_emit[i].max()
        scale = 0.0
        _transitions(steps[i], stay, transition)
        for k in range(states):
            if i == 0:
                came = 1.0 / states
            else:
                came = 0.0
                for j in range(states):
                    came += forward[i - 1, j] * transition[j, k]
            forward[i, k] = came * np.exp(log_emit[i, k] - top)
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
        _transitions(steps[i], stay, transition)
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
def _transitions(step, stay, transition):
    """How k changes over one step of the path: rarely, and by one wall more often than by two."""
    states = transition.shape[0]
    leave = 1.0 - np.exp(-max(step, 1e-6) / stay)
    for j in range(states):
        total = 0.0
        for k in range(states):
            if k != j:
                total += _JUMP_DECAY ** (abs(k - j) - 1)
        for k in range(states):
            if k == j:
                transition[j, k] = 1.0 - leave if states > 1 else 1.0
            else:
                transition[j, k] = leave * _JUMP_DECAY ** (abs(k - j) - 1) / total
