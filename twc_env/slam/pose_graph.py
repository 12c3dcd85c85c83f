"""Robust SE(2) pose-graph optimisation: Levenberg-Marquardt with 3 x 3 blocks on a sparse Cholesky factorisation.

Residuals are those of g2o's EDGE_SE2: z^-1 (a^-1 b). Odometry edges keep their weight; closures are down-weighted by
dynamic covariance scaling (DCS) or a Cauchy loss, so that one false closure cannot fold the map.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twc_env.config import PoseGraphConfig
from twc_env.kernels import kernel
from twc_env.slam.block_cholesky import BlockCholesky

Array = NDArray

GATE = 11.345
"""99 % of chi squared with three degrees of freedom."""
STEP_M, STEP_RAD = 2e-3, 1e-3
"""A step below both ends the optimisation."""
NEGLIGIBLE = 1e-6
"""Weight from which on down an edge is not heard in a step."""
DECREASE, STALLED_M = 1e-6, 0.1
"""So does a step shorter than this that takes a smaller share off the error."""


@dataclass(frozen=True, slots=True)
class Graph:
    """A pose graph: edges (e, 2), measured (e, 3), information (e, 3, 3), is_closure (e,) bool."""

    edges: Array
    measured: Array
    information: Array
    is_closure: Array

    @property
    def parts(self) -> tuple[Array, Array, Array, Array]:
        """Its four arrays, in the order of `optimise`."""
        return self.edges, self.measured, self.information, self.is_closure

    def of(self, kept: Array) -> Graph:
        """The graph of some edges: (e,) bool or indices."""
        return Graph(*(part[kept] for part in self.parts))

    def fit(self, poses: Array, weight: Array, iterations_max: int = 100) -> Array:
        """Poses after plain least squares with these weights (e,)."""
        return weighted(poses, self.edges, self.measured, self.information, weight, iterations_max)

    def squared_errors(self, poses: Array) -> Array:
        """(e,) squared Mahalanobis length of each residual."""
        return squared_errors(poses, self.edges, self.measured, self.information)


def residuals(poses: Array, edges: Array, measured: Array) -> Array:
    """(edges, 3) measured^-1 (a^-1 b) for edges (edges, 2) of indices a, b."""
    return _residuals(*_arrays(poses, edges, measured))


def squared_errors(poses: Array, edges: Array, measured: Array, information: Array) -> Array:
    """(edges,) squared Mahalanobis length of each residual."""
    return _squared_errors(*_arrays(poses, edges, measured), np.ascontiguousarray(information, float))


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
    poses: Array,
    edges: Array,
    measured: Array,
    information: Array,
    is_closure: Array,
    config: PoseGraphConfig,
    fixed: int = 0,
) -> Array:
    """The poses (n, 3) that fit the edges best, pose `fixed` held where it is.

    edges (e, 2) indices, measured (e, 3), information (e, 3, 3), is_closure (e,) bool. Warm: starts from `poses`.
    """
    poses = np.array(poses, float)
    if len(poses) < 2 or len(edges) == 0:
        return poses
    graph = NormalEquations(edges, measured, information, len(poses), fixed)
    return graph.minimise(poses, lambda squared: robust_weights(squared, is_closure, config), config.iterations_max)


def weighted(
    poses: Array, edges: Array, measured: Array, information: Array, weight: Array, iterations_max: int = 50
) -> Array:
    """As `optimise` with pose 0 held and weights (e,) that do not change; edges of weight 0 cost nothing."""
    kept = weight > 0
    if len(poses) < 2 or not kept.any():
        return np.array(poses, float)
    graph = NormalEquations(edges[kept], measured[kept], information[kept], len(poses), 0)
    weight = np.ascontiguousarray(weight[kept], float)
    return graph.minimise(np.array(poses, float), lambda squared: weight, iterations_max)


class NormalEquations:
    """Gauss-Newton's normal equations of one set of edges, whose sparse pattern is found once."""

    def __init__(self, edges: Array, measured: Array, information: Array, count: int, fixed: int):
        self.edges = np.ascontiguousarray(edges, np.int64)
        self.measured = np.ascontiguousarray(measured, float)
        self.information = np.ascontiguousarray(information, float)
        self._count, self._fixed = count, fixed
        self._fewer: tuple[bytes, NormalEquations] | None = None
        pairs = self.edges.copy()
        pairs[pairs == fixed] = -1
        self._cholesky = BlockCholesky(pairs, count)
        self._blocks = self._cholesky.block_of_pair
        self._edge_block_count = int(self._blocks.max()) + 1

    def squared_errors(self, poses: Array) -> Array:
        """(edges,) squared Mahalanobis length of each residual."""
        return _squared_errors(poses, self.edges, self.measured, self.information)

    def linearise(self, poses: Array, weight: Array) -> tuple[Array, Array, Array]:
        """Diagonal blocks (n, 3, 3), blocks of the edges' pairs, gradient (n, 3); the fixed pose has unit blocks."""
        return _linearise(
            poses,
            self.edges,
            self.measured,
            self.information,
            weight,
            self._blocks,
            self._edge_block_count,
            self._fixed,
        )

    def minimise(self, poses: Array, weigh, iterations_max: int) -> Array:
        """Poses after damped steps; `weigh` gives the weights (edges,) at squared errors (edges,)."""
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
            if stalled or (moved_m < STEP_M and moved_rad < STEP_RAD):
                break
        return poses

    def _step(self, poses: Array, weight: Array, cost: float, damping: float):
        """One damped step that does not raise the cost: poses, squared errors, longest moves; None if there is none."""
        heard, its_weight = self._heard(weight)
        diagonal, blocks, gradient = heard.linearise(poses, its_weight)
        for _ in range(8):
            delta = heard._cholesky.solve(_damped(diagonal, damping), blocks, gradient)
            if delta is not None:
                moved, moved_m, moved_rad = _moved(poses, delta, self._fixed)
                squared = self.squared_errors(moved)
                if weight @ squared <= cost * (1 + 1e-12):
                    return moved, squared, moved_m, moved_rad
            damping = max(damping * 10, 1e-9)
        return None

    def _heard(self, weight: Array) -> tuple[NormalEquations, Array]:
        """The equations of edges that are not weighed away, where these are so few that a smaller pattern pays."""
        heard = weight > NEGLIGIBLE
        if np.count_nonzero(heard) > 0.8 * len(weight):
            return self, weight
        key = heard.tobytes()
        if self._fewer is None or self._fewer[0] != key:
            edges, measured, information = self.edges[heard], self.measured[heard], self.information[heard]
            self._fewer = key, NormalEquations(edges, measured, information, self._count, self._fixed)
        return self._fewer[1], weight[heard]


def _arrays(poses: Array, edges: Array, measured: Array) -> tuple[Array, Array, Array]:
    return (
        np.ascontiguousarray(poses, float),
        np.ascontiguousarray(edges, np.int64),
        np.ascontiguousarray(measured, float),
    )


@kernel
def _wrap(angle):
    return (angle + np.pi) % (2 * np.pi) - np.pi


@kernel
def _residuals(poses, edges, measured):
    out = np.empty((len(edges), 3))
    for e in range(len(edges)):
        a, b, z = poses[edges[e, 0]], poses[edges[e, 1]], measured[e]
        c, s, cz, sz = np.cos(a[2]), np.sin(a[2]), np.cos(z[2]), np.sin(z[2])
        dx, dy = b[0] - a[0], b[1] - a[1]
        ex, ey = c * dx + s * dy - z[0], -s * dx + c * dy - z[1]
        out[e, 0], out[e, 1], out[e, 2] = cz * ex + sz * ey, -sz * ex + cz * ey, _wrap(b[2] - a[2] - z[2])
    return out


@kernel
def _squared_errors(poses, edges, measured, information):
    out = np.empty(len(edges))
    r = _residuals(poses, edges, measured)
    for e in range(len(edges)):
        o, x, y, t = information[e], r[e, 0], r[e, 1], r[e, 2]
        out[e] = (
            x * (o[0, 0] * x + o[0, 1] * y + o[0, 2] * t)
            + y * (o[1, 0] * x + o[1, 1] * y + o[1, 2] * t)
            + t * (o[2, 0] * x + o[2, 1] * y + o[2, 2] * t)
        )
    return out


@kernel
def _linearise(poses, edges, measured, information, weight, block_of_edge, block_count, fixed):
    """Hessian blocks and gradient of half the weighted squared errors; block holds H[larger index, smaller index]."""
    diagonal, blocks = np.zeros((len(poses), 3, 3)), np.zeros((block_count, 3, 3))
    gradient = np.zeros((len(poses), 3))
    first, second = np.zeros((3, 3)), np.zeros((3, 3))  # derivatives of the residual by the two poses
    left, right = np.empty((3, 3)), np.empty((3, 3))  # the same, transposed, times information
    second[2, 2], first[2, 2] = 1.0, -1.0
    r = _residuals(poses, edges, measured)
    for e in range(len(edges)):
        i, j, w, o = edges[e, 0], edges[e, 1], weight[e], information[e]
        if w == 0.0:
            continue
        angle = poses[i, 2] + measured[e, 2]
        c, s = np.cos(angle), np.sin(angle)
        dx, dy = poses[j, 0] - poses[i, 0], poses[j, 1] - poses[i, 1]
        second[0, 0], second[0, 1], second[1, 0], second[1, 1] = c, s, -s, c
        first[0, 0], first[0, 1], first[1, 0], first[1, 1] = -c, -s, s, -c
        first[0, 2], first[1, 2] = -s * dx + c * dy, -c * dx - s * dy
        for row in range(3):
            for col in range(3):
                x, y = 0.0, 0.0
                for k in range(3):
                    x += first[k, row] * o[k, col]
                    y += second[k, row] * o[k, col]
                left[row, col], right[row, col] = w * x, w * y
        for row in range(3):
            for k in range(3):
                gradient[i, row] -= left[row, k] * r[e, k]
                gradient[j, row] -= right[row, k] * r[e, k]
                for col in range(3):
                    diagonal[i, row, col] += left[row, k] * first[k, col]
                    diagonal[j, row, col] += right[row, k] * second[k, col]
        block = block_of_edge[e]
        if block >= 0:
            for row in range(3):
                for col in range(3):
                    x = 0.0
                    for k in range(3):
                        x += right[row, k] * first[k, col]
                    if j > i:
                        blocks[block, row, col] += x
                    else:
                        blocks[block, col, row] += x
    diagonal[fixed] = np.eye(3)
    gradient[fixed] = 0.0
    return diagonal, blocks, gradient


@kernel
def _damped(diagonal, damping):
    out = diagonal.copy()
    for i in range(len(out)):
        for k in range(3):
            out[i, k, k] = out[i, k, k] * (1 + damping) + 1e-9
    return out


@kernel
def _moved(poses, delta, fixed):
    """Poses after a step, and how far a pose went at most [m, rad]; the fixed pose keeps its bits."""
    out = poses.copy()
    moved_m, moved_rad = 0.0, 0.0
    for i in range(len(poses)):
        if i == fixed:
            continue
        out[i, 0] += delta[i, 0]
        out[i, 1] += delta[i, 1]
        out[i, 2] = _wrap(out[i, 2] + delta[i, 2])
        moved_m = max(moved_m, abs(delta[i, 0]), abs(delta[i, 1]))
        moved_rad = max(moved_rad, abs(_wrap(delta[i, 2])))
    return out, moved_m, moved_rad
