"""Alternating estimation of walls beside a path and the parameters of the signal, from all rays of all routers."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray as Array
from scipy.sparse import coo_array

from twc_env.records.geometry import travelled_m
from twc_env.slam.walls.change_points import refine_changes
from twc_env.slam.walls.k_visibility_signal import DISTANCE_MIN_M, SignalFit
from twc_env.slam.walls.path_bins import PathBins
from twc_env.slam.walls.wall_candidates import WallCandidates
from twc_env.slam.walls.wall_sampler import COUPLING, find_crossings, sample_walls

_COOLING = (3.0, 2.0, 1.5, 1.0, 3.0, 2.0, 1.5, 1.2, 1.0, 1.0, 1.0)
_FIXED_ROUNDS = 4
"""First rounds, in which the signal parameters keep the values of the signal model."""
_OPEN_ROUNDS, _BARRED_ODDS = 3, -10.0
_COOLING_SWEEPS, _ROUNDS, _SWEEPS = 30, 6, 50
_STANDOFF_SHARE, _APART_ODDS = 0.12, -2.0
"""Pieces whose distance from the path deviates more from the standoff are not walls that the walker followed."""
_SIDE_ODDS_MAX = 3.0
_TURNED_COUNT = 4.0
"""Weight, in pieces, of what is known about the other side of the path."""
_VOTE_M = 0.5
"""Length of wall that counts as one vote for the side."""
_MEAN_LOSS_FACTOR = 1.25
"""Maximum factor between the mean wall loss and the estimate from the signal alone."""
_ROUTER_CLEAR_M = 0.25
"""A piece nearer to a router is not distinguishable from a lower transmit power."""
_LOSS_SPREAD, _LOSS_MIN_SHARE = 0.25, 0.7
"""Relative standard deviation of wall losses within a building; and the minimum loss relative to the mean."""
_CORRELATION_M = 0.3
"""Binned readings within this length count as one, since they share shadowing."""
_NOISE_MIN_DB = 1.2
_CROSSINGS_FULL, _SWEEPS_SHARE_MIN = 150_000, 0.2
"""With more crossings of rays and pieces, the number of sweeps is reduced in proportion, down to this share."""


class WallSolver:
    """Candidates, rays and signal parameters, estimated in turn."""

    def __init__(
        self, bins: PathBins, router_m: Array, fits: list[SignalFit], candidates: WallCandidates,
        standoff_m: float, seed: int,
    ):  # fmt: skip
        self.candidates, self._routers, self._seed = candidates, router_m, seed
        self.assumed_standoff_m, routers = standoff_m, len(router_m)
        self._router_of = np.tile(np.arange(routers), len(bins.position_m))
        far = np.repeat(bins.position_m, routers, axis=0)
        self._heard = np.isfinite(bins.rssi_dbm).ravel()
        self._level = np.nan_to_num(bins.rssi_dbm).ravel()
        self._decades = 10 * np.log10(
            np.maximum(np.linalg.norm(far - router_m[self._router_of], axis=1), DISTANCE_MIN_M)
        )
        self._first, self._members = _crossings(candidates.ends_m, router_m[self._router_of], far, self._heard)
        self._sweeps_share = float(np.clip(_CROSSINGS_FULL / max(len(self._members), 1), _SWEEPS_SHARE_MIN, 1.0))
        self.power_dbm = np.array([fit.power_at_1m_dbm for fit in fits])
        self.exponent = np.array([fit.exponent for fit in fits])
        losses = [fit.wall_loss_db for fit in fits if fit.wall_loss_db > 0]
        self.mean_loss_db = float(np.median(losses)) if losses else 9.0
        self._mean_loss_range_db = (self.mean_loss_db / _MEAN_LOSS_FACTOR, self.mean_loss_db * _MEAN_LOSS_FACTOR)
        self._stretches = int(candidates.stretch.max(initial=-1)) + 1
        self._stretch_loss = np.full(self._stretches, self.mean_loss_db)
        self.variance_db2 = max(float(np.median([fit.noise_db for fit in fits])), _NOISE_MIN_DB) ** 2
        counts = np.maximum(bins.count.ravel(), 1.0)
        self._noise_share = (1.0 + 16.0 / (4.0 * counts)) / np.mean(1.0 + 16.0 / (4.0 * counts))
        """Relative variance by readings per bin: white noise of 4 dB on shadowing of 2 dB."""
        self._weight = np.full(len(self._level), min(1.0, bins.step_m / _CORRELATION_M))
        self._is_wall = np.zeros(len(candidates.ends_m), np.bool_)
        self._side_odds = np.zeros(2)
        self._is_beside = np.abs(candidates.standoff_m - standoff_m) <= _STANDOFF_SHARE * standoff_m
        middles = (candidates.ends_m[:, :2] + candidates.ends_m[:, 2:]) / 2
        near_router = np.linalg.norm(middles[:, None] - router_m, axis=2).min(axis=1, initial=np.inf) < _ROUTER_CLEAR_M
        self._votes = np.minimum(1.0, np.hypot(*(candidates.ends_m[:, :2] - candidates.ends_m[:, 2:]).T) / _VOTE_M)
        self._barred = np.where(near_router, _BARRED_ODDS, 0.0)
        self.probability = np.zeros(len(candidates.ends_m))

    def solve(self, barred_side: int | None = None) -> None:
        """Anneal, at first without pieces that are only on `barred_side`, then sample."""
        candidates = self.candidates
        is_barred = np.zeros(len(candidates.side), bool)
        if barred_side is not None:
            is_barred = (candidates.side == barred_side) & ~(self._is_beside & candidates.is_between)
        self._barred = self._barred + np.where(is_barred, _BARRED_ODDS, 0.0)
        for round_, temperature in enumerate(_COOLING):
            if round_ == len(_COOLING) - _OPEN_ROUNDS:
                self._barred = self._barred - np.where(is_barred, _BARRED_ODDS, 0.0)
            self._sample(temperature, round(self._sweeps_share * _COOLING_SWEEPS), round_, None)
            if round_ >= _FIXED_ROUNDS:
                self._refit(with_stretches=round_ > _FIXED_ROUNDS + 1)
            self._learn_sides()
        on_count = np.zeros(len(self._is_wall))
        self.energy = 0.0
        sweeps = round(self._sweeps_share * _SWEEPS)
        for round_ in range(_ROUNDS):
            self._sample(1.0, sweeps, 100 + round_, on_count)
            self.energy += self._energy()
            self._refit(with_stretches=True)
        self.probability = on_count / (_ROUNDS * sweeps)

    def standoffs_m(self) -> Array:
        """(k,) distances from the path of the walls found between two tracks; empty if there are few."""
        sure = self.candidates.is_between & (self.probability > 0.8)
        return self.candidates.standoff_m[sure & (sure.sum() >= 8)]

    @property
    def explained(self) -> float:
        """Share of the variance of readings, beyond path loss of each router, that the walls explain; at most 1."""
        level, decades, errors = self._level[self._heard], self._decades[self._heard], self._errors()[self._heard]
        rest, router_of = np.zeros(len(level)), self._router_of[self._heard]
        for router in np.unique(router_of):
            own = router_of == router
            design = np.column_stack([np.ones(np.count_nonzero(own)), -decades[own]])
            rest[own] = level[own] - design @ np.linalg.lstsq(design, level[own], rcond=None)[0]
        return 1.0 - float((errors**2).mean() / max((rest**2).mean(), 1e-9)) if len(level) else 0.0

    @property
    def is_crossed(self) -> Array:
        """(pieces,) bool: crossed by some ray, so that readings carry information about it."""
        return np.diff(self._first) > 0

    def count_walls(self, position_m: Array, rssi_dbm: Array) -> Array:
        """(n, routers) walls between routers and positions (n, 2) with readings rssi (n, routers), NaN if not received.

        The map gives the count nearly everywhere; the positions where it changes are refined from the readings.
        """
        walls, loss = self._through_walls(position_m)
        apart_m = np.linalg.norm(position_m[:, None] - self._routers, axis=2)
        excess = self.power_dbm - self.exponent * 10 * np.log10(np.maximum(apart_m, DISTANCE_MIN_M)) - rssi_dbm
        travel_m = travelled_m(position_m)
        for router in range(len(self._routers)):
            walls[:, router] = refine_changes(walls[:, router], loss[:, router], excess[:, router], travel_m)
        return walls

    def _through_walls(self, position_m: Array) -> tuple[Array, Array]:
        """(n, routers) number of wall pieces between each router and each position, and their summed loss."""
        is_wall = self.probability > 0.5
        ends = np.ascontiguousarray(self.candidates.ends_m[is_wall])
        routers = len(self._routers)
        near = np.tile(self._routers, (len(position_m), 1))
        far = np.repeat(position_m, routers, axis=0)
        first, members = _crossings(ends, near, far, np.ones(len(far), np.bool_))
        losses = np.repeat(self._stretch_loss[self.candidates.stretch[is_wall]], np.diff(first))
        count = np.bincount(members, minlength=len(far)).reshape(-1, routers)
        return count, np.bincount(members, losses, minlength=len(far)).reshape(-1, routers)

    def _sample(self, temperature: float, sweeps: int, round_: int, on_count: Array | None):
        if len(self._is_wall) == 0:
            return
        loss = self._stretch_loss[self.candidates.stretch]
        sample_walls(
            self._is_wall, self._summed(loss), loss, self._first, self._members, self.candidates.before,
            self.candidates.after, self._prior_odds(), self._excess(), self._variance(), self._weight, temperature,
            sweeps, np.random.default_rng([self._seed, round_]), np.zeros(0) if on_count is None else on_count,
        )  # fmt: skip

    def _prior_odds(self) -> Array:
        """(pieces,) prior log-odds of being a wall: one vote per length of wall."""
        odds = np.where(self._is_beside, self._side_odds[self.candidates.side], _APART_ODDS)
        return odds * self._votes + self._barred

    def _summed(self, loss: Array) -> Array:
        per_member = np.repeat(np.where(self._is_wall, loss, 0.0), np.diff(self._first))
        return np.bincount(self._members, per_member, minlength=len(self._level))

    def _refit(self, with_stretches: bool) -> None:
        """Refit power and exponent of each router, the loss of each line, and the noise variance."""
        routers = len(self._routers)
        on = np.repeat(self._is_wall, np.diff(self._first))
        piece = np.repeat(self.candidates.stretch, np.diff(self._first))[on]
        width = self._stretches if with_stretches else 1
        rays = np.arange(len(self._level))
        column = 2 * routers + piece * int(with_stretches)
        values = np.concatenate([np.ones(len(rays)), -self._decades, np.full(len(column), -1.0)])
        at_row = np.concatenate([rays, rays, self._members[on]])
        at_column = np.concatenate([self._router_of, routers + self._router_of, column])
        design = coo_array((values, (at_row, at_column)), shape=(len(rays), 2 * routers + width)).tocsr()
        variance = self._variance()
        robust = 5.0 / (4.0 + self._errors() ** 2 / variance)
        weight = self._weight * robust * self._heard / variance
        mean = np.concatenate([np.zeros(routers), np.full(routers, 2.0), np.full(width, self.mean_loss_db)])
        spread = _LOSS_SPREAD * self.mean_loss_db if with_stretches else 3.5
        precision = np.concatenate(
            [np.full(routers, 1e-6), np.full(routers, 1 / 0.4**2), np.full(width, 1 / spread**2)]
        )
        normal = (design.T @ (design * weight[:, None])).toarray() + np.diag(precision)
        solution = np.linalg.solve(normal, design.T @ (weight * self._level) + precision * mean)
        self.power_dbm, self.exponent = solution[:routers], np.maximum(solution[routers : 2 * routers], 0.0)
        losses = np.maximum(solution[2 * routers :], _LOSS_MIN_SHARE * self.mean_loss_db)
        if with_stretches:
            used = np.bincount(piece, minlength=self._stretches) > 0
            self._stretch_loss = losses
            if used.any():
                told = np.diag(normal)[2 * routers :] - precision[2 * routers :]
                mean = 0.5 * self.mean_loss_db + 0.5 * (told @ losses) / told.sum()
                self.mean_loss_db = float(np.clip(mean, *self._mean_loss_range_db))
        else:
            self.mean_loss_db = float(np.clip(losses[0], *self._mean_loss_range_db))
            self._stretch_loss = np.full(self._stretches, self.mean_loss_db)
        error = self._errors()
        robust = 5.0 / (4.0 + error**2 / variance)
        self.variance_db2 = max(float((robust * error**2 / self._noise_share)[self._heard].mean()), _NOISE_MIN_DB**2)

    def _energy(self) -> float:
        """Negative log posterior of the present state, up to a constant."""
        variance, error = self._variance(), self._errors()
        misfit = self._weight * (2.5 * np.log1p(error**2 / (4.0 * variance)) + 0.5 * np.log(variance))
        before = self.candidates.before
        linked = before >= 0
        agreeing = self._is_wall[linked] == self._is_wall[before[linked]]
        prior = np.sum(self._prior_odds()[self._is_wall]) + COUPLING * (np.sum(agreeing) - np.sum(~agreeing))
        spread = _LOSS_SPREAD * self.mean_loss_db
        losses = 0.5 * np.sum(((self._stretch_loss - self.mean_loss_db) / spread) ** 2)
        return float(misfit[self._heard].sum() - prior + losses)

    def _variance(self) -> Array:
        return self.variance_db2 * self._noise_share

    def _excess(self) -> Array:
        """(rays,) loss relative to the expectation without walls [dB]."""
        return self.power_dbm[self._router_of] - self.exponent[self._router_of] * self._decades - self._level

    def _errors(self) -> Array:
        return self._excess() - self._summed(self._stretch_loss[self.candidates.stretch])

    def _learn_sides(self) -> None:
        """Prior log-odds of a wall on the left and on the right, from pieces that rays cross."""
        told = (np.diff(self._first) >= 2) & self._is_beside
        mine = [told & (self.candidates.side == side) for side in (0, 1)]
        on = [float(self._is_wall[m].sum()) for m in mine]
        count = [float(m.sum()) for m in mine]
        for side in (0, 1):
            # A walker along walls has one on one side, so the complement of the other side counts as evidence.
            turned = 1.0 - (on[1 - side] + 1.0) / (count[1 - side] + 2.0)
            share = (on[side] + _TURNED_COUNT * turned) / (count[side] + _TURNED_COUNT)
            self._side_odds[side] = np.clip(np.log(share / (1 - share)), -_SIDE_ODDS_MAX, _SIDE_ODDS_MAX)


def _crossings(ends: Array, near: Array, far: Array, is_heard: Array) -> tuple[Array, Array]:
    first = np.zeros(len(ends) + 1, np.int64)
    total = find_crossings(ends, near, far, is_heard, first, np.empty(0, np.int64))
    members = np.empty(total, np.int64)
    find_crossings(ends, near, far, is_heard, first, members)
    return first, members
