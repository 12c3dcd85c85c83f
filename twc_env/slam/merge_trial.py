"""Maps of several groups tried as one: for robots without laser, whose merges no scans fix.

There odometry bends a map by more than closures are off, and all that two maps say of each other is heard only when
they are optimised together. That shows how surely the robots lie to each other (`frame_covariance`): they share a map
while that is known.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.config import PoseGraphConfig
from twc_env.geometry import compose
from twc_env.messages import LoopClosure
from twc_env.slam.frame_covariance import frame_stds
from twc_env.slam.map_merging import MergeProposal
from twc_env.slam.pose_graph import GATE, Graph, residuals, squared_errors
from twc_env.slam.robust_backend import revise
from twc_env.slam.team_graph import TeamGraph

PLACED = np.array([0.5, math.radians(5.0)])
"""Standard deviations [m, rad] to which robots must be fixed to each other to share a map: half of what makes a merge
wrong."""
STRAYED_SHARE = 1.4
"""Robots of one map that are less sure by so much are taken apart."""
NEAR_M, NEAR_RAD = 1.4, 0.35
"""Closures between two maps are believed at first where they lie this near to what a proposal says."""
AGREEING_SHARE = 0.5
"""So many of the closures that a proposal stems from must agree with the map that is made of all."""


class MergeTrials:
    """Tries maps of one mapper's groups."""

    def __init__(self, config: PoseGraphConfig, graph: TeamGraph):
        self._config, self._graph = config, graph

    def is_placed(self, a: tuple[int, ...], b: tuple[int, ...], proposal: MergeProposal) -> bool:
        """Whether it would be known where each robot of one map lies to each of the other, by all closures that agree
        with the map which the two make."""
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
            return False
        whose, robot_of = np.unique(robot_of, return_inverse=True)
        across = np.ix_(np.isin(whose, a), np.isin(whose, b))
        return bool((frame_stds(tried.poses, graph.of(tried.accepted), robot_of)[across] < PLACED).all())

    def _edges(self, nodes: Array, closures: Sequence[LoopClosure]) -> tuple[Array, Array, Array]:
        """Closures as edges between some nodes (n,), ascending: ends (k, 2), poses (k, 3), information (k, 3, 3)."""
        ends = [[self._graph.node(c.candidate.target), self._graph.node(c.candidate.source)] for c in closures]
        return (
            np.searchsorted(nodes, np.array(ends, np.int64).reshape(-1, 2)),
            np.array([closure.pose_target_source for closure in closures]).reshape(-1, 3),
            np.linalg.inv(np.array([closure.covariance for closure in closures]).reshape(-1, 3, 3)),
        )

    def strayed(self, robots: Sequence[int]) -> tuple[tuple[int, ...], tuple[int, ...]] | None:
        """The two sides of a map that nothing fixes to each other any more; None while all robots are placed."""
        nodes, _, graph, is_used = self._graph.subgraph(robots)
        whose, robot_of = np.unique(self._graph.robot_of_node[nodes], return_inverse=True)
        share = (frame_stds(self._graph.poses[nodes], graph.of(is_used), robot_of) / PLACED).max(axis=-1)
        i, j = np.unravel_index(np.argmax(share), share.shape)
        if not share[i, j] >= STRAYED_SHARE:
            return None
        is_i = share[i] <= share[j]
        return tuple(whose[is_i].tolist()), tuple(whose[~is_i].tolist())
