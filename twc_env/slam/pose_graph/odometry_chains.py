"""The odometry chains of a pose graph, one per robot, with the covariance between any two poses of a chain."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.records.geometry import compose_one
from twc_env.records.twists import adjoint, turned
from twc_env.slam.pose_graph.solver import Graph
from twc_env.slam.pose_graph.systematic_errors import UNOWNED


class Chains:
    """Per pose: chain, position in the chain, and accumulated covariance."""

    def __init__(self, graph: Graph, poses: Array):
        count = len(poses)
        following, edge, has_previous = [-1] * count, [-1] * count, [False] * count
        along = np.flatnonzero(~graph.is_closure)
        for e, a, b in zip(along.tolist(), *graph.edges[along].T.tolist(), strict=True):
            if following[a] < 0 and not has_previous[b]:
                following[a], edge[a], has_previous[b] = b, e, True
        chain, steps, edge_before = [-1] * count, [0] * count, [-1] * count
        self.order: list[int] = []
        for start in [*(k for k in range(count) if not has_previous[k]), *range(count)]:
            node, step = start, 0
            while node >= 0 and chain[node] < 0:
                chain[node], steps[node] = start, step
                self.order.append(node)
                if edge[node] >= 0 and chain[following[node]] < 0:
                    edge_before[following[node]] = edge[node]
                node, step = following[node], step + 1
        self.chain, self.step = np.array(chain, np.int64), np.array(steps, np.int64)
        self.edge_before = np.array(edge_before, np.int64)
        """(n,) odometry edge that ends at each pose."""
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
        x, y, heading = (column.tolist() for column in poses.T)
        ahead, aside, turn = (column.tolist() for column in self._measured.T)
        edges, before = self.edge_before.tolist(), -1
        for node in self.order:
            if (e := edges[node]) >= 0:
                at, motion = (x[before], y[before], heading[before]), (ahead[e], aside[e], turn[e])
                x[node], y[node], heading[node] = compose_one(at, motion)
            before = node
        return np.column_stack([x, y, heading])

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
