"""Which closures to believe: the robust modes of the pose graph, and a report of every closure that was refused.

Modes (`PoseGraphConfig.robust`): `none` believes all (TWC-SLAM), `dcs` and `cauchy` weigh by residual, `gnc` anneals
truncated least squares (Yang 2020), `pcm` keeps the largest pairwise consistent set (Mangelson 2018), `ours` grows the
map from the surest closures outwards.

`ours`: closures that follow one another and agree within the odometry between them form a group, and a group has one
voice however many members it has, because alike rooms make false closures that agree. A group is believed when its
evidence, the likelihood of what it says given the map so far against any other place in the building, is strong;
while drift is too large for that, groups must speak for each other. After each belief the map is optimised, gradually
more robustly, which sharpens the next test; whatever then contradicts the majority is revoked. Errors are twists in the
world frame, in which the covariances along a chain of odometry add up, however far it turns.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.linalg.lapack import dpotrf, dpotri

from twc_env.config import PoseGraphConfig
from twc_env.geometry import between, compose, inverse, wrap_angle
from twc_env.slam import pose_graph

Array = NDArray

GATE = 11.345
"""99 % of chi squared with three degrees of freedom."""
MEDIAN_SQUARED = 2.366
"""Median of chi squared with three degrees of freedom."""
KEEP_GATE = 25.0
"""A closure that the rest of the map contradicts by more is refused: 1.5e-5 of true ones at honest covariances."""
WINDOW_STEPS = 10
"""Neighbours of one group lie at most this far apart at both ends."""
TAIL = 5.0
"""Degrees of freedom of Student's t: real odometry errs more than its covariance says."""
ODDS_SURE, ODDS_LIKELY, ODDS_TOGETHER = 8.0, 1.5, 3.0
"""Log odds from which groups are believed by the dozen; the best one, when there are no such; several together, when
none is likely alone."""
PRIOR_GROUPS = 30
"""Weight, in groups, of the share of true ones among all against that among the undecided."""
TRUST = (3, 1)
"""True and false groups of each kind imagined before any is heard: what nothing speaks against is rather true."""
SCALE_GROUPS = 30
"""Groups that must have been believed before the covariances' common scale is half learnt."""
SCALE_MIN, SCALE_MAX, GATE_SCALE_MIN = 0.05, 10.0, 0.5
KEYS_MAX = 500
"""Poses whose joint covariance is kept; those between lie on the odometry from the one before."""
LEVERAGE_MIN = 0.2
"""Least share of its own noise that a closure's residual is taken to keep after the fit."""
CHOIR_MAX, CHOIR_SEEDS, CHOIR_VOICES = 150, 40, 12
"""Groups considered together while none is believed alone, how many are tried as the first, and how many join it."""


@dataclass(frozen=True, slots=True)
class Rejection:
    """One refused closure: its edge, why, and how far from the final map it lies."""

    edge: int
    reason: str
    squared_error: float
    away_m: float
    away_rad: float
    group: int = -1
    """Closures of one number agree with each other; -1 where the mode forms no groups."""


@dataclass(frozen=True, slots=True)
class BackendResult:
    """Poses (n, 3), accepted (e,) bool with odometry always true, and the refused closures in order of their edges."""

    poses: Array
    accepted: Array
    rejections: tuple[Rejection, ...]


@dataclass(frozen=True, slots=True)
class Graph:
    """A pose graph: edges (e, 2), measured (e, 3), information (e, 3, 3), is_closure (e,) bool."""

    edges: Array
    measured: Array
    information: Array
    is_closure: Array

    def fit(self, poses: Array, weight: Array, iterations_max: int = 100) -> Array:
        """Poses after plain least squares with these weights (e,)."""
        return pose_graph.weighted(poses, self.edges, self.measured, self.information, weight, iterations_max)

    def squared_errors(self, poses: Array) -> Array:
        """(e,) squared Mahalanobis length of each residual."""
        return pose_graph.squared_errors(poses, self.edges, self.measured, self.information)


def optimise(poses, edges, measured, information, is_closure, config: PoseGraphConfig, fixed: int = 0) -> Array:
    """The poses of `solve`; signature and meaning of `pose_graph.optimise`, for every mode."""
    if config.robust in ("none", "dcs", "cauchy"):
        return pose_graph.optimise(poses, edges, measured, information, is_closure, config, fixed)
    return solve(poses, edges, measured, information, is_closure, config, fixed).poses


def solve(
    poses: Array,
    edges: Array,
    measured: Array,
    information: Array,
    is_closure: Array,
    config: PoseGraphConfig,
    fixed: int = 0,
) -> BackendResult:
    """Optimise in the mode `config.robust` and say which closures were believed. Deterministic.

    Arguments as for `pose_graph.optimise`. `gnc`, `pcm` and `ours` take odometry as known good.
    """
    poses = np.array(poses, float)
    graph = Graph(
        np.ascontiguousarray(edges, np.int64).reshape(-1, 2),
        np.ascontiguousarray(measured, float).reshape(-1, 3),
        np.ascontiguousarray(information, float).reshape(-1, 3, 3),
        np.ascontiguousarray(is_closure, bool),
    )
    group = np.full(len(graph.edges), -1)
    reasons: dict[int, str] = {}
    held = poses[fixed].copy() if len(poses) else np.zeros(3)
    if len(poses) < 2 or not graph.is_closure.any():
        out, accepted = pose_graph.optimise(poses, *_parts(graph), config, fixed), np.ones(len(graph.edges), bool)
    elif config.robust in ("none", "dcs", "cauchy"):
        out, accepted = _weighed(graph, poses, config, fixed)
    elif config.robust == "gnc":
        out, accepted = _graduated(graph, poses)
    elif config.robust == "pcm":
        out, accepted = _pairwise_consistent(graph, poses)
    else:
        out, accepted, group, reasons = _Growth(graph, poses, config).run()
    if len(out) and config.robust not in ("none", "dcs", "cauchy"):
        out = compose(held, between(out[fixed], out))
        out[fixed] = held
    return BackendResult(out, accepted, _rejections(graph, out, accepted, group, reasons, config.robust))


def _parts(graph: Graph) -> tuple[Array, Array, Array, Array]:
    return graph.edges, graph.measured, graph.information, graph.is_closure


def _rejections(graph: Graph, poses, accepted, group, reasons, mode) -> tuple[Rejection, ...]:
    refused = np.flatnonzero(~accepted)
    if not len(refused):
        return ()
    squared = graph.squared_errors(poses)
    away = pose_graph.residuals(poses, graph.edges[refused], graph.measured[refused])
    general = {
        "gnc": "truncated: its error stayed above the inlier bound",
        "pcm": "not in the largest pairwise consistent set",
    }.get(mode, "down-weighted below one half by its residual")
    return tuple(
        Rejection(int(e), reasons.get(int(e), general), float(squared[e]), math.hypot(x, y), abs(turn), int(group[e]))
        for e, (x, y, turn) in zip(refused, away.tolist(), strict=True)
    )


def _weighed(graph: Graph, poses: Array, config: PoseGraphConfig, fixed: int) -> tuple[Array, Array]:
    out = pose_graph.optimise(poses, *_parts(graph), config, fixed)
    weight = pose_graph.robust_weights(graph.squared_errors(out), graph.is_closure, config)
    return out, weight > 0.5


def _graduated(graph: Graph, poses: Array, rounds_max: int = 100) -> tuple[Array, Array]:
    """Graduated non-convexity on truncated least squares, odometry known good (Yang 2020, Eq. 14-15)."""
    poses = graph.fit(poses, np.ones(len(graph.edges)), 30)
    largest = graph.squared_errors(poses)[graph.is_closure].max()
    weight = np.ones(len(graph.edges))
    if 2 * largest <= GATE:
        return poses, weight > 0.5
    mu = 1.0 / (2 * largest / GATE - 1)
    for _ in range(rounds_max):
        squared = graph.squared_errors(poses)
        high, low = (mu + 1) / mu * GATE, mu / (mu + 1) * GATE
        middle = np.sqrt(GATE * mu * (mu + 1) / np.maximum(squared, 1e-12)) - mu
        truncated = np.where(squared >= high, 0.0, np.where(squared <= low, 1.0, middle))
        weight = np.where(graph.is_closure, truncated, 1.0)
        poses = graph.fit(poses, weight, 5)
        if np.all(np.minimum(weight, 1 - weight) < 1e-4):
            break
        mu *= 1.4
    accepted = weight > 0.5
    return graph.fit(poses, accepted.astype(float)), accepted


# --- SE(2) as a Lie group: twists (x [m], y [m], turn [rad]) ---------------------------------------------------------


def _adjoint(poses: Array) -> Array:
    """(..., 3, 3): moves a twist from the pose's own frame into the world frame."""
    out = np.zeros((*poses.shape[:-1], 3, 3))
    c, s = np.cos(poses[..., 2]), np.sin(poses[..., 2])
    out[..., 0, 0], out[..., 0, 1], out[..., 0, 2] = c, -s, poses[..., 1]
    out[..., 1, 0], out[..., 1, 1], out[..., 1, 2] = s, c, -poses[..., 0]
    out[..., 2, 2] = 1.0
    return out


def _logarithm(poses: Array) -> Array:
    """(..., 3): the twist whose exponential is the pose."""
    half = wrap_angle(poses[..., 2]) / 2
    ratio = np.where(np.abs(half) < 1e-6, 1.0, half / np.where(np.abs(half) < 1e-6, 1.0, np.tan(half)))
    x, y = poses[..., 0], poses[..., 1]
    return np.stack([ratio * x + half * y, -half * x + ratio * y, 2 * half], axis=-1)


def _turned(matrix: Array, covariance: Array) -> Array:
    return matrix @ covariance @ np.swapaxes(matrix, -1, -2)


def _squared_length(error: Array, covariance: Array) -> Array:
    return (error * np.linalg.solve(covariance, error[..., None])[..., 0]).sum(axis=-1)


class _Chains:
    """The odometry: which chain each pose is on, where, and the covariance of every stretch."""

    def __init__(self, graph: Graph, poses: Array):
        count = len(poses)
        following, edge = np.full(count, -1), np.full(count, -1)
        has_previous = np.zeros(count, bool)
        for e in np.flatnonzero(~graph.is_closure):
            a, b = graph.edges[e]
            if following[a] < 0 and not has_previous[b]:
                following[a], edge[a], has_previous[b] = b, e, True
        self.chain, self.step = np.full(count, -1), np.zeros(count, np.int64)
        self.order: list[int] = []
        self.edge_before = np.full(count, -1)  # the odometry edge that leads to each pose
        for start in [*np.flatnonzero(~has_previous), *range(count)]:
            node, step = int(start), 0
            while node >= 0 and self.chain[node] < 0:
                self.chain[node], self.step[node] = start, step
                self.order.append(node)
                if edge[node] >= 0 and self.chain[following[node]] < 0:
                    self.edge_before[following[node]] = edge[node]
                node, step = int(following[node]), step + 1
        self._covariance = np.linalg.inv(graph.information[np.maximum(self.edge_before, 0)])
        self._covariance[self.edge_before < 0] = 0.0
        self._measured = graph.measured

    def dead_reckoning(self, poses: Array) -> Array:
        """Poses that follow the odometry exactly from each chain's first pose."""
        out = poses.copy()
        before = -1
        for node in self.order:
            edge = self.edge_before[node]
            if edge >= 0:
                out[node] = compose(out[before], self._measured[edge])
            before = node
        return out

    def grown(self, poses: Array) -> Array:
        """(n, 3, 3) covariance of each pose against its chain's first, as world twists; stretches are differences."""
        order = np.array(self.order)
        steps = _turned(_adjoint(poses), self._covariance)[order]
        out = np.empty_like(steps)
        out[order] = np.cumsum(steps, axis=0)  # over all chains: only differences within one are used
        return out

    def stretch(self, grown: Array, a: Array, b: Array) -> Array:
        """(k, 3, 3) covariance of the odometry between poses a and b of one chain each."""
        sign = np.where(self.step[a] > self.step[b], -1.0, 1.0)
        return (grown[b] - grown[a]) * sign[:, None, None]


class _Pairs:
    """Do two closures agree, given the odometry between their ends?

    Each closure k claims that its second pose's map lies at T_k = X_i z X_j^-1 of its first pose's; two agree when
    T_a T_b^-1 is a twist that their own noise and the odometry between their ends explain.
    """

    def __init__(self, graph: Graph, poses: Array, chains: _Chains, closures: Array):
        self.i, self.j = np.ascontiguousarray(graph.edges[closures].T)
        put = compose(poses[self.i], graph.measured[closures])
        claim = compose(put, inverse(poses[self.j]))
        noise = _turned(_adjoint(put), np.linalg.inv(graph.information[closures]))
        self._facts = (claim, _adjoint(claim), noise, self.i, self.j, chains.step, chains.grown(poses))

    def squared(self, a: Array, b: Array) -> Array:
        """(k,) squared length of the disagreement of closures a, b (k,)."""
        return _disagreements(a, b, *self._facts)

    def agreement(self, members: Array, gate: float) -> Array:
        """(m, m) whether members agree pairwise."""
        return _agreement(members, gate, *self._facts)


@njit(cache=True, error_model="numpy")
def _disagreement(a, b, claim, adjoint, noise, i, j, step, grown):
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
    ad, ga, gb = adjoint[a], grown[j[a]], grown[j[b]]
    for p in range(3):
        for q in range(3):
            value = 0.0
            for k in range(3):
                value += ad[p, k] * (gb[k, q] - ga[k, q])
            half_turned[p, q] = back * value
    for p in range(3):
        for q in range(p + 1):
            value = noise[a, p, q] + noise[b, p, q] + forth * (grown[i[b], p, q] - grown[i[a], p, q])
            for k in range(3):
                value += half_turned[p, k] * ad[q, k]
            total[p, q] = value
    l00 = np.sqrt(total[0, 0])
    l10, l20 = total[1, 0] / l00, total[2, 0] / l00
    l11 = np.sqrt(total[1, 1] - l10 * l10)
    l21 = (total[2, 1] - l20 * l10) / l11
    l22 = np.sqrt(total[2, 2] - l20 * l20 - l21 * l21)
    u = ex / l00
    v = (ey - l10 * u) / l11
    w = (turn - l20 * u - l21 * v) / l22
    return u * u + v * v + w * w


@njit(cache=True, error_model="numpy")
def _disagreements(first, second, claim, adjoint, noise, i, j, step, grown):
    out = np.empty(len(first))
    for k in range(len(first)):
        out[k] = _disagreement(first[k], second[k], claim, adjoint, noise, i, j, step, grown)
    return out


@njit(cache=True, error_model="numpy")
def _agreement(members, gate, claim, adjoint, noise, i, j, step, grown):
    out = np.zeros((len(members), len(members)), np.bool_)
    for p in range(len(members)):
        for q in range(p):
            squared = _disagreement(members[p], members[q], claim, adjoint, noise, i, j, step, grown)
            out[p, q] = out[q, p] = squared < gate
    return out


def _pairwise_consistent(graph: Graph, poses: Array) -> tuple[Array, Array]:
    """The largest set found in which every pair agrees; separately for each pair of chains."""
    chains = _Chains(graph, poses)
    poses = chains.dead_reckoning(poses)
    closures = np.flatnonzero(graph.is_closure)
    pairs = _Pairs(graph, poses, chains, closures)
    ends = np.stack([chains.chain[pairs.i], chains.chain[pairs.j]], axis=1)
    accepted = ~graph.is_closure
    for one in np.unique(ends, axis=0):
        members = np.flatnonzero((ends == one).all(axis=1))
        accepted[closures[members[_greedy_clique(pairs.agreement(members, GATE))]]] = True
    return graph.fit(poses, accepted.astype(float)), accepted


@njit(cache=True, error_model="numpy")
def _greedy_clique(agree):
    """Members of a large clique: from each of the best connected nodes, always add the one that keeps most choices."""
    count = len(agree)
    degree = agree.sum(axis=1)
    seeds = np.argsort(-degree, kind="mergesort")[:10]
    best = np.zeros(0, np.int64)
    for seed in seeds:
        choice = np.flatnonzero(agree[seed])
        choice = choice[choice != seed]
        votes = np.zeros(count, np.int64)
        for a in choice:
            for b in choice:
                votes[a] += agree[a, b]
        clique = [seed]
        while len(choice):
            chosen = choice[np.argmax(votes[choice])]
            clique.append(chosen)
            kept = [c for c in choice if agree[chosen, c] and c != chosen]
            for c in choice:
                if not agree[chosen, c] or c == chosen:
                    for k in kept:
                        votes[k] -= agree[k, c]
            choice = np.array(kept, dtype=np.int64)
        if len(clique) > len(best):
            best = np.array(clique, dtype=np.int64)
    return np.sort(best)


def _groups(pairs: _Pairs, chains: _Chains) -> Array:
    """(k,) number of each closure's group: neighbours within a window at both ends that agree, joined transitively."""
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
            agree = pairs.squared(a, b) < GATE
            for x, y in zip(a[agree].tolist(), b[agree].tolist(), strict=True):
                while parent[x] != x:
                    x = parent[x]
                while parent[y] != y:
                    y = parent[y]
                parent[max(x, y)] = min(x, y)
    for k in range(len(parent)):
        parent[k] = parent[parent[k]]
    return np.unique(parent, return_inverse=True)[1]


class _Growth:
    """The mode `ours`: which groups are believed, grown from the surest outwards."""

    def __init__(self, graph: Graph, poses: Array, config: PoseGraphConfig):
        self._graph, self._config = graph, config
        self._closures = np.flatnonzero(graph.is_closure)
        self._chains = _Chains(graph, poses)
        self.poses = self._chains.dead_reckoning(poses)
        pairs = _Pairs(graph, self.poses, self._chains, self._closures)
        self._group = _groups(pairs, self._chains)
        self._i, self._j = pairs.i, pairs.j
        self._noise = np.linalg.inv(graph.information[self._closures])
        count = int(self._group.max()) + 1
        self._first = np.searchsorted(np.sort(self._group), np.arange(count))
        by_group = np.argsort(self._group, kind="stable")
        sizes = np.bincount(self._group, minlength=count)
        self._speaker = by_group[self._first + sizes // 2]  # (groups,) the closure in the middle speaks for its group
        self._size = sizes
        self.believed = np.zeros(count, bool)
        self._revoked = np.zeros(count, np.int64)
        self._member_in = np.ones(len(self._closures), bool)
        order = np.array(self._chains.order)
        is_end = np.zeros(len(poses), bool)
        is_end[self._i] = is_end[self._j] = True
        is_key = is_end[order]
        if is_key.sum() > KEYS_MAX:
            is_key = self._chains.step[order] % -(-len(poses) // KEYS_MAX) == 0
        is_key |= self._chains.step[order] == 0
        self._key_of = np.empty(len(poses), np.int64)
        self._key_of[order] = np.cumsum(is_key) - 1
        self._keys = order[is_key]

    def run(self):
        """Poses, accepted edges (e,), group of each edge (e,), and reasons of refused edges."""
        for _ in range(200):
            if not self._believe_more():
                break
            self._settle()
        return self._finish()

    # --- what the map so far says about each closure

    def _look(self) -> None:
        """Joint covariance of the key poses (world twists) under odometry and the believed closures."""
        poses = self.poses
        self._grown = self._chains.grown(poses)
        keys, count = self._keys, len(self._keys)
        hessian = np.zeros((count, 3, count, 3))
        chain, step = self._chains.chain, self._chains.step
        for k in range(count):
            if step[keys[k]] == 0:
                hessian[k, :, k] += np.eye(3) * (1e8 if k == 0 else 1e-1)
        follows = np.flatnonzero(chain[keys[1:]] == chain[keys[:-1]])
        weight = np.linalg.inv(self._chains.stretch(self._grown, keys[follows], keys[follows + 1]) + 1e-12 * np.eye(3))
        _add_edges(hessian, follows, follows + 1, weight)
        used = np.flatnonzero(self._used())
        if len(used):
            i, j = self._i[used], self._j[used]
            covariance = self._own_noise(used) + self._off_key(i) + self._off_key(j)
            _add_edges(hessian, self._key_of[i], self._key_of[j], np.linalg.inv(covariance))
        self._joint = _inverse(hessian.reshape(3 * count, 3 * count)).reshape(count, 3, count, 3)
        self._learn_scale()
        extent = np.ptp(poses[:, :2], axis=0) + 1.0
        self._log_volume = math.log(extent[0] * extent[1] * 2 * math.pi / 8)

    def _used(self) -> Array:
        return self.believed[self._group] & self._member_in

    def _off_key(self, nodes: Array) -> Array:
        return self._chains.stretch(self._grown, self._keys[self._key_of[nodes]], nodes)

    def _own_noise(self, closures: Array) -> Array:
        return _turned(self._claimed(closures), self._noise[closures])

    def _claimed(self, closures: Array) -> Array:
        """(k, 3, 3) from the frame where a closure puts its second pose into the world frame, for twists."""
        return _adjoint(compose(self.poses[self._i[closures]], self._graph.measured[self._closures[closures]]))

    def _predicted(self, closures: Array, between_keys: bool = False) -> tuple[Array, Array]:
        """Error (k, 3) of closures as world twists, and the covariance (k, 3, 3) of the map's own prediction."""
        i, j = self._i[closures], self._j[closures]
        z = self._graph.measured[self._closures[closures]]
        error = _logarithm(compose(compose(self.poses[i], z), inverse(self.poses[j])))
        a, b = self._key_of[i], self._key_of[j]
        joint = self._joint
        cross = joint[a, :, b]
        drift = joint[a, :, a] + joint[b, :, b] - cross - np.swapaxes(cross, 1, 2)
        if between_keys:
            return error, drift
        same = (self._chains.chain[i] == self._chains.chain[j]) & (a == b)
        off = np.where(
            same[:, None, None], self._chains.stretch(self._grown, i, j), self._off_key(i) + self._off_key(j)
        )
        return error, drift + off

    def _evidence(self, error: Array, covariance: Array) -> Array:
        """(k,) log of Student's t density against a place drawn from the whole building.

        Drift beyond the building's size says nothing against a closure.
        """
        squared = _squared_length(error, covariance) / self._scale
        scale = math.lgamma((TAIL + 3) / 2) - math.lgamma(TAIL / 2) - 1.5 * math.log(TAIL * math.pi * self._scale)
        peak = scale - 0.5 * np.linalg.slogdet(covariance)[1] + self._log_volume
        return np.maximum(peak, 0.5) - (TAIL + 3) / 2 * np.log1p(squared / TAIL)

    def _learn_scale(self) -> None:
        """How much smaller or larger errors are than their covariances say, from the groups believed so far."""
        speakers = self._speaker[self.believed]
        speakers = speakers[self._member_in[speakers]]
        self._scale = 1.0
        if len(speakers):
            ratio = max(float(np.median(self._contradicted(speakers))) / MEDIAN_SQUARED, 1e-3)
            share = len(speakers) / (len(speakers) + SCALE_GROUPS)
            self._scale = min(max(ratio**share, SCALE_MIN), SCALE_MAX)

    def _gate_scale(self) -> float:
        return max(self._scale, GATE_SCALE_MIN)

    def _prior_odds(self, groups: Array, evidence: Array) -> Array:
        """(k,) log odds of undecided groups before they are heard, for single closures and for larger groups apart.

        Expectation maximisation over the share of true ones, drawn towards the share among all groups of the kind.
        """
        out = np.empty(len(groups))
        for is_single in (True, False):
            kind = (self._size[groups] == 1) == is_single
            heard = np.clip(evidence[kind], -50, 50)
            believed = np.count_nonzero(self.believed[(self._size == 1) == is_single])
            share = overall = 0.5
            for _ in range(20):
                true = (1 / (1 + np.exp(-heard) * (1 - share) / share)).sum()
                overall = (believed + true + TRUST[0]) / (believed + len(heard) + sum(TRUST))
                share = (true + PRIOR_GROUPS * overall) / (len(heard) + PRIOR_GROUPS)
            out[kind] = math.log(share / (1 - share))
        return out

    # --- believing and revoking

    def _believe_more(self) -> bool:
        self._look()
        pending = np.flatnonzero(~self.believed & (self._revoked < 3))
        if not len(pending):
            return False
        speaker = self._speaker[pending]
        error, drift = self._predicted(speaker)
        covariance = drift + self._own_noise(speaker)
        evidence = self._evidence(error, covariance)
        prior = self._prior_odds(pending, evidence)
        odds = evidence + prior
        sure = np.flatnonzero(odds > ODDS_SURE)
        if len(sure):
            spread = np.linalg.slogdet(covariance[sure])[1]
            new = sure[np.argsort(spread, kind="stable")[: max(10, len(sure) // 4)]]
        elif odds.max() > ODDS_LIKELY:
            new = np.array([np.argmax(odds)])
        else:
            best = np.argsort(-odds, kind="stable")[:CHOIR_MAX]
            new = best[self._choir(speaker[best], error[best], covariance[best], odds[best], prior[best])]
        self.believed[pending[new]] = True
        return len(new) > 0

    def _choir(self, speaker: Array, error: Array, covariance: Array, odds: Array, prior: Array) -> list[int]:
        """Groups that none believes alone but that support each other: the set with the best joint odds."""
        a, b = self._key_of[self._i[speaker]], self._key_of[self._j[speaker]]
        count = len(speaker)
        joint = np.zeros((count, 3, count, 3))
        for left, right, sign in ((b, b, 1.0), (b, a, -1.0), (a, b, -1.0), (a, a, 1.0)):
            joint += sign * self._joint[left][:, :, right]
        k = np.arange(count)
        joint[k, :, k] = covariance
        songs = [
            self._sing(int(seed), joint, error, odds, prior) for seed in np.argsort(-odds, kind="stable")[:CHOIR_SEEDS]
        ]
        songs = [song for song in songs if len(song[0]) > 1]
        return min(songs, key=lambda song: (len(song[0]), -song[1]))[0] if songs else []

    def _sing(self, seed: int, joint: Array, error: Array, odds: Array, prior: Array) -> tuple[list[int], float]:
        """The first few groups that `seed` speaks for and that are likely together, and their joint log odds."""
        members, chosen, total = [seed], seed, float(odds[seed])
        k = np.arange(len(error))
        for _ in range(CHOIR_VOICES - 1):
            gain = joint[:, :, chosen] @ np.linalg.inv(joint[chosen, :, chosen])  # (count, 3, 3)
            error = error - gain @ error[chosen]
            joint = joint - np.tensordot(gain, joint[chosen], axes=(2, 0))
            rest = np.setdiff1d(k, members)
            if not len(rest):
                break
            now = self._evidence(error[rest], joint[rest, :, rest]) + prior[rest]
            top = int(np.argmax(4 * now - 3 * odds[rest]))  # likely, and likelier for what was believed before
            chosen = int(rest[top])
            members.append(chosen)
            total += float(now[top])
            if total > ODDS_TOGETHER:
                return members, total
        return [], total

    def _settle(self) -> None:
        """Optimise on what is believed, gradually more robustly, and revoke what the rest then contradicts."""
        for _ in range(5):
            used = self._used()
            weight = (~self._graph.is_closure).astype(float)
            weight[self._closures[used]] = 1.0
            self.poses = self._graph.fit(self.poses, weight, 30)
            squared = self._graph.squared_errors(self.poses)[self._closures]
            if squared[used].max(initial=0.0) < KEEP_GATE:
                return
            for scale in (300.0, 30.0):
                config = replace(self._config, robust="dcs", robust_scale=scale, iterations_max=10)
                kept = weight > 0
                edges, measured, information, is_closure = (part[kept] for part in _parts(self._graph))
                self.poses = pose_graph.optimise(self.poses, edges, measured, information, is_closure, config)
            self._look()
            if not self._revoke():
                return

    def _revoke(self) -> bool:
        """Take back members, and groups whose speaker or half of whose members fail, by their leave-one-out error."""
        used = np.flatnonzero(self._used())
        failed = used[self._contradicted(used) > KEEP_GATE * self._gate_scale()]
        if not len(failed):
            return False
        self._member_in[failed] = False
        lost = np.bincount(self._group[failed], minlength=len(self.believed))
        groups = np.flatnonzero(lost * 2 >= self._size)
        self.believed[groups] = False
        self._revoked[groups] += 1
        self._member_in[np.isin(self._group, groups)] = True
        return True

    def _contradicted(self, used: Array) -> Array:
        """(k,) squared error of used closures against what all others say."""
        drift = self._predicted(used, between_keys=True)[1]
        edges = self._closures[used]
        residual = pose_graph.residuals(self.poses, self._graph.edges[edges], self._graph.measured[edges])
        error = (self._claimed(used) @ residual[..., None])[..., 0]
        own = self._own_noise(used)
        root = np.linalg.inv(np.linalg.cholesky(own))
        value, vector = np.linalg.eigh(_turned(root, own - drift))  # its own noise less what the fit explains
        part = np.swapaxes(vector, 1, 2) @ root @ error[..., None]
        squared = (part[..., 0] ** 2 / np.maximum(value, LEVERAGE_MIN)).sum(axis=1)
        plain = self._graph.squared_errors(self.poses)[edges]
        return np.where(plain < GATE * min(self._scale, 1.0), np.minimum(squared, GATE * GATE_SCALE_MIN), squared)

    # --- the end

    def _finish(self):
        graph, closures = self._graph, self._closures
        for _ in range(3):  # with the map settled, every closure is judged on its own
            self._look()
            used = self._used()
            everyone = np.arange(len(closures))
            error, drift = self._predicted(everyone)
            squared = _squared_length(error, drift + self._own_noise(everyone))
            squared[used] = self._contradicted(np.flatnonzero(used))
            evidence = self._evidence(error, drift + self._own_noise(everyone))
            loose = self._gate_scale()
            proven = evidence + self._final_odds(evidence) > ODDS_LIKELY
            kept = (squared < np.where(used, KEEP_GATE, GATE) * loose) & (used | proven)
            same = np.array_equal(kept, used)
            self.believed[:] = True
            self._member_in = kept
            weight = (~graph.is_closure).astype(float)
            weight[closures[kept]] = 1.0
            self.poses = graph.fit(self.poses, weight)
            if same:
                break
        accepted = weight > 0
        group = np.full(len(graph.edges), -1)
        group[closures] = self._group
        return self.poses, accepted, group, self._reasons(kept, squared, evidence)

    def _final_odds(self, evidence: Array) -> Array:
        """(k,) log odds of every closure before it is heard, by the share of believed closures of its kind."""
        out = np.empty(len(evidence))
        single = self._size[self._group] == 1
        for kind in (single, ~single):
            out[kind] = math.log((self._used()[kind].sum() + 1) / ((~self._used()[kind]).sum() + 1))
        return np.minimum(out, 0.0)

    def _reasons(self, kept: Array, squared: Array, evidence: Array) -> dict[int, str]:
        share = np.bincount(self._group, kept, len(self.believed)) / self._size
        reasons = {}
        for k in np.flatnonzero(~kept):
            group = self._group[k]
            if squared[k] < GATE:
                why = "unproven: drift is too large to tell it from a false one"
            elif share[group] > 0:
                why = "contradicts its own group and the map"
            elif self._size[group] > 1:
                why = f"its group of {self._size[group]} agrees with itself but contradicts the map"
            else:
                why = "contradicts the map"
            reasons[int(self._closures[k])] = f"{why} (squared error {squared[k]:.1f}, log evidence {evidence[k]:.1f})"
        return reasons


def _inverse(matrix: Array) -> Array:
    """Of a positive definite matrix."""
    factor, _ = dpotrf(matrix.T, lower=0, overwrite_a=1)
    lower = dpotri(factor, lower=0, overwrite_c=1)[0].T
    _mirror(lower)
    return lower


@njit(cache=True, error_model="numpy")
def _mirror(lower):
    for row in range(len(lower)):
        for column in range(row):
            lower[column, row] = lower[row, column]


@njit(cache=True, error_model="numpy")
def _add_edges(hessian, a, b, weight):
    """Add the Laplacian blocks of edges a - b (k,) with information (k, 3, 3) to (n, 3, n, 3)."""
    for e in range(len(a)):
        p, q = a[e], b[e]
        if p == q:
            continue
        for i in range(3):
            for j in range(3):
                hessian[p, i, p, j] += weight[e, i, j]
                hessian[q, i, q, j] += weight[e, i, j]
                hessian[p, i, q, j] -= weight[e, i, j]
                hessian[q, i, p, j] -= weight[e, i, j]
