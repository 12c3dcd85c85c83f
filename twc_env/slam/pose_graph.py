"""Robust SE(2) pose-graph optimisation: Levenberg-Marquardt with 3 x 3 blocks on a sparse Cholesky factorisation.

Residuals are those of g2o's EDGE_SE2: z^-1 (a^-1 b). Odometry edges keep their weight; closures are down-weighted by
dynamic covariance scaling (DCS) or a Cauchy loss, so that one false closure cannot fold the map.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.config import PoseGraphConfig
from twc_env.errors import DataError
from twc_env.slam.block_cholesky import BlockCholesky
from twc_env.slam.relative_equations import (
    damped,
    linearise_relative,
    moved_by,
    relative_residuals,
    relative_squared_errors,
    sparse_step,
)  # fmt: skip
from twc_env.slam.shared_errors import SharedErrors, linearise_shared

GATE = 11.345
"""99 % of chi squared with three degrees of freedom."""
STEP_M, STEP_RAD = 2e-3, 1e-3
"""A step below both ends the optimisation."""
NEGLIGIBLE = 1e-6
"""Weight from which on down an edge is not heard in a step."""
NEGLIGIBLE_DAMPING = 1e-9
"""Damping with which poses that nothing ties to the one that is held are some ten metres unsure."""
DECREASE, STALLED_M = 1e-6, 0.1
"""So does a step shorter than this that takes a smaller share off the error."""


@dataclass(frozen=True, slots=True)
class Graph:
    """A pose graph: edges (e, 2), measured (e, 3), information (e, 3, 3), is_closure (e,) bool."""

    edges: Array
    measured: Array
    information: Array
    is_closure: Array
    shared: SharedErrors | None = None
    """What odometry has in common, whose edges always have a weight of 1; None where it errs by noise alone."""

    @property
    def parts(self) -> tuple[Array, Array, Array, Array]:
        """Its four arrays, in the order of `optimise`."""
        return self.edges, self.measured, self.information, self.is_closure

    def of(self, kept: Array) -> Graph:
        """The graph of some edges: (e,) bool or indices."""
        edges, measured, information, is_closure = (part[kept] for part in self.parts)
        return Graph(edges, measured, information, is_closure, None if self.shared is None else self.shared.of(kept))

    def fit(self, poses: Array, weight: Array, iterations_max: int = 100) -> Array:
        """Poses (n, 3) after plain least squares with these weights (e,), pose 0 held; a weight of 0 costs nothing."""
        kept = weight > 0
        if len(poses) < 2 or not kept.any():
            return np.array(poses, float)
        heard = self.of(kept)
        equations = NormalEquations(heard.edges, heard.measured, heard.information, len(poses), 0, heard.shared)
        weight = np.ascontiguousarray(weight[kept], float)
        return equations.minimise(np.array(poses, float), lambda squared: weight, iterations_max)

    def squared_errors(self, poses: Array) -> Array:
        """(e,) squared Mahalanobis length of each residual; odometry's after its robot's shared errors, which cost it
        a part."""
        if self.shared is None:
            return squared_errors(poses, self.edges, self.measured, self.information)
        equations = self.shared.normal_equations(self.information)
        measured, cost = self.shared.corrected(poses, self.edges, self.measured, equations)
        return squared_errors(poses, self.edges, measured, self.information) + cost


def residuals(poses: Array, edges: Array, measured: Array) -> Array:
    """(edges, 3) measured^-1 (a^-1 b) for edges (edges, 2) of indices a, b."""
    return relative_residuals(*_arrays(poses, edges, measured))


def squared_errors(poses: Array, edges: Array, measured: Array, information: Array) -> Array:
    """(edges,) squared Mahalanobis length of each residual."""
    return relative_squared_errors(*_arrays(poses, edges, measured), np.ascontiguousarray(information, float))


def robust_weights(squared: Array, is_closure: Array, config: PoseGraphConfig) -> Array:
    """(edges,) weight in [0, 1]; odometry always 1."""
    scale = config.robust_scale
    if config.robust == "dcs":
        weight = np.minimum(1.0, 2 * scale / (scale + squared)) ** 2
    elif config.robust == "cauchy":
        weight = 1.0 / (1.0 + squared / scale)
    else:
        return np.ones_like(squared)
    return np.where(is_closure, weight, 1.0)


def optimise(
    poses: Array, edges: Array, measured: Array, information: Array, is_closure: Array, config: PoseGraphConfig,
    fixed: int = 0, shared: SharedErrors | None = None,
) -> Array:  # fmt: skip
    """The poses (n, 3) that fit the edges best, pose `fixed` held where it is.

    edges (e, 2) indices, measured (e, 3), information (e, 3, 3), is_closure (e,) bool, shared as of `Graph`. Warm:
    starts from `poses`.
    """
    poses = np.array(poses, float)
    if len(poses) < 2 or len(edges) == 0:
        return poses
    graph = NormalEquations(edges, measured, information, len(poses), fixed, shared)
    return graph.minimise(poses, lambda squared: robust_weights(squared, is_closure, config), config.iterations_max)


class NormalEquations:
    """Gauss-Newton's normal equations of one set of edges, whose sparse pattern is found once."""

    def __init__(
        self,
        edges: Array,
        measured: Array,
        information: Array,
        count: int,
        fixed: int | Array,
        shared: SharedErrors | None = None,
    ):
        """fixed: a pose that is held where it is, or several (k,). Raises DataError for edges between other poses."""
        self.edges = np.ascontiguousarray(edges, np.int64)
        if self.edges.size and not 0 <= self.edges.min() <= self.edges.max() < count:
            raise DataError(f"edges join poses 0 to {count - 1}; got {self.edges.min()} to {self.edges.max()}")
        self.measured = np.ascontiguousarray(measured, float)
        self.information = np.ascontiguousarray(information, float)
        self._count, self._held = count, np.atleast_1d(np.asarray(fixed, np.int64))
        self._fewer: tuple[bytes, NormalEquations] | None = None
        self._shared = shared
        self._of_errors = () if shared is None else shared.normal_equations(self.information)
        pairs = self.edges.copy()
        is_held = np.zeros(count, bool)
        is_held[self._held] = True
        pairs[is_held[pairs]] = -1
        unknowns = count
        if shared is not None:
            unknowns += shared.count
            pairs = np.concatenate([pairs, *(self._with_errors(ends, shared.owner) for ends in pairs.T)])
        self._cholesky = BlockCholesky(pairs, unknowns)
        self._blocks = self._cholesky.block_of_pair

    def _with_errors(self, ends: Array, owner: Array) -> Array:
        """(edges, 2) pairs of one end of each edge and the errors of its robot, which stand after all poses."""
        return np.stack([np.where(owner < 0, -1, ends), self._count + owner], axis=1)

    def squared_errors(self, poses: Array) -> Array:
        """(edges,) as `Graph.squared_errors`."""
        if self._shared is None:
            return relative_squared_errors(poses, self.edges, self.measured, self.information)
        measured, cost = self._shared.corrected(poses, self.edges, self.measured, self._of_errors)
        return relative_squared_errors(poses, self.edges, measured, self.information) + cost

    def linearise(self, poses: Array, weight: Array) -> tuple[Array, Array, Array]:
        """Diagonal blocks (n, 3, 3), blocks of the edges' pairs, gradient (n, 3); held poses have unit blocks.

        Where robots have shared errors, their rows follow those of the poses.
        """
        block_count, measured, shared = int(self._blocks.max(initial=-1)) + 1, self.measured, self._shared
        if shared is not None:
            measured, _ = shared.corrected(poses, self.edges, measured, self._of_errors)
        between_poses = self._blocks[: len(self.edges)]
        found = linearise_relative(
            poses, self.edges, measured, self.information, weight, between_poses, block_count, self._held
        )
        if shared is None:
            return found
        diagonal, blocks, gradient = found
        rest = np.zeros((shared.count, 3, 3))
        diagonal, gradient = np.concatenate([diagonal, rest]), np.concatenate([gradient, rest[:, 0]])
        block_of_ends = self._blocks[len(self.edges) :].reshape(2, -1).T
        said = self._of_errors[0]
        linearise_shared(poses, self.edges, measured, said, shared.owner, shared.bends, block_of_ends, diagonal, blocks)
        return diagonal, blocks, gradient

    def minimise(
        self, poses: Array, weigh, iterations_max: int, step_m: float = STEP_M, step_rad: float = STEP_RAD
    ) -> Array:
        """Poses after damped steps, the last of them shorter than step_m and step_rad.

        `weigh` gives the weights (edges,) at squared errors (edges,).
        """
        damping = 1e-6
        squared = self.squared_errors(poses)
        for _ in range(iterations_max):
            weight = weigh(squared)
            step = self._step(poses, weight, float(weight @ squared), damping)
            if step is None:
                break
            before, (poses, squared, moved_m, moved_rad) = float(weight @ squared), step
            damping = max(damping / 10, 1e-12)
            stalled = before - weight @ squared < DECREASE * before and moved_m < STALLED_M
            if stalled or (moved_m < step_m and moved_rad < step_rad):
                break
        return poses

    def _step(self, poses: Array, weight: Array, cost: float, damping: float):
        """One damped step that does not raise the cost: poses, squared errors, longest moves; None if there is none."""
        heard, its_weight = self._heard(weight)
        for _ in range(8):
            is_sound, moved, moved_m, moved_rad = heard._go(poses, its_weight, damping)
            if is_sound:
                squared = self.squared_errors(moved)
                if weight @ squared <= cost * (1 + 1e-12):
                    return moved, squared, moved_m, moved_rad
            damping = max(damping * 10, 1e-9)
        return None

    def _go(self, poses: Array, weight: Array, damping: float) -> tuple[bool, Array, float, float]:
        """Poses after one damped step, and its longest moves [m, rad]; False: the equations have no one solution."""
        cholesky = self._cholesky
        if cholesky.has_dense_rest or self._shared is not None:
            return self._go_in_parts(poses, weight, damping)
        return sparse_step(
            poses, self.edges, self.measured, self.information, weight, self._blocks, self._held,
            *cholesky.pattern, cholesky.block_count, damping,
        )  # fmt: skip

    def answers(self, poses: Array, right: Array) -> Array:
        """H^-1 right (k, n, 3) for several right sides at these poses, every edge believed."""
        diagonal, blocks, _ = self.linearise(poses, np.ones(len(self.edges)))
        sides, diagonal = np.zeros((len(right), *diagonal.shape[:2])), damped(diagonal, NEGLIGIBLE_DAMPING)
        sides[:, : len(poses)] = right
        return np.array([self._cholesky.solve(diagonal, blocks, side) for side in sides])[:, : len(poses)]

    def _go_in_parts(self, poses: Array, weight: Array, damping: float) -> tuple[bool, Array, float, float]:
        diagonal, blocks, gradient = self.linearise(poses, weight)
        delta = self._cholesky.solve(damped(diagonal, damping), blocks, gradient)
        return (False, poses, 0.0, 0.0) if delta is None else (True, *moved_by(poses, delta[: len(poses)], self._held))

    def _heard(self, weight: Array) -> tuple[NormalEquations, Array]:
        """The equations of edges that are not weighed away, where these are so few that a smaller pattern pays."""
        heard = weight > NEGLIGIBLE
        if np.count_nonzero(heard) > 0.8 * len(weight):
            return self, weight
        key = heard.tobytes()
        if self._fewer is None or self._fewer[0] != key:
            edges, measured, information = self.edges[heard], self.measured[heard], self.information[heard]
            shared = None if self._shared is None else self._shared.of(heard)
            self._fewer = key, NormalEquations(edges, measured, information, self._count, self._held, shared)
        return self._fewer[1], weight[heard]


def _arrays(poses: Array, edges: Array, measured: Array) -> tuple[Array, Array, Array]:
    return (
        np.ascontiguousarray(poses, float),
        np.ascontiguousarray(edges, np.int64),
        np.ascontiguousarray(measured, float),
    )
