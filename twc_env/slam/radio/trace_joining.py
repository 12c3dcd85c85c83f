"""Align many short walks with unknown start poses in one frame by radio alone.

Each walk has its own dead reckoning and an approximate north from the compass. Where two walks pass the same place, two
scans are mutual best matches. An initial layout puts matched scans at one place; with known headings this is a linear
problem. Then each walk is moved as a rigid body to fit the signal strength fields around it, robustly. Fields alone
expand a map, matches alone contract it (their scans are not at exactly the same place), so both are used together. With
weighting `paper`, similar fingerprints have a distance given by a model trained on dead reckoning.
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
from twc_env.records.array_validation import validated_rows
from twc_env.records.fingerprint_validation import validated_fingerprints
from twc_env.records.geometry import compose
from twc_env.records.messages import Fingerprint
from twc_env.slam.pose_graph.distance_factor import Distances
from twc_env.slam.radio import radio_field
from twc_env.slam.radio.radio_similarity import all_similarities, feature_rows
from twc_env.slam.radio.similarity_model import SimilarityModel, train

APART_M = 10_000.0
"""Path length offset between two walks, so that nothing is averaged across."""
GROUP_APART_M = 100_000.0
"""Distance between the frames of two groups while they are fitted."""
SHARPNESS = 2.5
"""Exponent of strengths above the weakest: strong readings carry more information about a place."""
MATCH_ALIKE_MIN, MATCH_WALKS = 0.3, 3
"""Minimum similarity of a match, and the number of other walks, most similar first, in which each scan is matched."""
LINK_ALIKE_MIN = 0.7
"""Least similarity of a match that connects two walks. On every fourth walk of two malls, .6 and .56 of all matches lie
within 20 m of each other, of these .71 and .88; on all walks hardly a match is less alike."""
MATCH_POWER = 8
"""Weight of a match as a power of its similarity."""
MATCH_STD_M = 4.0
"""Standard deviation of the distance of matched scans, used together with the fields."""
LAYOUT_ROUNDS, LAYOUT_SCALE_M, LAYOUT_FIRST_M, LAYOUT_SHRINK = 30, 8.0, 100.0, 0.8
"""Residual at which a match has half of its weight: starts at LAYOUT_FIRST_M and shrinks to LAYOUT_SCALE_M."""
COMPASS_STD_RAD = 0.1
"""Standard deviation of a walk's heading offset: angle of the phone in the hand, magnetic disturbance. Lower than for
compasses of real phones, since radio constrains headings even less."""
WINDOW_M = 60.0
ROUNDS = 40
STEP_M = 0.02
BANDWIDTH_M = 15.0
FIELD_ROUNDS = 5
CAUCHY = 2.0


@dataclass(frozen=True, slots=True, eq=False)
class Trace:
    """One walk: its scans (n) in a frame of its own, whose axes are approximately those of the compass.

    Raises DataError for parts of inconsistent shape.
    """

    poses: Array
    """(n, 3) dead reckoning."""
    fingerprints: Sequence[Fingerprint]

    def __post_init__(self) -> None:
        poses = validated_rows(self.poses, (3,), "poses of a walk")
        if len(poses) != len(self.fingerprints) or not np.isfinite(poses).all():
            raise DataError(
                f"a walk has finite poses (n, 3), one for each fingerprint; got {poses.shape} for "
                f"{len(self.fingerprints)} fingerprints"
            )
        object.__setattr__(self, "poses", poses)
        object.__setattr__(self, "fingerprints", validated_fingerprints(self.fingerprints))


@dataclass(frozen=True, slots=True, eq=False)
class Joined:
    """Walks in one frame."""

    poses: Array
    """(walks, 3) pose of each walk's frame in the frame of its group; nothing connects the frames of two groups."""
    positions_m: tuple[Array, ...]
    """Per walk (n, 2) positions of its scans, in the same frame."""
    group: Array
    """(walks,) number of each walk's connected component, the largest first."""

    @property
    def is_joined(self) -> Array:
        """(walks,) bool: the largest group."""
        return self.group == 0


def join(traces: Sequence[Trace], config: RadioSlamConfig) -> Joined:
    """One frame for all connected walks; `config.weighting` as in `radio_slam`.

    Raises DataError if there is no scan.
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
        if self._is_ours:
            is_strong = weight >= LINK_ALIKE_MIN**MATCH_POWER
            group = self._groups(matches[is_strong])
            is_inside = group[self._walk[matches[:, 0]]] == group[self._walk[matches[:, 1]]]
            poses = self._refine(self._first_layout(matches[is_inside], weight[is_inside]), matches[is_inside],
                                 weight[is_inside], group)  # fmt: skip
        else:
            closures = self._closures()
            group, poses = self._groups(closures.pairs), self._fit(self._first_layout(matches, weight), closures)
        placed = compose(poses[self._walk], self._local)[:, :2]
        ends = np.cumsum([len(t.poses) for t in self._traces])[:-1]
        return Joined(poses, tuple(np.split(placed, ends)), group)

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

    def _groups(self, pairs: Array) -> Array:
        """(walks,) components of walks connected by pairs of scans (k, 2), the largest first."""
        ends, count = self._walk[pairs], len(self._traces)
        links = coo_array((np.ones(len(ends)), (ends[:, 0], ends[:, 1])), shape=(count, count))
        _, group = connected_components(links, directed=False)
        order = np.argsort(-np.bincount(group), kind="stable")
        return np.argsort(order)[group]

    # --- layout

    def _matches(self) -> tuple[Array, Array]:
        """Pairs (k, 2) of scans of two walks that are mutual best matches, and their weights (k,)."""
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

    def _first_layout(self, matches: Array, match_weight: Array) -> Array:
        """(walks, 3) with headings from the compass: robust linear least squares on positions."""
        (i, j), count = matches.T, len(self._traces)
        a, b = self._walk[i], self._walk[j]
        apart = self._local[j, :2] - self._local[i, :2]
        weight, place = match_weight, np.zeros((count, 2))
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
            weight = match_weight / (1.0 + (missed / scale_m) ** 2)
        return np.column_stack([place, np.zeros(count)])

    # --- fitting

    def _fit(self, poses: Array, constraints: Distances | radio_field.FieldConstraints) -> Array:
        """Walks as rigid bodies: damped Gauss-Newton on distances or field constraints, and the compass."""
        poses = poses.copy()
        damping, cost = 1e-3, self._cost(poses, constraints)
        for _ in range(ROUNDS):
            hessian, gradient = self._linearise(poses, constraints)
            scale = np.diag(hessian).copy()
            for _ in range(8):
                step = np.linalg.solve(hessian + np.diag(damping * scale + 1e-9), -gradient).reshape(-1, 3)
                moved = poses + step
                moved_cost = self._cost(moved, constraints)
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

    def _cost(self, poses: Array, constraints: Distances | radio_field.FieldConstraints) -> float:
        squared = _squared(constraints, compose(poses[self._walk], self._local))
        return float((poses[:, 2] ** 2).sum() / COMPASS_STD_RAD**2 + self._loss(squared).sum())

    def _loss(self, squared: Array) -> Array:
        return CAUCHY**2 * np.log1p(squared / CAUCHY**2) if self._is_ours else squared

    def _weight(self, squared: Array) -> Array:
        return 1.0 / (1.0 + squared / CAUCHY**2) if self._is_ours else np.ones(len(squared))

    def _linearise(self, poses: Array, constraints: Distances | radio_field.FieldConstraints) -> tuple[Array, Array]:
        count = len(poses)
        placed = compose(poses[self._walk], self._local)
        arm = placed[:, :2] - poses[self._walk, :2]
        swing = np.column_stack([-arm[:, 1], arm[:, 0]])  # derivative of a scan's position by its walk's heading
        weight, pairs, ends = (
            self._weight(_squared(constraints, placed)),
            constraints.pairs,
            self._walk[constraints.pairs],
        )
        if isinstance(constraints, Distances):
            by_first, error = constraints.jacobian(placed)[:, None], constraints.residuals(placed)[:, None]
        else:
            root = np.swapaxes(np.linalg.cholesky(constraints.information + 1e-9 * np.eye(2)), 1, 2)
            by_first, error = -root, (root @ _constraint_errors(constraints, placed)[..., None])[..., 0]
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

    def _refine(self, poses: Array, matches: Array, weight: Array, group: Array) -> Array:
        """Fit to matches and fields; those of walks of other groups are far away and constrain nothing."""
        poses = poses + np.column_stack([GROUP_APART_M * group, np.zeros((len(group), 2))])
        feature = self._rows.toarray()
        matched = weight[:, None, None] * np.eye(2) / MATCH_STD_M**2
        apart_m = np.column_stack([APART_M * self._walk, np.zeros(len(self._walk))])
        field_weight = radio_field.learn_weight(feature, self._local[:, :2] + apart_m, self._travel_m, BANDWIDTH_M)
        for _ in range(FIELD_ROUNDS):
            placed = compose(poses[self._walk], self._local)[:, :2]
            found = radio_field.field_constraints(
                feature, placed, self._travel_m, BANDWIDTH_M, APART_M / 2, field_weight
            )
            both = radio_field.FieldConstraints(
                np.concatenate([found.pairs, matches]),
                np.concatenate([found.offset_m, np.zeros(matches.shape)]),
                np.concatenate([found.information, matched]),
            )
            poses = self._fit(poses, both)
        return poses - np.column_stack([GROUP_APART_M * group, np.zeros((len(group), 2))])


def _constraint_errors(constraints: radio_field.FieldConstraints, placed: Array) -> Array:
    """(k, 2) residual of each field constraint."""
    return placed[constraints.pairs[:, 1], :2] - placed[constraints.pairs[:, 0], :2] - constraints.offset_m


def _squared(constraints: Distances | radio_field.FieldConstraints, placed: Array) -> Array:
    """(k,) squared length of each residual."""
    if isinstance(constraints, Distances):
        return constraints.residuals(placed) ** 2
    error = _constraint_errors(constraints, placed)
    return np.einsum("ki,kij,kj->k", error, constraints.information, error)
