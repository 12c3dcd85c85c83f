"""A pose graph without some of its nodes: odometry joined past them, closures handed to those that stay.

Exact marginalisation would tie all neighbours of a node to each other. Kept is what joins them along the path, as by
the trees of Kretzschmar and Stachniss (2012): odometry from one node that stays to the next, with the covariance of the
whole stretch, and of the closures of the stretch the best for nodes at its ends that have few. What is said again of
two nodes is put into one.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.kernels import borrowing_kernel, kernel
from twc_env.slam.graph_arrays import ODOMETRY
from twc_env.slam.relative_equations import wrapped
from twc_env.slam.small_matrices import invert3

CLOSURES_MAX = 3
"""A node that has so many closures takes over no other."""
LOOSE_M = 1.0
"""A closure that is known no better than this where it is handed to says too little to be kept."""


@dataclass(frozen=True, slots=True, eq=False)
class Edges:
    """Edges as `GraphArrays` has them."""

    ends: Array
    measured: Array
    information: Array
    closure: Array
    """(edges,) number of the closure, or `ODOMETRY`."""
    is_used: Array

    @property
    def parts(self) -> tuple[Array, Array, Array, Array, Array]:
        """Its arrays, in the order of `GraphArrays`."""
        return self.ends, self.measured, self.information, self.closure, self.is_used

    def numbered(self, number_of: Array) -> Edges:
        """The same edges where closures have other numbers (closures,)."""
        now = self.closure.copy()
        now[now != ODOMETRY] = number_of[now[now != ODOMETRY]]
        return replace(self, closure=now)

    def of(self, kept: Array) -> Edges:
        """Some of the edges: (e,) bool or indices."""
        return Edges(*(part[kept] for part in self.parts))


_Ways = tuple[Array, Array, Array]
"""From where a node that is gone can be found along odometry: (nodes,) the nearer end of the stretch that it was on, -1
for nodes that stay; the motion (nodes, 3) from there; and its covariance (nodes, 3, 3), in the frame of the node that
is gone, as for every way here."""


@borrowing_kernel
def _turn(x, y, heading, covariance):
    """Covariance (3, 3) of twists, in place, as seen from another frame, in which its own is at this pose."""
    c, s = math.cos(heading), math.sin(heading)
    for j in range(3):
        first, second, third = covariance[0, j], covariance[1, j], covariance[2, j]
        covariance[0, j], covariance[1, j] = c * first - s * second + y * third, s * first + c * second - x * third
    for i in range(3):
        first, second, third = covariance[i, 0], covariance[i, 1], covariance[i, 2]
        covariance[i, 0], covariance[i, 1] = c * first - s * second + y * third, s * first + c * second - x * third


@borrowing_kernel
def _go_on(motion, covariance, further, further_covariance):
    """Make a way, in place, the one that goes on by another."""
    c, s = math.cos(further[2]), math.sin(further[2])
    x, y = -c * further[0] - s * further[1], s * further[0] - c * further[1]
    _turn(x, y, -further[2], covariance)
    for i in range(3):
        for j in range(3):
            covariance[i, j] += further_covariance[i, j]
    c, s = math.cos(motion[2]), math.sin(motion[2])
    motion[0] += c * further[0] - s * further[1]
    motion[1] += s * further[0] + c * further[1]
    motion[2] = wrapped(motion[2] + further[2])


@borrowing_kernel
def _reverse(motion, covariance):
    """Make a way, in place, the one back."""
    _turn(motion[0], motion[1], motion[2], covariance)
    c, s = math.cos(motion[2]), math.sin(motion[2])
    motion[0], motion[1] = -c * motion[0] - s * motion[1], s * motion[0] - c * motion[1]
    motion[2] = wrapped(-motion[2])


@kernel
def _agree(motion, covariance, other, other_covariance):
    """Make a way, in place, the mean of itself and another one between the same nodes, each as it is known."""
    says, other_says = np.empty((3, 3)), np.empty((3, 3))
    invert3(covariance, says)
    invert3(other_covariance, other_says)
    invert3(says + other_says, covariance)
    c, s = math.cos(motion[2]), math.sin(motion[2])
    dx, dy = other[0] - motion[0], other[1] - motion[1]
    away, pull, step = np.empty(3), np.zeros(3), np.zeros(3)
    away[0], away[1], away[2] = c * dx + s * dy, c * dy - s * dx, wrapped(other[2] - motion[2])
    for i in range(3):
        for j in range(3):
            pull[i] += other_says[i, j] * away[j]
    for i in range(3):
        for j in range(3):
            step[i] += covariance[i, j] * pull[j]
    motion[0] += c * step[0] - s * step[1]
    motion[1] += s * step[0] + c * step[1]
    motion[2] = wrapped(motion[2] + step[2])


@borrowing_kernel
def _spread_m2(covariance):
    return covariance[0, 0] + covariance[1, 1]


@kernel
def _inverted(matrices):
    out = np.empty_like(matrices)
    for k in range(matrices.shape[0]):
        invert3(matrices[k], out[k])
    return out


@kernel
def _past(ends, measured, covariances, is_gone):
    """The stretches of odometry between nodes that stay: their ends (k, 2) and ways; and `_Ways` of the other nodes."""
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
            _go_on(whole[count], whole_covariances[count], measured[edge], covariances[edge])
            node = ends[edge, 1]
            if is_gone[node]:
                passed[length] = node
                length += 1
                starts[node], motions[node], spreads[node] = start, whole[count], whole_covariances[count]
        stretches[count, 0], stretches[count, 1] = start, node
        count += 1
        further[:], further_spread[:] = 0.0, 0.0
        for k in range(length - 1, -1, -1):  # from the other end
            edge = edge_from[passed[k]]
            back[:], back_spread[:] = measured[edge], covariances[edge]
            _go_on(back, back_spread, further, further_spread)
            further[:], further_spread[:] = back, back_spread
            if _spread_m2(back_spread) < _spread_m2(spreads[passed[k]]):
                _reverse(back, back_spread)
                starts[passed[k]], motions[passed[k]], spreads[passed[k]] = node, back, back_spread
    return stretches[:count], whole[:count], whole_covariances[:count], starts, motions, spreads


@kernel
def _move(ends, measured, covariances, starts, motions, spreads):
    """Make of closures, in place, ones of the nodes that stay, by `_Ways`; gives how loose each is then [m2]."""
    loose, back, back_spread = np.empty(ends.shape[0]), np.empty(3), np.empty((3, 3))
    for e in range(ends.shape[0]):
        i, j = ends[e, 0], ends[e, 1]
        if starts[i] >= 0:
            ends[e, 0] = starts[i]
            back[:], back_spread[:] = motions[i], spreads[i]
            _go_on(back, back_spread, measured[e], covariances[e])
            measured[e], covariances[e] = back, back_spread
        if starts[j] >= 0:
            ends[e, 1] = starts[j]
            back[:], back_spread[:] = motions[j], spreads[j]
            _reverse(back, back_spread)
            _go_on(measured[e], covariances[e], back, back_spread)
        loose[e] = _spread_m2(covariances[e])
    return loose


@kernel
def _choose(order, own, pairs, ends, measured, covariances, counts):
    """Which closures (e,) stay, of which the first `own` do: those that come after in this order, the best first, where
    both nodes have few. Others between the same two nodes, which `pairs` (e,) numbers, are put into one, in place.

    counts (nodes,) of the closures at each node.
    """
    stays, said = np.zeros(ends.shape[0], np.bool_), np.full(ends.shape[0], -1)
    for e in range(own):
        stays[e], said[pairs[e]] = True, e
    for e in order:
        i, j, other = ends[e, 0], ends[e, 1], said[pairs[e]]
        if i == j or _spread_m2(covariances[e]) > LOOSE_M**2:
            continue
        if other >= 0:
            if ends[other, 0] != i:
                _reverse(measured[e], covariances[e])
            _agree(measured[other], covariances[other], measured[e], covariances[e])
        elif min(counts[i], counts[j]) < CLOSURES_MAX:
            stays[e], said[pairs[e]] = True, e
            counts[i] += 1
            counts[j] += 1
    return stays


def thinned(edges: Edges, is_gone: Array) -> Edges:
    """The edges of the graph without the nodes that are gone (nodes,) bool.

    Each robot's first and last node must stay.
    """
    is_touched = is_gone[edges.ends].any(axis=1)
    is_odometry = edges.closure == ODOMETRY
    joined, ways = _joined(edges.of(is_touched & is_odometry), is_gone)
    is_tie = ~is_odometry & edges.is_used
    ties = _handed(edges.of(is_tie & ~is_touched), edges.of(is_tie & is_touched), ways)
    rest = edges.of(~is_touched & ~is_tie)
    return Edges(*(np.concatenate(parts) for parts in zip(rest.parts, joined.parts, ties.parts, strict=True)))


def _joined(edges: Edges, is_gone: Array) -> tuple[Edges, _Ways]:
    """Odometry past the nodes that are gone, and where these are along it."""
    ends, motions, covariances, *ways = _past(edges.ends, edges.measured, _inverted(edges.information), is_gone)
    count = len(ends)
    joined = Edges(ends, motions, _inverted(covariances), np.full(count, ODOMETRY, np.int64), np.ones(count, bool))
    return joined, (ways[0], ways[1], ways[2])


def _handed(own: Edges, edges: Edges, ways: _Ways) -> Edges:
    """Closures of nodes that stay, with what those of nodes that are gone say of them; and the best of these."""
    count = len(own.ends)
    ends, measured = (np.concatenate(parts) for parts in ((own.ends, edges.ends), (own.measured, edges.measured)))
    covariances = _inverted(np.concatenate([own.information, edges.information]))
    loose_m2 = _move(ends[count:], measured[count:], covariances[count:], *ways)
    pairs = np.unique(np.sort(ends, axis=1), axis=0, return_inverse=True)[1].ravel()
    order = count + np.argsort(loose_m2, kind="stable")
    counts = np.bincount(own.ends.ravel(), minlength=len(ways[0]))
    stays = _choose(order, count, pairs, ends, measured, covariances, counts)
    numbers, is_used = np.concatenate([own.closure, edges.closure]), np.ones(len(ends), bool)
    return Edges(ends, measured, _inverted(covariances), numbers, is_used).of(stays)
