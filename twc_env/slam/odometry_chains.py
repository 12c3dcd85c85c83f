"""The odometry of a pose graph: one chain of poses per robot, and how uncertain each stretch of it is."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.geometry import compose
from twc_env.slam.pose_graph import Graph
from twc_env.slam.shared_errors import UNOWNED
from twc_env.slam.twists import adjoint, turned


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
        self._bends: Array | None = None
        self.owner = np.full(count, UNOWNED)
        """(n,) whose odometry leads to each pose, as of `SharedErrors`."""
        if graph.shared is not None:
            self._bends = graph.shared.bends[np.maximum(self.edge_before, 0)]
            self._bends[self.edge_before < 0] = 0.0
            self.owner = np.where(self.edge_before < 0, UNOWNED, graph.shared.owner[np.maximum(self.edge_before, 0)])

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
        """(n, 3, 3) covariance of each pose against its chain's first by the noise of single motions, as world twists;
        stretches are differences."""
        return self._summed(turned(adjoint(poses), self._covariance))

    def bent(self, poses: Array) -> Array | None:
        """(n, 3, 3) how shared errors of one standard deviation move each pose against its chain's first, as world
        twists; stretches are differences. None where there are none."""
        return None if self._bends is None else self._summed(adjoint(poses) @ self._bends)

    def _summed(self, steps: Array) -> Array:
        """Sums of what each pose adds (n, 3, 3), over all chains one after the other: differences in one are used."""
        out, order = np.empty_like(steps), np.array(self.order)
        out[order] = np.cumsum(steps[order], axis=0)
        return out

    def stretch(self, grown: Array, a: Array, b: Array, bent: Array | None = None) -> Array:
        """(k, 3, 3) covariance of the odometry between poses a and b of one chain each; with shared errors if given."""
        sign = np.where(self.step[a] > self.step[b], -1.0, 1.0)
        noise = (grown[b] - grown[a]) * sign[:, None, None]
        return noise if bent is None else noise + turned(bent[b] - bent[a], np.eye(3))
