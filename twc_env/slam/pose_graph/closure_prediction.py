"""Predicts each closure from the map: expected transform, its covariance, and the likelihood of the measurement."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.kernels.compiled import kernel
from twc_env.records.geometry import compose, inverse
from twc_env.records.twists import adjoint, logarithm, squared_length, turned
from twc_env.slam.pose_graph import solver as pose_graph
from twc_env.slam.pose_graph.dense_cholesky import inverse_of
from twc_env.slam.pose_graph.odometry_chains import Chains
from twc_env.slam.pose_graph.solver import GATE, Graph
from twc_env.slam.pose_graph.systematic_errors import UNOWNED

MEDIAN_SQUARED = 2.366
"""Median of chi-squared with three degrees of freedom."""
TAIL = 5.0
"""Degrees of freedom of Student's t: real odometry errors exceed their covariance."""
SCALE_GROUPS = 30
"""Number of accepted closures at which the common covariance scale has half of its weight."""
SCALE_MIN, SCALE_MAX, GATE_SCALE_MIN = 0.05, 10.0, 0.5
KEYS_MAX = 500
"""Maximum number of poses in the joint covariance; others are linked by odometry to the key pose before them."""
LEVERAGE_MIN = 0.2
"""Lower bound of the share of a closure's own noise that remains in its residual after the fit."""


class MapPrediction:
    """Joint covariance of key poses (as world-frame twists) given odometry and the closures in use."""

    def __init__(self, graph: Graph, chains: Chains, closures: Array, keys_max: int):
        self._graph, self._chains, self._closures = graph, chains, closures
        self._i, self._j = np.ascontiguousarray(graph.edges[closures].T)
        self._noise = np.linalg.inv(graph.information[closures])
        self._key_of, self._keys = self._choose_keys(keys_max)
        self._poses = np.zeros((len(chains.step), 3))
        self.scale = 1.0
        """Ratio of squared errors to what the covariances predict."""

    def _choose_keys(self, keys_max: int) -> tuple[Array, Array]:
        order, step = np.array(self._chains.order), self._chains.step
        is_end = np.zeros(len(order), bool)
        is_end[self._i] = is_end[self._j] = True
        is_key = is_end[order]
        if is_key.sum() > keys_max:
            is_key = step[order] % -(-len(order) // keys_max) == 0
        is_key |= step[order] == 0
        key_of = np.empty(len(order), np.int64)
        key_of[order] = np.cumsum(is_key) - 1
        return key_of, order[is_key]

    def update(self, poses: Array, used: Array) -> None:
        """Recompute the prediction from poses (n, 3) and the used closures (k,), indices into `closures`."""
        self._poses = poses
        self._accumulated, self._shared = (
            self._chains.accumulated_covariance(poses),
            self._chains.shared_error_columns(poses),
        )
        keys, count = self._keys, len(self._keys)
        size = count + int(self._chains.owner.max(initial=UNOWNED)) + 1
        hessian = np.zeros((size, 3, size, 3))
        chain, step = self._chains.chain, self._chains.step
        for k in range(count):
            if step[keys[k]] == 0:
                hessian[k, :, k] += np.eye(3) * (1e8 if k == 0 else 1e-1)
        follows = np.flatnonzero(chain[keys[1:]] == chain[keys[:-1]])
        weight = np.linalg.inv(
            self._chains.stretch(self._accumulated, keys[follows], keys[follows + 1]) + 1e-12 * np.eye(3)
        )
        _add_edges(hessian, follows, follows + 1, weight)
        if self._shared is not None:
            owner, bends = self._chains.owner[keys[follows + 1]], np.diff(self._shared[keys], axis=0)[follows]
            _add_shared(hessian, follows, count, owner, weight, bends)
        if len(used):
            i, j = self._i[used], self._j[used]
            covariance = self.own_noise(used) + self._off_key(i) + self._off_key(j)
            _add_edges(hessian, self._key_of[i], self._key_of[j], np.linalg.inv(covariance))
        self._joint = inverse_of(hessian.reshape(3 * size, 3 * size)).reshape(size, 3, size, 3)
        extent = np.ptp(poses[:, :2], axis=0) + 1.0
        self._log_volume = math.log(extent[0] * extent[1] * 2 * math.pi / 8)

    def estimate_scale(self, speakers: Array) -> None:
        """Estimate from used closures (k,) how far squared errors exceed their covariances; shrunk towards 1 for
        few."""
        self.scale = 1.0
        if len(speakers):
            ratio = max(float(np.median(self.leave_one_out_errors(speakers))) / MEDIAN_SQUARED, 1e-3)
            share = len(speakers) / (len(speakers) + SCALE_GROUPS)
            self.scale = min(max(ratio**share, SCALE_MIN), SCALE_MAX)

    @property
    def gate_scale(self) -> float:
        """Factor by which gates on squared errors are widened."""
        return max(self.scale, GATE_SCALE_MIN)

    def own_noise(self, closures: Array) -> Array:
        """(k, 3, 3) measurement covariance of closures as world-frame twists."""
        return turned(self._claimed(closures), self._noise[closures])

    def drift(self, closures: Array) -> Array:
        """(k, 3, 3) covariance of the map's prediction between the key poses of the closures' ends."""
        a, b = self._key_of[self._i[closures]], self._key_of[self._j[closures]]
        cross = self._joint[a, :, b]
        return self._joint[a, :, a] + self._joint[b, :, b] - cross - np.swapaxes(cross, 1, 2)

    def predicted(self, closures: Array) -> tuple[Array, Array]:
        """Error (k, 3) of closures as world-frame twists and covariance (k, 3, 3) of prediction plus measurement."""
        i, j = self._i[closures], self._j[closures]
        z = self._graph.measured[self._closures[closures]]
        error = logarithm(compose(compose(self._poses[i], z), inverse(self._poses[j])))
        same = (self._chains.chain[i] == self._chains.chain[j]) & (self._key_of[i] == self._key_of[j])
        stretch = self._chains.stretch(self._accumulated, i, j, self._shared)
        off = np.where(same[:, None, None], stretch, self._off_key(i) + self._off_key(j))
        return error, self.drift(closures) + off + self.own_noise(closures)

    def evidence(self, error: Array, covariance: Array) -> Array:
        """(k,) log ratio of Student's t density to a uniform density over the building.

        The peak is bounded below, so that drift larger than the building is no evidence against a closure.
        """
        squared = squared_length(error, covariance) / self.scale
        scale = math.lgamma((TAIL + 3) / 2) - math.lgamma(TAIL / 2) - 1.5 * math.log(TAIL * math.pi * self.scale)
        peak = scale - 0.5 * np.linalg.slogdet(covariance)[1] + self._log_volume
        return np.maximum(peak, 0.5) - (TAIL + 3) / 2 * np.log1p(squared / TAIL)

    def leave_one_out_errors(self, used: Array) -> Array:
        """(k,) squared error of each used closure against the prediction of all others."""
        drift = self.drift(used)
        edges = self._closures[used]
        residual = pose_graph.residuals(self._poses, self._graph.edges[edges], self._graph.measured[edges])
        error = (self._claimed(used) @ residual[..., None])[..., 0]
        own = self.own_noise(used)
        root = np.linalg.inv(np.linalg.cholesky(own))
        value, vector = np.linalg.eigh(turned(root, own - drift))  # its own noise less what the fit explains
        part = np.swapaxes(vector, 1, 2) @ root @ error[..., None]
        squared = (part[..., 0] ** 2 / np.maximum(value, LEVERAGE_MIN)).sum(axis=1)
        plain = self._graph.squared_errors(self._poses)[edges]
        return np.where(plain < GATE * min(self.scale, 1.0), np.minimum(squared, GATE * GATE_SCALE_MIN), squared)

    def redundancy(self, used: Array) -> Array:
        """(k,) share of a used closure's own noise left in its residual, in the direction where it is largest."""
        own = self.own_noise(used)
        root = np.linalg.inv(np.linalg.cholesky(own))
        return np.linalg.eigvalsh(turned(root, own - self.drift(used)))[:, -1]

    def moves_without(self, used: Array) -> Array:
        """(k,) root mean square distance [m] by which key poses move without each used closure, to first order.

        Undoes the Kalman update by that closure: the joint covariance P times J^T (N - J P J^T)^-1 e.
        """
        i, j = self._i[used], self._j[used]
        error, drift = self.predicted(used)[0], self.drift(used)
        noise = self.own_noise(used) + self._off_key(i) + self._off_key(j)
        pull = np.linalg.solve(noise - drift + 1e-9 * np.eye(3), error[..., None])
        places = self._poses[self._keys, :2]
        out = np.empty(len(used))
        for k, (a, b) in enumerate(zip(self._key_of[i], self._key_of[j], strict=True)):
            keys = len(places)
            twist = (self._joint[:keys, :, a] - self._joint[:keys, :, b]) @ pull[k, :, 0]
            shift = twist[:, :2] + twist[:, 2:] * np.column_stack([-places[:, 1], places[:, 0]])
            out[k] = math.sqrt(float(((shift - shift.mean(axis=0)) ** 2).sum()) / keys)
        return out

    def joint_of(self, closures: Array, covariance: Array) -> Array:
        """(k, 3, k, 3) joint covariance of several closures' predictions, with `covariance` (k, 3, 3) on the
        diagonal."""
        a, b = self._key_of[self._i[closures]], self._key_of[self._j[closures]]
        count = len(closures)
        joint = np.zeros((count, 3, count, 3))
        for left, right, sign in ((b, b, 1.0), (b, a, -1.0), (a, b, -1.0), (a, a, 1.0)):
            joint += sign * self._joint[left][:, :, right]
        k = np.arange(count)
        joint[k, :, k] = covariance
        return joint

    def _off_key(self, nodes: Array) -> Array:
        return self._chains.stretch(self._accumulated, self._keys[self._key_of[nodes]], nodes, self._shared)

    def _claimed(self, closures: Array) -> Array:
        """(k, 3, 3) adjoint from the frame of each closure's measured second pose to the world frame."""
        return adjoint(compose(self._poses[self._i[closures]], self._graph.measured[self._closures[closures]]))


@kernel
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


def _add_shared(hessian: Array, a: Array, first: int, owner: Array, weight: Array, bends: Array) -> None:
    """Add to (n, 3, n, 3) how shared errors change the edges a - a + 1 (k,) with information (k, 3, 3).

    bends (k, 3, 3): change by one standard deviation of the error of owner (k,). Rows of the owners start at `first`.
    """
    for row in range(first, len(hessian)):
        hessian[row, :, row] += np.eye(3)
    said = np.swapaxes(bends, 1, 2) @ weight
    _add_bent(hessian, a, first + owner, owner >= 0, said, said @ bends)


@kernel
def _add_bent(hessian, a, row_of, is_owned, said, own):
    """The loop of `_add_shared`: own (k, 3, 3) on the diagonal of each edge's row (k,), said (k, 3, 3) beside it."""
    for k in range(len(a)):
        if not is_owned[k]:
            continue
        row = row_of[k]
        for i in range(3):
            for j in range(3):
                hessian[row, i, row, j] += own[k, i, j]
                for key, value in ((a[k] + 1, -said[k, i, j]), (a[k], said[k, i, j])):
                    hessian[row, i, key, j] += value
                    hessian[key, j, row, i] += value
