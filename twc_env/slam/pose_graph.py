"""Robust SE(2) pose-graph optimisation: Levenberg-Marquardt with 3 x 3 blocks on a sparse LU factorisation.

Residuals are those of g2o's EDGE_SE2: z^-1 (a^-1 b). Odometry edges keep their weight; closures are down-weighted by
dynamic covariance scaling (DCS) or a Cauchy loss, so that one false closure cannot fold the map.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csc_matrix
from scipy.sparse.linalg import splu

from twc_env.config import PoseGraphConfig
from twc_env.geometry import wrap_angle

Array = NDArray


def residuals(poses: Array, edges: Array, measured: Array) -> Array:
    """(edges, 3) measured^-1 (a^-1 b) for edges (edges, 2) of indices a, b."""
    a, b = poses[edges[:, 0]], poses[edges[:, 1]]
    ca, sa = np.cos(a[:, 2]), np.sin(a[:, 2])
    d = b[:, :2] - a[:, :2]
    ex = ca * d[:, 0] + sa * d[:, 1] - measured[:, 0]
    ey = -sa * d[:, 0] + ca * d[:, 1] - measured[:, 1]
    cz, sz = np.cos(measured[:, 2]), np.sin(measured[:, 2])
    turn = wrap_angle(b[:, 2] - a[:, 2] - measured[:, 2])
    return np.stack([cz * ex + sz * ey, -sz * ex + cz * ey, turn], axis=1)


def squared_errors(poses: Array, edges: Array, measured: Array, information: Array) -> Array:
    """(edges,) squared Mahalanobis length of each residual."""
    r = residuals(poses, edges, measured)
    return np.einsum("ki,kij,kj->k", r, information, r)


def robust_weights(squared: Array, is_closure: Array, config: PoseGraphConfig) -> Array:
    """(edges,) weight in [0, 1]; odometry always 1."""
    scale = config.robust_scale
    if config.robust == "dcs":
        weight = np.minimum(1.0, 2 * scale / (scale + squared)) ** 2
    elif config.robust == "cauchy":
        weight = 1.0 / (1.0 + squared / scale)
    else:
        weight = np.ones_like(squared)
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
    poses = poses.copy()
    if len(poses) < 2 or len(edges) == 0:
        return poses
    pattern = _Pattern(edges, len(poses), fixed)
    damping = 1e-6
    weight = robust_weights(squared_errors(poses, edges, measured, information), is_closure, config)
    for _ in range(config.iterations_max):
        hessian, gradient, cost = pattern.linearise(poses, measured, information * weight[:, None, None])
        moved = _step(pattern, poses, hessian, gradient, cost, damping, measured, information, weight)
        if moved is None:
            break
        step = np.abs(moved - poses)
        poses, damping = moved, max(damping / 10, 1e-12)
        weight = robust_weights(squared_errors(poses, edges, measured, information), is_closure, config)
        if step[:, :2].max() < 2e-3 and np.minimum(step[:, 2], 2 * np.pi - step[:, 2]).max() < 1e-3:
            break
    return poses


def _step(pattern, poses, hessian, gradient, cost, damping, measured, information, weight) -> Array | None:
    """One damped step that does not raise the cost; None when none is found."""
    for _ in range(8):
        delta = pattern.solve(hessian, gradient, damping)
        moved = poses + delta
        moved[:, 2] = wrap_angle(moved[:, 2])
        new_cost = (weight * squared_errors(moved, pattern.edges, measured, information)).sum()
        if new_cost <= cost * (1 + 1e-12):
            return moved
        damping = max(damping * 10, 1e-9)
    return None


class _Pattern:
    """Where each edge's blocks go in the sparse normal equations."""

    def __init__(self, edges: Array, count: int, fixed: int):
        self.edges = edges
        self._count, self._fixed = count, fixed
        unknown = np.arange(count) - (np.arange(count) > fixed)
        unknown[fixed] = -1
        a, b = unknown[edges[:, 0]], unknown[edges[:, 1]]
        k = np.arange(3)
        rows, columns, keep = [], [], []
        for p, q in ((a, a), (a, b), (b, a), (b, b)):
            rows.append((3 * p[:, None, None] + k[:, None] + 0 * k).ravel())
            columns.append((3 * q[:, None, None] + 0 * k[:, None] + k).ravel())
            keep.append(np.repeat((p >= 0) & (q >= 0), 9))
        self._keep = np.concatenate(keep)
        self._rows = np.concatenate(rows)[self._keep]
        self._columns = np.concatenate(columns)[self._keep]

    def linearise(self, poses: Array, measured: Array, information: Array):
        """Hessian, gradient (n, 3) and cost of the weighted squared errors."""
        first, second = _jacobians(poses, self.edges, measured)
        r = residuals(poses, self.edges, measured)
        left_a, left_b = np.swapaxes(first, 1, 2) @ information, np.swapaxes(second, 1, 2) @ information
        blocks = np.concatenate([(left @ right).ravel() for left in (left_a, left_b) for right in (first, second)])
        size = 3 * (self._count - 1)
        hessian = csc_matrix((blocks[self._keep], (self._rows, self._columns)), shape=(size, size))
        gradient = np.zeros((self._count, 3))
        np.add.at(gradient, self.edges[:, 0], (left_a @ r[:, :, None])[..., 0])
        np.add.at(gradient, self.edges[:, 1], (left_b @ r[:, :, None])[..., 0])
        cost = float(np.einsum("ki,kij,kj->", r, information, r))
        return hessian, gradient, cost

    def solve(self, hessian, gradient: Array, damping: float) -> Array:
        """(n, 3) step; the fixed pose does not move."""
        damped = hessian.copy()
        damped.setdiag(hessian.diagonal() * (1 + damping) + 1e-9)
        free = np.delete(gradient, self._fixed, axis=0).ravel()
        factor = splu(damped, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
        step = -factor.solve(free).reshape(-1, 3)
        return np.insert(step, self._fixed, 0.0, axis=0)


def _jacobians(poses: Array, edges: Array, measured: Array) -> tuple[Array, Array]:
    """(edges, 3, 3) derivatives of the residual by the two poses."""
    a, b = poses[edges[:, 0]], poses[edges[:, 1]]
    d = b[:, :2] - a[:, :2]
    angle = a[:, 2] + measured[:, 2]
    c, s = np.cos(angle), np.sin(angle)
    first, second = np.zeros((len(edges), 3, 3)), np.zeros((len(edges), 3, 3))
    second[:, 0, 0], second[:, 0, 1], second[:, 1, 0], second[:, 1, 1], second[:, 2, 2] = c, s, -s, c, 1.0
    first[:, :2, :2] = -second[:, :2, :2]
    first[:, 0, 2] = -s * d[:, 0] + c * d[:, 1]
    first[:, 1, 2] = -c * d[:, 0] - s * d[:, 1]
    first[:, 2, 2] = -1.0
    return first, second
