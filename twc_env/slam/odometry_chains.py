"""The odometry of a pose graph: one chain of poses per robot, and how uncertain each stretch of it is."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from twc_env.geometry import compose
from twc_env.slam.pose_graph import Graph
from twc_env.slam.twists import adjoint, turned

Array = NDArray


class Chains:
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
        steps = turned(adjoint(poses), self._covariance)[order]
        out = np.empty_like(steps)
        out[order] = np.cumsum(steps, axis=0)  # over all chains: only differences within one are used
        return out

    def stretch(self, grown: Array, a: Array, b: Array) -> Array:
        """(k, 3, 3) covariance of the odometry between poses a and b of one chain each."""
        sign = np.where(self.step[a] > self.step[b], -1.0, 1.0)
        return (grown[b] - grown[a]) * sign[:, None, None]
