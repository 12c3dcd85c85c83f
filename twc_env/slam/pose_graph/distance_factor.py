"""Pose graphs with distance edges: a radio closure measures the distance between two poses, not the direction.

Residual of a distance edge (radio SLAM Eq. 1, model of Eq. 3): (|p_i - p_j| - z) / std, one-dimensional. It does not
depend on headings. If both positions coincide, its direction is undefined and its Jacobian is set to zero.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.kernels.compiled import kernel
from twc_env.slam.pose_graph.solver import NormalEquations

COINCIDENT_M = 1e-3
"""Positions nearer than this count as coincident."""


@dataclass(frozen=True, slots=True, eq=False)
class Distances:
    """Distance edges: pairs (k, 2) of pose indices, distance_m (k,), variance_m2 (k,)."""

    pairs: Array
    distance_m: Array
    variance_m2: Array

    def __len__(self) -> int:
        return len(self.pairs)

    def __getitem__(self, chosen) -> Distances:
        return Distances(self.pairs[chosen], self.distance_m[chosen], self.variance_m2[chosen])

    def residuals(self, poses: Array) -> Array:
        """(k,) distance minus measured distance, in standard deviations."""
        away = poses[self.pairs[:, 0], :2] - poses[self.pairs[:, 1], :2]
        return (np.hypot(away[:, 0], away[:, 1]) - self.distance_m) / np.sqrt(self.variance_m2)

    def jacobian(self, poses: Array) -> Array:
        """(k, 2) derivative of each residual by the first position; that by the second is its negative."""
        away = poses[self.pairs[:, 0], :2] - poses[self.pairs[:, 1], :2]
        length = np.hypot(away[:, 0], away[:, 1])
        unit = np.where((length > COINCIDENT_M)[:, None], away / np.maximum(length, COINCIDENT_M)[:, None], 0.0)
        return unit / np.sqrt(self.variance_m2)[:, None]


NO_DISTANCES = Distances(np.zeros((0, 2), np.int64), np.zeros(0), np.zeros(0))


def concatenate_distances(parts: Sequence[Distances]) -> Distances:
    """All edges of several sets, in order."""
    if not parts:
        return NO_DISTANCES
    return Distances(
        np.concatenate([p.pairs for p in parts]).astype(np.int64),
        np.concatenate([p.distance_m for p in parts]),
        np.concatenate([p.variance_m2 for p in parts]),
    )


class RadioEquations(NormalEquations):
    """Normal equations of relative-pose edges followed by distance edges; pose 0 is fixed."""

    def __init__(self, edges: Array, measured: Array, information: Array, distances: Distances, count: int):
        self._relative_count, self._distances = len(edges), distances
        nothing = np.zeros((len(distances), 3))
        # The pairs enter the sparse pattern as edges without information.
        super().__init__(
            np.concatenate([np.reshape(edges, (-1, 2)), distances.pairs]),
            np.concatenate([np.reshape(measured, (-1, 3)), nothing]),
            np.concatenate([np.reshape(information, (-1, 3, 3)), np.zeros((len(distances), 3, 3))]),
            count,
            fixed=0,
        )

    def fit(self, poses: Array, scale: float, iterations: int) -> Array:
        """Optimised poses (n, 3) of a path. Its odometry, the first n - 1 edges, has weight 1; others a Cauchy loss."""

        def weigh(squared: Array) -> Array:
            weight = 1.0 / (1.0 + squared / scale**2)
            weight[: len(poses) - 1] = 1.0
            return weight

        return self.minimise(poses, weigh, iterations)

    def squared_errors(self, poses: Array) -> Array:
        """(relative + distance edges,) squared Mahalanobis length of each residual."""
        squared = super().squared_errors(poses)
        squared[self._relative_count :] = self._distances.residuals(poses) ** 2
        return squared

    def linearise(self, poses: Array, weight: Array) -> tuple[Array, Array, Array]:
        """As `NormalEquations.linearise`, with the distance edges added."""
        diagonal, blocks, gradient = super().linearise(poses, weight)
        distances, first = self._distances, self._relative_count
        _add_distances(
            distances.pairs, distances.residuals(poses), distances.jacobian(poses), weight[first:],
            self._blocks[first:], diagonal, blocks, gradient,
        )  # fmt: skip
        return diagonal, blocks, gradient

    def _solve_step(self, poses: Array, weight: Array, damping: float) -> tuple[bool, Array, float, float]:
        return self._solve_step_in_parts(poses, weight, damping)

    def _active_equations(self, weight: Array) -> tuple[NormalEquations, Array]:
        return self, weight


@kernel
def _add_distances(pairs, residuals, jacobian, weight, block_of_edge, diagonal, blocks, gradient):
    for e in range(len(pairs)):
        w, r = weight[e], residuals[e]
        if w == 0.0:
            continue
        block = block_of_edge[e]
        for row in range(2):
            g = w * jacobian[e, row] * r
            for end in range(2):
                pose = pairs[e, end]
                if pose == 0:  # fixed
                    continue
                gradient[pose, row] -= g if end == 0 else -g
                for col in range(2):
                    diagonal[pose, row, col] += w * jacobian[e, row] * jacobian[e, col]
            if block >= 0:
                for col in range(2):
                    blocks[block, row, col] -= w * jacobian[e, row] * jacobian[e, col]
