"""Pairwise consistency of loop closures: groups of neighbouring closures, and the largest consistent set (PCM).

Two closures are consistent if the loop through both and the odometry between their ends closes within its covariance
(Mangelson et al. 2018, pairwise consistency maximisation).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.kernels.compiled import kernel
from twc_env.records.geometry import compose, inverse
from twc_env.records.twists import adjoint, turned
from twc_env.slam.pose_graph.odometry_chains import Chains
from twc_env.slam.pose_graph.solver import GATE, Graph

WINDOW_STEPS = 10
"""Neighbours of one group are at most this many poses apart at both ends."""


class PairwiseConsistency:
    """Consistency test for pairs of closures.

    Closure k measures the pose T_k = X_i z X_j^-1 of the second chain in the first, with X from odometry. Two closures
    are consistent if the twist of T_a T_b^-1 is explained by their noise and the odometry between their ends.
    """

    def __init__(self, graph: Graph, poses: Array, chains: Chains, closures: Array):
        self.i, self.j = np.ascontiguousarray(graph.edges[closures].T)
        placed = compose(poses[self.i], graph.measured[closures])
        claim = compose(placed, inverse(poses[self.j]))
        noise = turned(adjoint(placed), np.linalg.inv(graph.information[closures]))
        shared = chains.shared_error_columns(poses)
        shared = np.zeros((0, 3, 3)) if shared is None else shared
        odometry = chains.step, chains.accumulated_covariance(poses), shared
        self._arguments = claim, adjoint(claim), noise, self.i, self.j, *odometry

    def squared_distances(self, a: Array, b: Array) -> Array:
        """(k,) squared Mahalanobis distances between closures a and b (k,)."""
        return _disagreements(a, b, *self._arguments)

    def consistency_matrix(self, members: Array) -> Array:
        """(m, m) bool: which of these closures are consistent; False on the diagonal."""
        is_consistent = np.zeros((len(members), len(members)), bool)
        p, q = np.tril_indices(len(members), -1)
        is_consistent[p, q] = is_consistent[q, p] = self.squared_distances(members[p], members[q]) < GATE
        return is_consistent


@kernel
def _disagreement(a, b, claim, adjoint, noise, i, j, step, accumulated, shared):
    ta, tb = claim[a], claim[b]
    turn = (ta[2] - tb[2] + np.pi) % (2 * np.pi) - np.pi
    c, s = np.cos(turn), np.sin(turn)
    x, y = ta[0] - (c * tb[0] - s * tb[1]), ta[1] - (s * tb[0] + c * tb[1])
    half = turn / 2
    ratio = 1.0 if abs(half) < 1e-6 else half / np.tan(half)
    ex, ey = ratio * x + half * y, -half * x + ratio * y
    back = 1.0 if step[j[a]] <= step[j[b]] else -1.0
    forth = 1.0 if step[i[a]] <= step[i[b]] else -1.0
    half_turned, total = np.empty((3, 3)), np.empty((3, 3))
    ad, ga, gb = adjoint[a], accumulated[j[a]], accumulated[j[b]]
    for p in range(3):
        for q in range(3):
            value = 0.0
            for k in range(3):
                value += ad[p, k] * (gb[k, q] - ga[k, q])
            half_turned[p, q] = back * value
    for p in range(3):
        for q in range(p + 1):
            value = noise[a, p, q] + noise[b, p, q] + forth * (accumulated[i[b], p, q] - accumulated[i[a], p, q])
            for k in range(3):
                value += half_turned[p, k] * ad[q, k]
            total[p, q] = value
    if len(shared):
        _add_shared_errors(ad, shared[i[b]] - shared[i[a]], shared[j[b]] - shared[j[a]], total)
    l00 = np.sqrt(total[0, 0])
    l10, l20 = total[1, 0] / l00, total[2, 0] / l00
    l11 = np.sqrt(total[1, 1] - l10 * l10)
    l21 = (total[2, 1] - l20 * l10) / l11
    l22 = np.sqrt(total[2, 2] - l20 * l20 - l21 * l21)
    u = ex / l00
    v = (ey - l10 * u) / l11
    w = (turn - l20 * u - l21 * v) / l22
    return u * u + v * v + w * w


@kernel
def _add_shared_errors(ad, forth, back, total):
    """Add the covariance of shared odometry errors on two stretches to total (3, 3), in place.

    forth, back (3, 3): effect of shared errors of one standard deviation on each stretch, treated as independent.
    """
    moved = np.zeros((3, 3))
    for p in range(3):
        for q in range(3):
            for k in range(3):
                moved[p, q] += ad[p, k] * back[k, q]
    for p in range(3):
        for q in range(3):
            for k in range(3):
                total[p, q] += forth[p, k] * forth[q, k] + moved[p, k] * moved[q, k]


@kernel
def _disagreements(first, second, claim, adjoint, noise, i, j, step, accumulated, shared):
    out = np.empty(len(first))
    for k in range(len(first)):
        out[k] = _disagreement(first[k], second[k], claim, adjoint, noise, i, j, step, accumulated, shared)
    return out


def pairwise_consistent(graph: Graph, poses: Array) -> tuple[Array, Array]:
    """Poses (n, 3) and accepted edges (e,) of PCM: a large consistent set for each pair of chains."""
    chains = Chains(graph, poses)
    poses = chains.dead_reckoning(poses)
    closures = np.flatnonzero(graph.is_closure)
    pairs = PairwiseConsistency(graph, poses, chains, closures)
    ends = np.stack([chains.chain[pairs.i], chains.chain[pairs.j]], axis=1)
    accepted = ~graph.is_closure
    for one in np.unique(ends, axis=0):
        members = np.flatnonzero((ends == one).all(axis=1))
        accepted[closures[members[_greedy_clique(pairs.consistency_matrix(members))]]] = True
    return graph.fit(poses, accepted.astype(float)), accepted


@kernel
def _greedy_clique(is_consistent):
    """Members of a large clique: from each of ten best connected nodes, greedily add what leaves most candidates."""
    count = len(is_consistent)
    degree = is_consistent.sum(axis=1)
    seeds = np.argsort(-degree, kind="mergesort")[:10]
    best = np.zeros(0, np.int64)
    for seed in seeds:
        choice = np.flatnonzero(is_consistent[seed])
        choice = choice[choice != seed]
        votes = np.zeros(count, np.int64)
        for a in choice:
            for b in choice:
                votes[a] += is_consistent[a, b]
        clique = [seed]
        while len(choice):
            chosen = choice[np.argmax(votes[choice])]
            clique.append(chosen)
            kept = [c for c in choice if is_consistent[chosen, c] and c != chosen]
            for c in choice:
                if not is_consistent[chosen, c] or c == chosen:
                    for k in kept:
                        votes[k] -= is_consistent[k, c]
            choice = np.array(kept, dtype=np.int64)
        if len(clique) > len(best):
            best = np.array(clique, dtype=np.int64)
    return np.sort(best)


def neighbour_groups(pairs: PairwiseConsistency, chains: Chains) -> Array:
    """(k,) group index of each closure: consistent closures within `WINDOW_STEPS` at both ends, joined transitively."""
    i, j = pairs.i, pairs.j
    order = np.lexsort((np.arange(len(i)), chains.step[i], chains.chain[i]))
    parent = np.arange(len(i))
    for shift in range(1, len(order)):
        a, b = order[:-shift], order[shift:]
        near = (chains.chain[i[a]] == chains.chain[i[b]]) & (chains.step[i[b]] - chains.step[i[a]] <= WINDOW_STEPS)
        if not near.any():
            break
        near &= chains.chain[j[a]] == chains.chain[j[b]]
        near &= np.abs(chains.step[j[b]] - chains.step[j[a]]) <= WINDOW_STEPS
        a, b = a[near], b[near]
        if len(a):
            is_consistent = pairs.squared_distances(a, b) < GATE
            for x, y in zip(a[is_consistent].tolist(), b[is_consistent].tolist(), strict=True):
                while parent[x] != x:
                    x = parent[x]
                while parent[y] != y:
                    y = parent[y]
                parent[max(x, y)] = min(x, y)
    for k in range(len(parent)):
        parent[k] = parent[parent[k]]
    return np.unique(parent, return_inverse=True)[1]
