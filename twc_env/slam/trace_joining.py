"""Aligns many short walks with unknown starts in one frame by radio alone.

Each walk knows its own shape and, by compass, about where north is. Where two walks pass each other, one scan of each
is the other walk's best match, both ways. A first layout puts such scans at one place, which needs no guess: with
headings known it is linear. Then each walk moves as one piece until it fits the fields of signal strength around it,
robustly. Fields alone swell a map, matches alone shrink it (their scans do not lie at quite one place): both act
together. With weighting `paper`, alike fingerprints lie as far apart as a model says, learnt from dead reckoning.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray as Array
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from twc_env.config import RadioSlamConfig
from twc_env.errors import DataError
from twc_env.geometry import compose
from twc_env.messages import Fingerprint
from twc_env.slam import radio_field
from twc_env.slam.distance_factor import Distances
from twc_env.slam.given_arrays import given_rows
from twc_env.slam.given_fingerprints import given_fingerprints
from twc_env.slam.radio_similarity import all_similarities, feature_rows
from twc_env.slam.similarity_model import SimilarityModel, train

APART_M = 10_000.0
"""Path length put between two walks, so that nothing is averaged across."""
SHARPNESS = 2.5
"""Power to which strengths above the faintest are raised: what is loud tells more about a place than what is faint."""
MATCH_ALIKE_MIN, MATCH_WALKS = 0.3, 3
"""Matches of a scan are at least this alike, and lie in this many of the most alike other walks."""
MATCH_POWER = 8
"""A match weighs as much as this power of its likeness."""
MATCH_STD_M = 4.0
"""How far apart the scans of a match lie, once the fields speak too."""
LAYOUT_ROUNDS, LAYOUT_SCALE_M, LAYOUT_FIRST_M, LAYOUT_SHRINK = 30, 8.0, 100.0, 0.8
"""Residual at which a neighbour has lost half of its weight: from the first, shrinking, to the last."""
COMPASS_STD_RAD = 0.1
"""How far a walk's headings are off as a whole: the phone's angle in the hand, magnetic disturbance. Held tighter
than compasses of real phones are good for: what radio says of headings is worse."""
WINDOW_M = 60.0
ROUNDS = 40
STEP_M = 0.02
BANDWIDTH_M = 15.0
FIELD_ROUNDS = 5
CAUCHY = 2.0


@dataclass(frozen=True, slots=True, eq=False)
class Trace:
    """One walk: its scans (n) in a frame of its own whose axes are about those of the compass.

    Raises DataError for parts that do not fit together.
    """

    poses: Array
    """(n, 3) dead reckoning."""
    fingerprints: Sequence[Fingerprint]

    def __post_init__(self) -> None:
        poses = given_rows(self.poses, (3,), "poses of a walk")
        if len(poses) != len(self.fingerprints) or not np.isfinite(poses).all():
            raise DataError(
                f"a walk has finite poses (n, 3), one for each fingerprint; got {poses.shape} for "
                f"{len(self.fingerprints)} fingerprints"
            )
        object.__setattr__(self, "poses", poses)
        object.__setattr__(self, "fingerprints", given_fingerprints(self.fingerprints))


@dataclass(frozen=True, slots=True, eq=False)
class Joined:
    """Walks in one frame."""

    poses: Array
    """(walks, 3) where each walk's frame lies; NaN for those that nothing ties to the others."""
    positions_m: tuple[Array, ...]
    """Per walk (n, 2) positions of its scans."""
    is_joined: Array
    """(walks,) bool: those of the largest group that fingerprints hold together."""


def join(traces: Sequence[Trace], config: RadioSlamConfig) -> Joined:
    """One frame for all walks that are tied to each other; `config.weighting` as in `radio_slam`.

    Raises DataError where there is no scan to join.
    """
    if not any(len(trace.poses) for trace in traces):
        raise DataError(f"there is nothing to join: none of {len(traces)} walks has a scan")
    return _Joiner(traces, config).run()


class _Joiner:
    def __init__(self, traces: Sequence[Trace], config: RadioSlamConfig):
        self._traces, self._config = traces, config
        self._is_ours = config.weighting == "ours"
        self._walk = np.repeat(np.arange(len(traces)), [len(t.poses) for t in traces])
        self._local = np.concatenate([t.poses for t in traces])
        step = np.hypot(*np.diff(self._local[:, :2], axis=0, prepend=self._local[:1, :2]).T)
        step[np.diff(self._walk, prepend=-1) != 0] = APART_M
        self._travel_m = np.cumsum(step)
        self._rows = feature_rows([f for t in traces for f in t.fingerprints], config.similarity)
        if self._is_ours:
            self._rows.data = self._rows.data**SHARPNESS
        self._similarity = all_similarities(self._rows)

    def run(self) -> Joined:
        matches, weight = self._matches()
        poses = self._first_layout(matches, weight)
        if self._is_ours:
            is_joined, poses = self._largest_group(matches), self._refine(poses, matches, weight)
        else:
            closures = self._closures()
            is_joined, poses = self._largest_group(closures.pairs), self._fit(poses, closures)
        poses[~is_joined] = np.nan
        placed = compose(poses[self._walk], self._local)[:, :2]
        ends = np.cumsum([len(t.poses) for t in self._traces])[:-1]
        return Joined(poses, tuple(np.split(placed, ends)), is_joined)

    # --- what fingerprints say

    def _train(self) -> SimilarityModel:
        i, j = np.triu_indices(len(self._walk), 1)
        same = (self._walk[i] == self._walk[j]) & (self._travel_m[j] - self._travel_m[i] <= WINDOW_M)
        i, j = i[same], j[same]
        away = np.linalg.norm(self._local[i, :2] - self._local[j, :2], axis=1)
        return train(self._similarity[i, j], away, WINDOW_M, self._config.bin_width, "paper")

    def _closures(self) -> Distances:
        i, j = np.nonzero(np.triu(self._similarity > self._config.similarity_min, 1))
        other = self._walk[i] != self._walk[j]
        i, j = i[other], j[other]
        mean, variance = self._train().distance(self._similarity[i, j])
        return Distances(np.column_stack([i, j]), mean, variance)

    def _largest_group(self, pairs: Array) -> Array:
        """(walks,) bool: those that pairs of scans (k, 2) connect to most others."""
        ends = self._walk[pairs]
        count = len(self._traces)
        links = coo_array((np.ones(len(ends)), (ends[:, 0], ends[:, 1])), shape=(count, count))
        _, group = connected_components(links, directed=False)
        return group == np.bincount(group).argmax()

    # --- layout

    def _matches(self) -> tuple[Array, Array]:
        """Pairs (k, 2) of scans of two walks that are each other's best, and how much each weighs (k,)."""
        alike = np.where(self._walk[:, None] == self._walk[None], -1.0, self._similarity)
        starts = np.flatnonzero(np.diff(self._walk, prepend=-1))
        column = np.cumsum(np.diff(self._walk, prepend=-1) != 0) - 1  # of a scan's walk among those with scans
        ends = itertools.pairwise([*starts, len(alike)])
        best = np.column_stack([alike[:, first:end].argmax(axis=1) + first for first, end in ends])
        level = np.take_along_axis(alike, best, axis=1)
        rank = np.argsort(np.argsort(-level, axis=1, kind="stable"), axis=1)
        is_mutual = best[best, column[:, None]] == np.arange(len(alike))[:, None]
        i, other = np.nonzero(is_mutual & (rank < MATCH_WALKS) & (level > MATCH_ALIKE_MIN))
        return np.column_stack([i, best[i, other]]), level[i, other] ** MATCH_POWER

    def _first_layout(self, matches: Array, worth: Array) -> Array:
        """(walks, 3) with headings as the compass has them: robust linear least squares on places."""
        (i, j), count = matches.T, len(self._traces)
        a, b = self._walk[i], self._walk[j]
        apart = self._local[j, :2] - self._local[i, :2]
        weight, place = worth, np.zeros((count, 2))
        for round_ in range(LAYOUT_ROUNDS):
            laplacian = np.diag(np.bincount(a, weight, count) + np.bincount(b, weight, count) + 1e-6)
            links = np.bincount(a * count + b, weight, count * count).reshape(count, count)
            laplacian -= links + links.T
            pull = np.column_stack(
                [np.bincount(a, weight * d, count) - np.bincount(b, weight * d, count) for d in apart.T]
            )
            place = np.linalg.solve(laplacian, pull)
            missed = np.linalg.norm(place[a] - place[b] - apart, axis=1)
            scale_m = max(LAYOUT_SCALE_M, LAYOUT_FIRST_M * LAYOUT_SHRINK**round_)
            weight = worth / (1.0 + (missed / scale_m) ** 2)
        return np.column_stack([place, np.zeros(count)])

    # --- fitting

    def _fit(self, poses: Array, pulls: Distances | radio_field.Ties) -> Array:
        """Walks as rigid pieces: damped Gauss-Newton on distances or ties, and the compass."""
        poses = poses.copy()
        damping, cost = 1e-3, self._cost(poses, pulls)
        for _ in range(ROUNDS):
            hessian, gradient = self._linearise(poses, pulls)
            scale = np.diag(hessian).copy()
            for _ in range(8):
                step = np.linalg.solve(hessian + np.diag(damping * scale + 1e-9), -gradient).reshape(-1, 3)
                moved = poses + step
                moved_cost = self._cost(moved, pulls)
                if moved_cost <= cost:
                    break
                damping *= 4
            else:
                return poses
            damping = max(damping / 5, 1e-9)
            poses, cost = moved, moved_cost
            if np.abs(step[:, :2]).max() < STEP_M:
                break
        return poses

    def _cost(self, poses: Array, pulls: Distances | radio_field.Ties) -> float:
        squared = _squared(pulls, compose(poses[self._walk], self._local))
        return float((poses[:, 2] ** 2).sum() / COMPASS_STD_RAD**2 + self._loss(squared).sum())

    def _loss(self, squared: Array) -> Array:
        return CAUCHY**2 * np.log1p(squared / CAUCHY**2) if self._is_ours else squared

    def _weight(self, squared: Array) -> Array:
        return 1.0 / (1.0 + squared / CAUCHY**2) if self._is_ours else np.ones(len(squared))

    def _linearise(self, poses: Array, pulls: Distances | radio_field.Ties) -> tuple[Array, Array]:
        count = len(poses)
        placed = compose(poses[self._walk], self._local)
        arm = placed[:, :2] - poses[self._walk, :2]
        swing = np.column_stack([-arm[:, 1], arm[:, 0]])  # how a scan moves when its walk turns
        weight, pairs, ends = self._weight(_squared(pulls, placed)), pulls.pairs, self._walk[pulls.pairs]
        if isinstance(pulls, Distances):
            by_first, error = pulls.jacobian(placed)[:, None], pulls.residuals(placed)[:, None]
        else:
            root = np.swapaxes(np.linalg.cholesky(pulls.information + 1e-9 * np.eye(2)), 1, 2)
            by_first, error = -root, (root @ _tie_errors(pulls, placed)[..., None])[..., 0]
        slopes = [
            sign * np.concatenate([by_first, (by_first @ swing[pairs[:, end], :, None])], axis=2)
            for end, sign in ((0, 1.0), (1, -1.0))
        ]
        hessian, gradient = np.zeros((count, count, 3, 3)), np.zeros((count, 3))
        for a in range(2):
            np.add.at(gradient, ends[:, a], np.einsum("k,kri,kr->ki", weight, slopes[a], error))
            for b in range(2):
                blocks = np.einsum("k,kri,krj->kij", weight, slopes[a], slopes[b])
                key = ends[:, a] * count + ends[:, b]
                flat = np.stack(
                    [np.bincount(key, blocks[:, r, c], count * count) for r in range(3) for c in range(3)], axis=1
                )
                hessian += flat.reshape(count, count, 3, 3)
        index = np.arange(count)
        hessian[index, index, 2, 2] += 1.0 / COMPASS_STD_RAD**2
        gradient[:, 2] += poses[:, 2] / COMPASS_STD_RAD**2
        return hessian.transpose(0, 2, 1, 3).reshape(3 * count, 3 * count), gradient.ravel()

    def _refine(self, poses: Array, matches: Array, weight: Array) -> Array:
        feature = self._rows.toarray()
        matched = weight[:, None, None] * np.eye(2) / MATCH_STD_M**2
        apart_m = np.column_stack([APART_M * self._walk, np.zeros(len(self._walk))])
        worth = radio_field.learn_worth(feature, self._local[:, :2] + apart_m, self._travel_m, BANDWIDTH_M)
        for _ in range(FIELD_ROUNDS):
            placed = compose(poses[self._walk], self._local)[:, :2]
            ties = radio_field.ties(feature, placed, self._travel_m, BANDWIDTH_M, APART_M / 2, worth)
            both = radio_field.Ties(
                np.concatenate([ties.pairs, matches]),
                np.concatenate([ties.offset_m, np.zeros(matches.shape)]),
                np.concatenate([ties.information, matched]),
            )
            poses = self._fit(poses, both)
        return poses


def _tie_errors(ties: radio_field.Ties, placed: Array) -> Array:
    """(k, 2) how much further the second place lies from the first than the field asks for."""
    return placed[ties.pairs[:, 1], :2] - placed[ties.pairs[:, 0], :2] - ties.offset_m


def _squared(pulls: Distances | radio_field.Ties, placed: Array) -> Array:
    """(k,) squared length of each residual."""
    if isinstance(pulls, Distances):
        return pulls.residuals(placed) ** 2
    error = _tie_errors(pulls, placed)
    return np.einsum("ki,kij,kj->k", error, pulls.information, error)
