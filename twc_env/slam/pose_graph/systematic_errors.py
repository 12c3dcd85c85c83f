"""Systematic odometry errors of each robot as unknowns of the pose graph: scale and curl (heading per metre).

Without scan matching these dominate noise after some metres: the error of a path grows with its length and not with the
square root of it, and a closure that determines the length of one part determines that of all. Each robot's errors are
unknowns beside its poses (self-calibration as in Kuemmerle, Grisetti and Burgard 2011), eliminated with them in one
sparse factorisation; at given poses they have a closed-form solution.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.kernels.compiled import kernel
from twc_env.kernels.small_matrices import invert3
from twc_env.slam.pose_graph.relative_equations import relative_residuals, wrapped

CURL_STD_RAD_M = 0.006
"""Prior of the curl: unequal wheels, and the part of the gyro bias that is not yet estimated."""
UNOWNED = -1


@dataclass(frozen=True, slots=True, eq=False)
class SharedErrors:
    """Dependence of each edge of a graph on the systematic errors of its robot."""

    owner: Array
    """(e,) robot whose odometry an edge is, counted from 0; `UNOWNED` for other edges."""
    bends: Array
    """(e, 3, 3) change of an edge's residual by errors of one standard deviation; the third column is unused."""

    @property
    def count(self) -> int:
        """Number of robots."""
        return int(self.owner.max(initial=UNOWNED)) + 1

    def of(self, kept: Array) -> SharedErrors:
        """The subset for some edges: (e,) bool or indices."""
        return SharedErrors(self.owner[kept], self.bends[kept])

    def and_none(self, count: int) -> SharedErrors:
        """With this many unowned edges appended."""
        bends = np.concatenate([self.bends, np.zeros((count, 3, 3))])
        return SharedErrors(np.concatenate([self.owner, np.full(count, UNOWNED)]), bends)

    def normal_equations(self, information: Array) -> tuple[Array, ...]:
        """For `corrected`, of edges with this information (e, 3, 3): bends^T information (e, 3, 3), the covariance of
        the errors (robots, 3, 3), and the number of edges of each robot (robots,)."""
        return _normal_equations(information, self.owner, self.bends, self.count)

    def corrected(
        self, poses: Array, edges: Array, measured: Array, equations: tuple[Array, ...]
    ) -> tuple[Array, Array]:
        """Measurements (e, 3) without the errors that poses show best; (e,) each edge's share of what these cost."""
        return _corrected(poses, edges, measured, self.owner, self.bends, *equations)


def shared_errors(owner: Array, measured: Array, length_m: Array, scale_std: float) -> SharedErrors:
    """For edges with measurements (e, 3) over path lengths (e,), owned by robots (e,)."""
    c, s = np.cos(measured[:, 2]), np.sin(measured[:, 2])
    ahead, left = c * measured[:, 0] + s * measured[:, 1], c * measured[:, 1] - s * measured[:, 0]
    curl = CURL_STD_RAD_M * length_m
    bends = np.zeros((len(owner), 3, 3))
    bends[:, 0, 0], bends[:, 1, 0] = scale_std * ahead, scale_std * left
    bends[:, 0, 1], bends[:, 1, 1], bends[:, 2, 1] = -0.5 * curl * left, 0.5 * curl * ahead, curl
    bends[owner == UNOWNED] = 0.0
    return SharedErrors(owner, bends)


def std_with_shared(std: Array, length_m: Array, scale_std: float) -> Array:
    """Standard deviations (k, 3) over path lengths (k,), with the systematic errors added."""
    shared = length_m[:, None] * np.array([scale_std, scale_std, CURL_STD_RAD_M])
    return np.hypot(std, shared)


@kernel
def _add_product(a, b, out):
    """Add a b to out, all (3, 3)."""
    for i in range(3):
        for j in range(3):
            for k in range(3):
                out[i, j] += a[i, k] * b[k, j]


@kernel
def _normal_equations(information, owner, bends, count):
    """See `SharedErrors.normal_equations`."""
    says, normal, edge_counts = np.zeros(bends.shape), np.zeros((count, 3, 3)), np.zeros(count)
    for e in range(len(owner)):
        if owner[e] < 0:
            continue
        for i in range(3):
            for j in range(3):
                for k in range(3):
                    says[e, i, j] += bends[e, k, i] * information[e, k, j]
        _add_product(says[e], bends[e], normal[owner[e]])
        edge_counts[owner[e]] += 1
    covariance = np.empty((count, 3, 3))
    for k in range(count):
        for i in range(3):
            normal[k, i, i] += 1.0
        invert3(normal[k], covariance[k])
    return says, covariance, edge_counts


@kernel
def _corrected(poses, edges, measured, owner, bends, says, covariance, edge_counts):
    """See `SharedErrors.corrected`."""
    residuals, count = relative_residuals(poses, edges, measured), len(covariance)
    right, errors, cost = np.zeros((count, 3)), np.zeros((count, 3)), np.zeros(count)
    for e in range(len(edges)):
        k = owner[e]
        if k < 0:
            continue
        for i in range(3):
            for j in range(3):
                right[k, i] += says[e, i, j] * residuals[e, j]
    for k in range(count):
        for i in range(3):
            for j in range(3):
                errors[k, i] += covariance[k, i, j] * right[k, j]
            cost[k] += errors[k, i] ** 2 / max(edge_counts[k], 1.0)
    out, shares, off = measured.copy(), np.zeros(len(edges)), np.empty(3)
    for e in range(len(edges)):
        k = owner[e]
        if k < 0:
            continue
        for i in range(3):
            off[i] = 0.0
            for j in range(3):
                off[i] += bends[e, i, j] * errors[k, j]
        c, s = np.cos(measured[e, 2]), np.sin(measured[e, 2])
        out[e, 0] += c * off[0] - s * off[1]
        out[e, 1] += s * off[0] + c * off[1]
        out[e, 2] = wrapped(out[e, 2] + off[2])
        shares[e] = cost[k]
    return out, shares


@kernel
def linearise_shared(poses, edges, measured, said, owner, bends, block_of_ends, diagonal, blocks):
    """Add to diagonal (n + robots, 3, 3) and blocks, in place, what odometry says of its robots' errors.

    said (e, 3, 3): bends^T information. block_of_ends (e, 2): the blocks of an edge's ends with the errors of its
    robot; -1 where an end is held. The derivatives by its two poses are those of `linearise_relative`.
    """
    first = len(poses)
    for k in range(first, len(diagonal)):
        for i in range(3):
            diagonal[k, i, i] += 1.0
    by_first, by_second, says = np.zeros((3, 3)), np.zeros((3, 3)), np.empty((3, 3))
    for e in range(len(edges)):
        if owner[e] < 0:
            continue
        a, b = edges[e, 0], edges[e, 1]
        angle = poses[a, 2] + measured[e, 2]
        c, s = np.cos(angle), np.sin(angle)
        dx, dy = poses[b, 0] - poses[a, 0], poses[b, 1] - poses[a, 1]
        by_second[0, 0], by_second[0, 1], by_second[1, 0], by_second[1, 1], by_second[2, 2] = c, s, -s, c, 1.0
        for i in range(3):
            for j in range(2):
                by_first[i, j] = -by_second[i, j]
        by_first[0, 2], by_first[1, 2], by_first[2, 2] = -s * dx + c * dy, -c * dx - s * dy, -1.0
        _add_product(said[e], bends[e], diagonal[first + owner[e]])
        for i in range(3):
            for j in range(3):
                says[i, j] = -said[e, i, j]
        if block_of_ends[e, 0] >= 0:
            _add_product(says, by_first, blocks[block_of_ends[e, 0]])
        if block_of_ends[e, 1] >= 0:
            _add_product(says, by_second, blocks[block_of_ends[e, 1]])
