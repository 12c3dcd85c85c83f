"""The odometry chains of a pose graph, one per robot, with the covariance between any two poses of a chain."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.records.geometry import compose
from twc_env.records.twists import adjoint, turned
from twc_env.slam.pose_graph.solver import Graph
from twc_env.slam.pose_graph.systematic_errors import UNOWNED


class Chains:
    """Per pose: chain, position in the chain, and accumulated covariance."""

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
        self.edge_before = np.full(count, -1)  # odometry edge that ends at each pose
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
        self._bends: Array | None = None
        self.owner = np.full(count, UNOWNED)
        """(n,) owner of the odometry edge that ends at each pose, as in `SharedErrors`."""
        if graph.shared is not None:
            self._bends = graph.shared.bends[np.maximum(self.edge_before, 0)]
            self._bends[self.edge_before < 0] = 0.0
            self.owner = np.where(self.edge_before < 0, UNOWNED, graph.shared.owner[np.maximum(self.edge_before, 0)])

    def dead_reckoning(self, poses: Array) -> Array:
        """Poses integrated from odometry alone, starting at each chain's first pose."""
        out = poses.copy()
        before = -1
        for node in self.order:
            edge = self.edge_before[node]
            if edge >= 0:
                out[node] = compose(out[before], self._measured[edge])
            before = node
        return out

    def accumulated_covariance(self, poses: Array) -> Array:
        """(n, 3, 3) accumulated covariance of independent motion noise up to each pose, as world-frame twists; the
        covariance between two poses of a chain is their difference."""
        return self._summed(turned(adjoint(poses), self._covariance))

    def shared_error_columns(self, poses: Array) -> Array | None:
        """(n, 3, 3) displacement of each pose by shared errors of one standard deviation, accumulated as world-frame
        twists; differences as above. None without shared errors."""
        return None if self._bends is None else self._summed(adjoint(poses) @ self._bends)

    def _summed(self, steps: Array) -> Array:
        """Cumulative sums of (n, 3, 3) over all chains in sequence; only differences within one chain are used."""
        out, order = np.empty_like(steps), np.array(self.order)
        out[order] = np.cumsum(steps[order], axis=0)
        return out

    def stretch(self, accumulated: Array, a: Array, b: Array, shared: Array | None = None) -> Array:
        """(k, 3, 3) covariance of odometry between poses a and b of one chain each, with shared errors if given."""
        sign = np.where(self.step[a] > self.step[b], -1.0, 1.0)
        noise = (accumulated[b] - accumulated[a]) * sign[:, None, None]
        return noise if shared is None else noise + turned(shared[b] - shared[a], np.eye(3))
