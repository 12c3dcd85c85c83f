"""Walls anywhere and the signal that they weaken, drawn in turn from their posterior given all readings at once.

A reading of router r at distance d behind k walls, averaged over the small places of the path, is

    rssi = power_r - 10 n log10(d) - loss (1 + share + ... + share^(k - 1)) + shadowing + noise,

where shadowing is a Gaussian process over places: a further wall takes less than the first, for waves find ways around.
k is the mean over ways that fill the Fresnel zone. Exponent, powers, loss and share are drawn along with the walls.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from twc_env.slam.lattice_sampler import sample_lattice
from twc_env.slam.wall_lattice import WallLattice
from twc_env.slam.wall_sampler import crossings

Array = NDArray

K_MAX = 8
_ROUNDS, _COOLING_ROUNDS, _SWEEPS, _HOTTEST, _COOLING_SHARE = 60, 30, 6, 5.0, 0.7
"""Rounds, those of them in which it cools down, sweeps in each, its first temperature, and by which share it is 1."""
_PLACE_M, _PRECISION_MAX = 0.2, 16_000_000
"""Readings of one cell of this size are one; larger cells where the precisions would have more numbers."""
_SHADOWING_DB, _SHADOWING_M, _NOISE_DB, _PLACE_DB = 3.0, 0.5, 4.0, 1.0
"""Shadowing, its length, noise of one reading, and what of a place its readings share."""
_EXPONENT, _LOSS_DB, _POWER_SPREAD_DB = (1.5, 0.6), (9.0, 2.5), 3.0
"""Mean and standard deviation of the exponent and of a first wall's loss; how much the powers differ."""
_LOSS_MIN_DB = 2.0
_SHARES = np.linspace(0.0, 1.0, 11)
_WAVELENGTH_M = 0.125
_WAYS = np.array([-0.6, 0.0, 0.6])
"""Bends of the ways halfway, in radii of the first Fresnel zone."""
_CLEAR = 0.85
"""The power is first taken for what this share of readings stays below."""
_DISTANCE_MIN_M = 0.5


class LatticeSolver:
    """One chain: walls of a lattice, rays and the signal's parameters."""

    def __init__(
        self, position_m: Array, rssi_dbm: Array, router_m: Array, lattice: WallLattice, random: np.random.Generator
    ):
        self.lattice, self._random = lattice, random
        self.place_of, places_m, level, count = _by_place(position_m, rssi_dbm, lattice.ends_m[0, :2])
        routers = len(router_m)
        self._shape = routers, len(places_m)
        self._level = np.nan_to_num(level.T)  # (routers, places)
        away_m = places_m - router_m[:, None]
        apart_m = np.linalg.norm(away_m, axis=2)
        self._decades = 10 * np.log10(np.maximum(apart_m, _DISTANCE_MIN_M))
        self._precision = _precisions(places_m, count.T)
        across = np.stack([-away_m[..., 1], away_m[..., 0]], axis=2) / np.maximum(apart_m, 1e-6)[..., None]
        radius_m = 0.5 * np.sqrt(_WAVELENGTH_M * apart_m)
        bends_m = (router_m[:, None] + 0.5 * away_m)[:, :, None]
        bends_m = bends_m + _WAYS[:, None] * (radius_m[..., None] * across)[:, :, None]  # (routers, places, ways, 2)
        ends_m = np.stack([np.broadcast_to(router_m[:, None, None], bends_m.shape),
                           np.broadcast_to(places_m[:, None], bends_m.shape)], axis=3)  # fmt: skip
        far_m = np.repeat(bends_m.reshape(-1, 2), 2, axis=0)
        pieces_m = np.where(lattice.is_open[:, None], lattice.ends_m, np.nan)  # what is no wall is met by nothing
        self._first, legs = crossings(pieces_m, ends_m.reshape(-1, 2), far_m)
        self._members = legs // 2  # both legs of a way lose alike
        self._crossed = np.zeros((routers * len(places_m), len(_WAYS)), np.int64)
        self._is_wall = np.zeros(len(lattice.ends_m), np.bool_)
        self._times = np.zeros((len(self._crossed), K_MAX + 1))
        self.probability = np.zeros(len(lattice.ends_m))
        """(pieces,) that each is a wall."""
        self.exponent, self.wall_loss_db, self._share = _EXPONENT[0], _LOSS_DB[0], 0.5
        self._heard = np.isfinite(level.T)
        self.power_dbm = np.full(routers, np.nanquantile(level.T + self.exponent * self._decades, _CLEAR))

    @property
    def is_told(self) -> Array:
        """(pieces,) bool: open, and some ray crosses it."""
        return self.lattice.is_open & (np.diff(self._first) > 0)

    @property
    def noise_db(self) -> float:
        """How far the mean reading of a place strays, shadowing included."""
        return float(np.std(self._error()[self._heard]))

    def solve(self) -> None:
        """Cool down, then sample."""
        nothing = np.zeros((0, 0))
        for round_ in range(_ROUNDS):
            cooled = min(1.0, round_ / (_COOLING_SHARE * _COOLING_ROUNDS))
            is_cold = round_ >= _COOLING_ROUNDS
            self._sample(1.0 if is_cold else _HOTTEST + (1.0 - _HOTTEST) * cooled, self._times if is_cold else nothing)
            self._draw_signal()
            self.probability += is_cold * self._is_wall / (_ROUNDS - _COOLING_ROUNDS)

    def count_probability(self) -> Array:
        """(readings, routers, K_MAX + 1) probability of each number of walls."""
        share = self._times / self._times.sum(axis=1, keepdims=True)
        return share.reshape(*self._shape, -1).transpose(1, 0, 2)[self.place_of]

    def _sample(self, temperature: float, times: Array) -> None:
        lattice, loss = self.lattice, self.wall_loss_db * _growth(self._share)
        pull = np.matmul(self._precision, self._error()[..., None]).ravel()
        sample_lattice(
            self._is_wall, lattice.is_open, lattice.before, lattice.after, lattice.beside, self._first, self._members,
            self._crossed, loss, self._precision, pull, temperature, _SWEEPS, self._random, times,
        )  # fmt: skip

    def _error(self) -> Array:
        """(routers, places) level expected minus level read [dB]."""
        loss = self.wall_loss_db * _growth(self._share)
        expected = self.power_dbm[:, None] - self.exponent * self._decades - loss[self._capped()].mean(axis=2)
        return expected - self._level

    def _capped(self) -> Array:
        """(routers, places, ways) walls, at most as many as losses are known for."""
        return np.minimum(self._crossed, K_MAX).reshape(*self._shape, -1)

    def _draw_signal(self) -> None:
        """Draw share, powers, exponent and loss given the walls."""
        routers, crossed = self._shape[0], self._capped()
        weakened = [_growth(share)[crossed].mean(axis=2) for share in _SHARES]
        base = np.stack([np.ones(self._shape), -self._decades, self._level, *(-w for w in weakened)], axis=2)
        gram = np.matmul(base.transpose(0, 2, 1), np.matmul(self._precision, base))  # (routers, ...) of all products
        spread = (np.eye(routers) - 1.0 / routers) / _POWER_SPREAD_DB**2 + 1e-6 * np.eye(routers)
        drawn = []
        for s in range(3, gram.shape[1]):
            normal, right = np.zeros((routers + 2, routers + 2)), np.zeros(routers + 2)
            shared = gram[:, [1, s]]
            normal[:routers, :routers] = np.diag(gram[:, 0, 0]) + spread
            normal[:routers, routers:] = shared[:, :, 0]
            normal[routers:, :routers] = shared[:, :, 0].T
            normal[routers:, routers:] = shared[:, :, [1, s]].sum(axis=0)
            right[:routers], right[routers:] = gram[:, 0, 2], shared[:, :, 2].sum(axis=0)
            for at, (mean, deviation) in zip((routers, routers + 1), (_EXPONENT, _LOSS_DB), strict=True):
                normal[at, at] += 1 / deviation**2
                right[at] += mean / deviation**2
            best = np.linalg.solve(normal, right)
            drawn.append((0.5 * right @ best - 0.5 * np.linalg.slogdet(normal)[1], best, normal))
        evidence = np.array([score for score, *_ in drawn])
        weight = np.exp(evidence - evidence.max())
        chosen = self._random.choice(len(drawn), p=weight / weight.sum())
        _, best, normal = drawn[chosen]
        root = np.linalg.cholesky(normal)
        values = best + np.linalg.solve(root.T, self._random.standard_normal(len(best)))
        self._share = _SHARES[chosen]
        self.power_dbm, self.exponent = values[:routers], max(float(values[routers]), 0.0)
        self.wall_loss_db = max(float(values[routers + 1]), _LOSS_MIN_DB)


def _growth(share: float) -> Array:
    """(K_MAX + 1,) what walls take in units of the first: 0, 1, 1 + share, 1 + share + share^2, ..."""
    return np.concatenate([[0.0], np.cumsum(share ** np.arange(K_MAX))])


def _by_place(position_m: Array, rssi_dbm: Array, corner_m: Array) -> tuple[Array, Array, Array, Array]:
    """The place of each reading; (places, 2) of these, mean readings (places, routers), and how many each has."""
    size_m = _PLACE_M
    while True:
        cell = np.floor((position_m - corner_m) / size_m).astype(np.int64)
        _, place_of = np.unique(cell, axis=0, return_inverse=True)
        place_of = place_of.ravel()
        places = int(place_of.max()) + 1
        if places**2 * rssi_dbm.shape[1] <= _PRECISION_MAX:
            break
        size_m *= 1.25
    heard = np.isfinite(rssi_dbm)
    total = np.bincount(place_of)
    middle_m = np.column_stack([np.bincount(place_of, column) / total for column in position_m.T])
    count = np.column_stack([np.bincount(place_of, column, places) for column in heard.T.astype(float)])
    sums = np.column_stack([np.bincount(place_of, column, places) for column in np.where(heard, rssi_dbm, 0.0).T])
    return place_of, middle_m, sums / np.where(count > 0, count, np.nan), count


def _precisions(places_m: Array, count: Array) -> Array:
    """(routers, places, places) inverse covariance of mean readings of `count` (routers, places) each, 0 if unheard."""
    apart_m = np.linalg.norm(places_m[:, None] - places_m, axis=2)
    shadowing = _SHADOWING_DB**2 * np.exp(-apart_m / _SHADOWING_M)
    precision = np.zeros((len(count), *apart_m.shape))
    for own, readings in zip(precision, count, strict=True):
        heard = np.flatnonzero(readings)
        noise = np.diag(_PLACE_DB**2 + _NOISE_DB**2 / readings[heard])
        own[np.ix_(heard, heard)] = np.linalg.inv(shadowing[np.ix_(heard, heard)] + noise)
    return precision
