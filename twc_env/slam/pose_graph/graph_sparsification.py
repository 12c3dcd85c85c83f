"""Approximate marginalisation of nodes of a pose graph that keeps it sparse.

Exact marginalisation would connect all neighbours of a removed node. As with the trees of Kretzschmar and Stachniss
(2012), odometry edges along removed nodes are composed into one edge between kept nodes. Closures of removed nodes are
transferred along odometry to the nearer kept node; the most precise ones are kept, for nodes with few closures.
Closures between the same two nodes are fused.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.kernels.compiled import borrowing_kernel, kernel
from twc_env.kernels.small_matrices import invert3
from twc_env.slam.pose_graph.graph_arrays import ODOMETRY
from twc_env.slam.pose_graph.relative_equations import wrapped

CLOSURES_MAX = 3
"""A closure is transferred only if one of its nodes has fewer closures than this."""
LOOSE_M = 1.0
"""Transferred closures with a larger position standard deviation are dropped."""


@dataclass(frozen=True, slots=True, eq=False)
class Edges:
    """Edges of a pose graph, in the arrays of `GraphArrays`."""

    ends: Array
    measured: Array
    information: Array
    closure: Array
    """(edges,) number of the closure, or `ODOMETRY`."""
    is_used: Array

    @property
    def parts(self) -> tuple[Array, Array, Array, Array, Array]:
        """The arrays, in the order of `GraphArrays`."""
        return self.ends, self.measured, self.information, self.closure, self.is_used

    def numbered(self, number_of: Array) -> Edges:
        """The edges with renumbered closures; number_of (closures,): new numbers."""
        now = self.closure.copy()
        now[now != ODOMETRY] = number_of[now[now != ODOMETRY]]
        return replace(self, closure=now)

    def of(self, kept: Array) -> Edges:
        """Subset of the edges: (e,) bool or indices."""
        return Edges(*(part[kept] for part in self.parts))


_Offsets = tuple[Array, Array, Array]
"""Pose of each removed node relative to a kept one: (nodes,) the better known end of its odometry stretch, -1 for kept
nodes; the pose (nodes, 3); its covariance (nodes, 3, 3), as for all motions here in the frame of the motion's end."""


@borrowing_kernel
def _transform_covariance(x, y, heading, covariance):
    """Transform a twist covariance (3, 3), in place, to the frame in which its own frame has this pose (adjoint)."""
    c, s = math.cos(heading), math.sin(heading)
    for j in range(3):
        first, second, third = covariance[0, j], covariance[1, j], covariance[2, j]
        covariance[0, j], covariance[1, j] = c * first - s * second + y * third, s * first + c * second - x * third
    for i in range(3):
        first, second, third = covariance[i, 0], covariance[i, 1], covariance[i, 2]
        covariance[i, 0], covariance[i, 1] = c * first - s * second + y * third, s * first + c * second - x * third


@borrowing_kernel
def _copy(motion, covariance, into, covariance_into):
    """Write a motion and its covariance into others: by loops, as assigning slices takes seconds to compile."""
    for i in range(3):
        into[i] = motion[i]
        for j in range(3):
            covariance_into[i, j] = covariance[i, j]


@borrowing_kernel
def _compose_with(motion, covariance, further, further_covariance):
    """Compose a motion and its covariance, in place, with a further motion."""
    c, s = math.cos(further[2]), math.sin(further[2])
    x, y = -c * further[0] - s * further[1], s * further[0] - c * further[1]
    _transform_covariance(x, y, -further[2], covariance)
    for i in range(3):
        for j in range(3):
            covariance[i, j] += further_covariance[i, j]
    c, s = math.cos(motion[2]), math.sin(motion[2])
    motion[0] += c * further[0] - s * further[1]
    motion[1] += s * further[0] + c * further[1]
    motion[2] = wrapped(motion[2] + further[2])


@borrowing_kernel
def _reverse(motion, covariance):
    """Invert a motion and its covariance, in place."""
    _transform_covariance(motion[0], motion[1], motion[2], covariance)
    c, s = math.cos(motion[2]), math.sin(motion[2])
    motion[0], motion[1] = -c * motion[0] - s * motion[1], s * motion[0] - c * motion[1]
    motion[2] = wrapped(-motion[2])


@kernel
def _fuse_with(motion, covariance, other, other_covariance):
    """Fuse a motion, in place, with another one between the same nodes, weighted by information."""
    information, other_information = np.empty((3, 3)), np.empty((3, 3))
    invert3(covariance, information)
    invert3(other_covariance, other_information)
    invert3(information + other_information, covariance)
    c, s = math.cos(motion[2]), math.sin(motion[2])
    dx, dy = other[0] - motion[0], other[1] - motion[1]
    away, pull, step = np.empty(3), np.zeros(3), np.zeros(3)
    away[0], away[1], away[2] = c * dx + s * dy, c * dy - s * dx, wrapped(other[2] - motion[2])
    for i in range(3):
        for j in range(3):
            pull[i] += other_information[i, j] * away[j]
    for i in range(3):
        for j in range(3):
            step[i] += covariance[i, j] * pull[j]
    motion[0] += c * step[0] - s * step[1]
    motion[1] += s * step[0] + c * step[1]
    motion[2] = wrapped(motion[2] + step[2])


@borrowing_kernel
def _variance_m2(covariance):
    return covariance[0, 0] + covariance[1, 1]


@kernel
def _inverted(matrices):
    out = np.empty_like(matrices)
    for k in range(matrices.shape[0]):
        invert3(matrices[k], out[k])
    return out


@kernel
def _bypass(ends, measured, covariances, is_gone):
    """Odometry composed between kept nodes: ends (k, 2), motions, covariances; and the `_Offsets` of removed nodes."""
    count, edge_from = 0, np.full(is_gone.shape[0], -1)
    for e in range(ends.shape[0]):
        edge_from[ends[e, 0]] = e
    stretches, whole, whole_covariances = np.empty_like(ends), np.zeros_like(measured), np.zeros_like(covariances)
    starts, passed = np.full(is_gone.shape[0], -1), np.empty(is_gone.shape[0], np.int64)
    motions, spreads = np.zeros((is_gone.shape[0], 3)), np.zeros((is_gone.shape[0], 3, 3))
    back, back_spread, further, further_spread = np.empty(3), np.empty((3, 3)), np.empty(3), np.empty((3, 3))
    for start in range(is_gone.shape[0]):
        if is_gone[start] or edge_from[start] < 0:
            continue
        node, length = start, 0
        while edge_from[node] >= 0 and (node == start or is_gone[node]):
            edge = edge_from[node]
            _compose_with(whole[count], whole_covariances[count], measured[edge], covariances[edge])
            node = ends[edge, 1]
            if is_gone[node]:
                passed[length] = node
                length += 1
                starts[node] = start
                _copy(whole[count], whole_covariances[count], motions[node], spreads[node])
        stretches[count, 0], stretches[count, 1] = start, node
        count += 1
        further[:], further_spread[:] = 0.0, 0.0
        for k in range(length - 1, -1, -1):  # backwards: relative to the stretch's other end, if that is more certain
            edge = edge_from[passed[k]]
            _copy(measured[edge], covariances[edge], back, back_spread)
            _compose_with(back, back_spread, further, further_spread)
            _copy(back, back_spread, further, further_spread)
            if _variance_m2(back_spread) < _variance_m2(spreads[passed[k]]):
                _reverse(back, back_spread)
                starts[passed[k]] = node
                _copy(back, back_spread, motions[passed[k]], spreads[passed[k]])
    return stretches[:count], whole[:count], whole_covariances[:count], starts, motions, spreads


@kernel
def _transfer(ends, measured, covariances, starts, motions, spreads):
    """Transfer closures, in place, from removed to kept nodes by `_Offsets`; returns their position variances [m2]."""
    loose, back, back_spread = np.empty(ends.shape[0]), np.empty(3), np.empty((3, 3))
    for e in range(ends.shape[0]):
        i, j = ends[e, 0], ends[e, 1]
        if starts[i] >= 0:
            ends[e, 0] = starts[i]
            _copy(motions[i], spreads[i], back, back_spread)
            _compose_with(back, back_spread, measured[e], covariances[e])
            _copy(back, back_spread, measured[e], covariances[e])
        if starts[j] >= 0:
            ends[e, 1] = starts[j]
            _copy(motions[j], spreads[j], back, back_spread)
            _reverse(back, back_spread)
            _compose_with(measured[e], covariances[e], back, back_spread)
        loose[e] = _variance_m2(covariances[e])
    return loose


@kernel
def _select(order, own, pairs, ends, measured, covariances, counts):
    """(e,) bool: closures to keep: the first `own`, and in this order others of which a node has few closures.

    pairs (e,): index of each closure's pair of nodes; further closures of a pair are fused into its first, in place.
    counts (nodes,): closures at each node, updated.
    """
    stays, fused_into = np.zeros(ends.shape[0], np.bool_), np.full(ends.shape[0], -1)
    for e in range(own):
        stays[e], fused_into[pairs[e]] = True, e
    for e in order:
        i, j, other = ends[e, 0], ends[e, 1], fused_into[pairs[e]]
        if i == j or _variance_m2(covariances[e]) > LOOSE_M**2:
            continue
        if other >= 0:
            if ends[other, 0] != i:
                _reverse(measured[e], covariances[e])
            _fuse_with(measured[other], covariances[other], measured[e], covariances[e])
        elif min(counts[i], counts[j]) < CLOSURES_MAX:
            stays[e], fused_into[pairs[e]] = True, e
            counts[i] += 1
            counts[j] += 1
    return stays


def sparsified(edges: Edges, is_gone: Array) -> Edges:
    """The edges after removal of nodes, is_gone (nodes,) bool. Each robot's first and last node must be kept."""
    is_touched = is_gone[edges.ends].any(axis=1)
    is_odometry = edges.closure == ODOMETRY
    joined, offsets = _joined_odometry(edges.of(is_touched & is_odometry), is_gone)
    is_active = ~is_odometry & edges.is_used
    closures = _transferred_closures(edges.of(is_active & ~is_touched), edges.of(is_active & is_touched), offsets)
    rest = edges.of(~is_touched & ~is_active)
    return Edges(*(np.concatenate(parts) for parts in zip(rest.parts, joined.parts, closures.parts, strict=True)))


def _joined_odometry(edges: Edges, is_gone: Array) -> tuple[Edges, _Offsets]:
    """Odometry edges composed along removed nodes, and the `_Offsets` of these."""
    ends, motions, covariances, *offsets = _bypass(edges.ends, edges.measured, _inverted(edges.information), is_gone)
    count = len(ends)
    joined = Edges(ends, motions, _inverted(covariances), np.full(count, ODOMETRY, np.int64), np.ones(count, bool))
    return joined, (offsets[0], offsets[1], offsets[2])


def _transferred_closures(own: Edges, edges: Edges, offsets: _Offsets) -> Edges:
    """Closures between kept nodes (own), and the transferred ones that are kept."""
    count = len(own.ends)
    ends, measured = (np.concatenate(parts) for parts in ((own.ends, edges.ends), (own.measured, edges.measured)))
    covariances = _inverted(np.concatenate([own.information, edges.information]))
    loose_m2 = _transfer(ends[count:], measured[count:], covariances[count:], *offsets)
    pairs = np.unique(np.sort(ends, axis=1), axis=0, return_inverse=True)[1].ravel()
    order = count + np.argsort(loose_m2, kind="stable")
    counts = np.bincount(own.ends.ravel(), minlength=len(offsets[0]))
    stays = _select(order, count, pairs, ends, measured, covariances, counts)
    numbers, is_used = np.concatenate([own.closure, edges.closure]), np.ones(len(ends), bool)
    return Edges(ends, measured, _inverted(covariances), numbers, is_used).of(stays)
