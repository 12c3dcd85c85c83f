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
        self._edge_block_count = int(self._blocks.max(initial=-1)) + 1

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
        a, b = edges[e, 0], edges[e, 1]
        heading, zx, zy, turn = poses[a, 2], measured[e, 0], measured[e, 1], measured[e, 2]
        c, s, cz, sz = np.cos(heading), np.sin(heading), np.cos(turn), np.sin(turn)
        dx, dy = poses[b, 0] - poses[a, 0], poses[b, 1] - poses[a, 1]
        ex, ey = c * dx + s * dy - zx, -s * dx + c * dy - zy
        out[e, 0], out[e, 1], out[e, 2] = cz * ex + sz * ey, -sz * ex + cz * ey, _wrap(poses[b, 2] - heading - turn)
    return out


@kernel
def _squared_errors(poses, edges, measured, information):
    out = np.empty(len(edges))
    r = _residuals(poses, edges, measured)
    for e in range(len(edges)):
        x, y, t = r[e, 0], r[e, 1], r[e, 2]
        out[e] = (
            x * (information[e, 0, 0] * x + information[e, 0, 1] * y + information[e, 0, 2] * t)
            + y * (information[e, 1, 0] * x + information[e, 1, 1] * y + information[e, 1, 2] * t)
            + t * (information[e, 2, 0] * x + information[e, 2, 1] * y + information[e, 2, 2] * t)
        )
    return out


@kernel
def _linearise(poses, edges, measured, information, weight, block_of_edge, block_count, fixed):
    """Hessian blocks and gradient of half the weighted squared errors; block holds H[larger index, smaller index].

    The residual's derivatives by the two poses are A = (-R, d; 0, -1) and B = (R, 0; 0, 1) with a turn R; so the first
    two rows of A^T O are those of B^T O with the other sign, and all blocks follow from B^T O A and B^T O B.
    """
    diagonal, blocks = np.zeros((len(poses), 3, 3)), np.zeros((block_count, 3, 3))
    gradient = np.zeros((len(poses), 3))
    r = _residuals(poses, edges, measured)
    for e in range(len(edges)):
        w = weight[e]
        if w == 0.0:
            continue
        i, j = edges[e, 0], edges[e, 1]
        angle = poses[i, 2] + measured[e, 2]
        c, s = np.cos(angle), np.sin(angle)
        dx, dy = poses[j, 0] - poses[i, 0], poses[j, 1] - poses[i, 1]
        d0, d1 = -s * dx + c * dy, -c * dx - s * dy
        o00, o01, o02 = w * information[e, 0, 0], w * information[e, 0, 1], w * information[e, 0, 2]
        o10, o11, o12 = w * information[e, 1, 0], w * information[e, 1, 1], w * information[e, 1, 2]
        o20, o21, o22 = w * information[e, 2, 0], w * information[e, 2, 1], w * information[e, 2, 2]
        x00, x01, x02 = c * o00 - s * o10, c * o01 - s * o11, c * o02 - s * o12  # B^T O
        x10, x11, x12 = s * o00 + c * o10, s * o01 + c * o11, s * o02 + c * o12
        y0, y1, y2 = d0 * o00 + d1 * o10 - o20, d0 * o01 + d1 * o11 - o21, d0 * o02 + d1 * o12 - o22  # last of A^T O
        r0, r1, r2 = r[e, 0], r[e, 1], r[e, 2]
        g0, g1 = x00 * r0 + x01 * r1 + x02 * r2, x10 * r0 + x11 * r1 + x12 * r2
        gradient[i, 0] += g0
        gradient[i, 1] += g1
        gradient[i, 2] -= y0 * r0 + y1 * r1 + y2 * r2
        gradient[j, 0] -= g0
        gradient[j, 1] -= g1
        gradient[j, 2] -= o20 * r0 + o21 * r1 + o22 * r2
        h00, h01, h02 = x00 * c - x01 * s, x00 * s + x01 * c, x00 * d0 + x01 * d1 - x02  # B^T O B, and O A's last
        h10, h11, h12 = x10 * c - x11 * s, x10 * s + x11 * c, x10 * d0 + x11 * d1 - x12
        h20, h21, h22 = o20 * c - o21 * s, o20 * s + o21 * c, o20 * d0 + o21 * d1 - o22
        diagonal[j, 0, 0] += h00
        diagonal[j, 0, 1] += h01
        diagonal[j, 0, 2] += x02
        diagonal[j, 1, 0] += h10
        diagonal[j, 1, 1] += h11
        diagonal[j, 1, 2] += x12
        diagonal[j, 2, 0] += h20
        diagonal[j, 2, 1] += h21
        diagonal[j, 2, 2] += o22
        diagonal[i, 0, 0] += h00
        diagonal[i, 0, 1] += h01
        diagonal[i, 0, 2] -= h02
        diagonal[i, 1, 0] += h10
        diagonal[i, 1, 1] += h11
        diagonal[i, 1, 2] -= h12
        diagonal[i, 2, 0] += -y0 * c + y1 * s
        diagonal[i, 2, 1] += -y0 * s - y1 * c
        diagonal[i, 2, 2] += y0 * d0 + y1 * d1 - y2
        block = block_of_edge[e]
        if block < 0:
            continue
        if j > i:
            blocks[block, 0, 0] -= h00
            blocks[block, 0, 1] -= h01
            blocks[block, 0, 2] += h02
            blocks[block, 1, 0] -= h10
            blocks[block, 1, 1] -= h11
            blocks[block, 1, 2] += h12
            blocks[block, 2, 0] -= h20
            blocks[block, 2, 1] -= h21
            blocks[block, 2, 2] += h22
        else:
            blocks[block, 0, 0] -= h00
            blocks[block, 1, 0] -= h01
            blocks[block, 2, 0] += h02
            blocks[block, 0, 1] -= h10
            blocks[block, 1, 1] -= h11
            blocks[block, 2, 1] += h12
            blocks[block, 0, 2] -= h20
            blocks[block, 1, 2] -= h21
            blocks[block, 2, 2] += h22
    for row in range(3):
        for col in range(3):
            diagonal[fixed, row, col] = 1.0 if row == col else 0.0
        gradient[fixed, row] = 0.0
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
