"""Trial optimisation of merged maps, for robots without laser, whose merges no scan match constrains.

Without laser, odometry distorts a map more than closures deviate, and the information of all inter-map closures only
shows in a joint optimisation. Its covariance between robots (`frame_covariance`) decides whether they share a map.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.config import PoseGraphConfig
from twc_env.records.geometry import compose
from twc_env.records.messages import LoopClosure
from twc_env.slam.mapping.team_graph import TeamGraph
from twc_env.slam.merging.map_merging import MergeProposal
from twc_env.slam.pose_graph.frame_covariance import frame_stds
from twc_env.slam.pose_graph.robust_back_end import revise
from twc_env.slam.pose_graph.solver import GATE, Graph, residuals, squared_errors

STD_MAX = np.array([1.0, math.radians(10.0)]) / 3.0
"""Maximum standard deviation [m, rad] of the relative pose of robots that are merged: a third of the error at which a
merge counts as wrong, as errors above three deviations are rare, and those above two are not."""
SPLIT_RATIO = 1.4
"""Robots of one map are split where the standard deviation exceeds this multiple of STD_MAX."""
NEAR_M, NEAR_RAD = 1.4, 0.35
"""Inter-map closures are initially accepted within this distance of the proposed transform."""
AGREEING_SHARE = 0.5
"""Share of the proposal's closures that must be inliers of the jointly optimised map."""


class MergeTrials:
    """Trial optimisations for the groups of one mapper."""

    def __init__(self, config: PoseGraphConfig, graph: TeamGraph):
        self._config, self._graph = config, graph

    def merged(self, a: tuple[int, ...], b: tuple[int, ...], proposal: MergeProposal) -> tuple[Array, Array] | None:
        """Nodes (n,) of both groups and their poses (n, 3) in the map of `a`, optimised with all consistent closures.

        None unless this determines every pose of a robot of `a` relative to one of `b` to within STD_MAX. Callers
        merge into these poses: from the proposed transform alone, the back end may end in another solution.
        """
        nodes, _, graph, is_used = self._graph.subgraph([*a, *b])
        poses, robot_of = self._graph.poses[nodes], self._graph.robot_of_node[nodes]
        poses[np.isin(robot_of, b)] = compose(proposal.pose_a_b, poses[np.isin(robot_of, b)])
        edges, measured, information = self._edges(nodes, self._graph.waiting.between(a, b))
        away = np.abs(residuals(poses, edges, measured))
        is_near = (np.hypot(away[:, 0], away[:, 1]) < NEAR_M) & (away[:, 2] < NEAR_RAD)
        graph = Graph(
            np.concatenate([graph.edges, edges]),
            np.concatenate([graph.measured, measured]),
            np.concatenate([graph.information, information]),
            np.concatenate([graph.is_closure, np.ones(len(edges), bool)]),
            None if graph.shared is None else graph.shared.and_none(len(edges)),
        )
        tried = revise(poses, graph, np.concatenate([is_used, is_near]), self._config, 0, is_thorough=True)
        squared = squared_errors(tried.poses, *self._edges(nodes, proposal.agreeing))
        if np.mean(squared < GATE) < AGREEING_SHARE:
            return None
        whose, robot_of = np.unique(robot_of, return_inverse=True)
        across = np.ix_(np.isin(whose, a), np.isin(whose, b))
        is_known = (frame_stds(tried.poses, graph.of(tried.accepted), robot_of)[across] < STD_MAX).all()
        return (nodes, tried.poses) if is_known else None

    def _edges(self, nodes: Array, closures: Sequence[LoopClosure]) -> tuple[Array, Array, Array]:
        """Closures as edges between nodes (n,), ascending: ends (k, 2), transforms (k, 3), information (k, 3, 3)."""
        ends = [[self._graph.node(c.candidate.target), self._graph.node(c.candidate.source)] for c in closures]
        return (
            np.searchsorted(nodes, np.array(ends, np.int64).reshape(-1, 2)),
            np.array([closure.pose_target_source for closure in closures]).reshape(-1, 3),
            np.linalg.inv(np.array([closure.covariance for closure in closures]).reshape(-1, 3, 3)),
        )

    def uncertain_split(self, robots: Sequence[int]) -> tuple[tuple[int, ...], tuple[int, ...]] | None:
        """Partition of a group whose relative pose is no longer determined; None while all robots are well
        constrained."""
        nodes, _, graph, is_used = self._graph.subgraph(robots)
        whose, robot_of = np.unique(self._graph.robot_of_node[nodes], return_inverse=True)
        share = (frame_stds(self._graph.poses[nodes], graph.of(is_used), robot_of) / STD_MAX).max(axis=-1)
        i, j = np.unravel_index(np.argmax(share), share.shape)
        if not share[i, j] >= SPLIT_RATIO:
            return None
        is_i = share[i] <= share[j]
        return tuple(whose[is_i].tolist()), tuple(whose[~is_i].tolist())
