"""Robust SE(2) pose-graph optimisation: Levenberg-Marquardt with 3 x 3 blocks on a sparse Cholesky factorisation.

Residuals are those of g2o's EDGE_SE2: z^-1 (a^-1 b). Odometry edges keep their weight; closures are down-weighted by
dynamic covariance scaling (DCS) or a Cauchy loss, so that one false closure cannot distort the map.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.config import PoseGraphConfig
from twc_env.errors import DataError
from twc_env.slam.pose_graph.block_cholesky import BlockCholesky
from twc_env.slam.pose_graph.relative_equations import (
    damped,
    linearise_relative,
    moved_by,
    relative_residuals,
    relative_squared_errors,
    sparse_step,
)  # fmt: skip
from twc_env.slam.pose_graph.systematic_errors import SharedErrors, linearise_shared

GATE = 11.345
"""99 % quantile of chi-squared with three degrees of freedom."""
STEP_M, STEP_RAD = 2e-3, 1e-3
"""The optimisation stops below both step sizes."""
NEGLIGIBLE = 1e-6
"""Edges with a smaller weight are left out of a step."""
NEGLIGIBLE_DAMPING = 1e-9
"""With this damping, poses not connected to the fixed one have a standard deviation of about ten metres."""
DECREASE, STALLED_M = 1e-6, 0.1
"""It also stops at a relative decrease of the error below DECREASE with a step shorter than STALLED_M."""


@dataclass(frozen=True, slots=True)
class Graph:
    """A pose graph: edges (e, 2), measured (e, 3), information (e, 3, 3), is_closure (e,) bool."""

    edges: Array
    measured: Array
    information: Array
    is_closure: Array
    shared: SharedErrors | None = None
    """Systematic odometry errors shared by many edges; None if odometry has independent noise only."""

    @property
    def parts(self) -> tuple[Array, Array, Array, Array]:
        """The four arrays in the argument order of `optimise`."""
        return self.edges, self.measured, self.information, self.is_closure

    def of(self, kept: Array) -> Graph:
        """The graph of some edges, chosen by (e,) bool or indices."""
        edges, measured, information, is_closure = (part[kept] for part in self.parts)
        return Graph(edges, measured, information, is_closure, None if self.shared is None else self.shared.of(kept))

    def fit(self, poses: Array, weight: Array, iterations_max: int = 100) -> Array:
        """Poses (n, 3) after least squares with weights (e,), pose 0 fixed; edges of weight 0 are skipped."""
        kept = weight > 0
        if len(poses) < 2 or not kept.any():
            return np.array(poses, float)
        heard = self.of(kept)
        equations = NormalEquations(heard.edges, heard.measured, heard.information, len(poses), 0, heard.shared)
        weight = np.ascontiguousarray(weight[kept], float)
        return equations.minimise(np.array(poses, float), lambda squared: weight, iterations_max)

    def squared_errors(self, poses: Array) -> Array:
        """(e,) squared Mahalanobis length of each residual. Odometry is corrected by the shared errors, whose own cost
        is distributed over its edges."""
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
    """The poses (n, 3) with the least error, pose `fixed` held; starts from `poses`.

    edges (e, 2) indices, measured (e, 3), information (e, 3, 3), is_closure (e,) bool, shared as in `Graph`.
    """
    poses = np.array(poses, float)
    if len(poses) < 2 or len(edges) == 0:
        return poses
    graph = NormalEquations(edges, measured, information, len(poses), fixed, shared)
    return graph.minimise(poses, lambda squared: robust_weights(squared, is_closure, config), config.iterations_max)


class NormalEquations:
    """Gauss-Newton normal equations of one set of edges; the sparsity pattern is analysed once."""

    def __init__(
        self,
        edges: Array,
        measured: Array,
        information: Array,
        count: int,
        fixed: int | Array,
        shared: SharedErrors | None = None,
    ):
        """fixed: index of the pose held fixed, or several (k,). Raises DataError for edges between unknown poses."""
        self.edges = np.ascontiguousarray(edges, np.int64)
        if self.edges.size and not 0 <= self.edges.min() <= self.edges.max() < count:
            raise DataError(f"edges join poses 0 to {count - 1}; got {self.edges.min()} to {self.edges.max()}")
        self.measured = np.ascontiguousarray(measured, float)
        self.information = np.ascontiguousarray(information, float)
        self._count, self._held = count, np.atleast_1d(np.asarray(fixed, np.int64))
        self._active_cache: tuple[bytes, NormalEquations] | None = None
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
        """(edges, 2) pairs of one end of each edge and its owner's shared errors, which are numbered after all
        poses."""
        return np.stack([np.where(owner < 0, -1, ends), self._count + owner], axis=1)

    def squared_errors(self, poses: Array) -> Array:
        """(edges,) as `Graph.squared_errors`."""
        if self._shared is None:
            return relative_squared_errors(poses, self.edges, self.measured, self.information)
        measured, cost = self._shared.corrected(poses, self.edges, self.measured, self._of_errors)
        return relative_squared_errors(poses, self.edges, measured, self.information) + cost

    def linearise(self, poses: Array, weight: Array) -> tuple[Array, Array, Array]:
        """Diagonal blocks (n, 3, 3), off-diagonal blocks, gradient (n, 3); fixed poses have unit blocks.

        Shared errors, if any, have their rows after those of the poses.
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
        """Poses after damped steps until a step is shorter than step_m and step_rad.

        `weigh` maps squared errors (edges,) to weights (edges,).
        """
        damping = 1e-6
        squared = self.squared_errors(poses)
        for _ in range(iterations_max):
            weight = weigh(squared)
            step = self._step(poses, weight, float(weight @ squared), damping)
            if step is None:
                break
            before, (poses, squared, moved_m, moved_rad, damping) = float(weight @ squared), step
            damping = max(damping / 10, 1e-12)
            stalled = before - weight @ squared < DECREASE * before and moved_m < STALLED_M
            if stalled or (moved_m < step_m and moved_rad < step_rad):
                break
        return poses

    def _step(self, poses: Array, weight: Array, cost: float, damping: float):
        """One damped step that does not raise the cost: poses, squared errors, largest moves [m, rad], and the damping
        that it took; None if none is found."""
        heard, its_weight = self._active_equations(weight)
        for _ in range(8):
            is_sound, moved, moved_m, moved_rad = heard._solve_step(poses, its_weight, damping)
            if is_sound:
                squared = self.squared_errors(moved)
                if weight @ squared <= cost * (1 + 1e-12):
                    return moved, squared, moved_m, moved_rad, damping
            damping = max(damping * 10, 1e-9)
        return None

    def _solve_step(self, poses: Array, weight: Array, damping: float) -> tuple[bool, Array, float, float]:
        """Poses after one damped step and its largest moves [m, rad]; False if the equations are singular."""
        cholesky = self._cholesky
        if cholesky.has_dense_rest or self._shared is not None:
            return self._solve_step_in_parts(poses, weight, damping)
        return sparse_step(
            poses, self.edges, self.measured, self.information, weight, self._blocks, self._held,
            *cholesky.pattern, cholesky.block_count, damping,
        )  # fmt: skip

    def solve_right_sides(self, poses: Array, right: Array) -> Array:
        """H^-1 right (k, n, 3) for several right-hand sides at these poses, with all edges at weight 1."""
        diagonal, blocks, _ = self.linearise(poses, np.ones(len(self.edges)))
        sides, diagonal = np.zeros((len(right), *diagonal.shape[:2])), damped(diagonal, NEGLIGIBLE_DAMPING)
        sides[:, : len(poses)] = right
        return np.array([self._cholesky.solve(diagonal, blocks, side) for side in sides])[:, : len(poses)]

    def _solve_step_in_parts(self, poses: Array, weight: Array, damping: float) -> tuple[bool, Array, float, float]:
        diagonal, blocks, gradient = self.linearise(poses, weight)
        delta = self._cholesky.solve(damped(diagonal, damping), blocks, gradient)
        return (False, poses, 0.0, 0.0) if delta is None else (True, *moved_by(poses, delta[: len(poses)], self._held))

    def _active_equations(self, weight: Array) -> tuple[NormalEquations, Array]:
        """The equations without negligible edges, if these are many enough that a smaller pattern pays."""
        heard = weight > NEGLIGIBLE
        if np.count_nonzero(heard) > 0.8 * len(weight):
            return self, weight
        key = heard.tobytes()
        if self._active_cache is None or self._active_cache[0] != key:
            edges, measured, information = self.edges[heard], self.measured[heard], self.information[heard]
            shared = None if self._shared is None else self._shared.of(heard)
            self._active_cache = key, NormalEquations(edges, measured, information, self._count, self._held, shared)
        return self._active_cache[1], weight[heard]


def _arrays(poses: Array, edges: Array, measured: Array) -> tuple[Array, Array, Array]:
    return (
        np.ascontiguousarray(poses, float),
        np.ascontiguousarray(edges, np.int64),
        np.ascontiguousarray(measured, float),
    )
