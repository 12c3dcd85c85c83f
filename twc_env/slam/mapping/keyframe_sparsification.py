"""Removal of redundant keyframes from a large map, so that its size is bounded by the building, not by time.

As in the pruning of laser scans for lifelong mapping (Kretzschmar and Stachniss 2012), but by position: a keyframe is
removed if the same robot has a kept one nearby in free line of sight, and if kept ones have read its signs often
enough. Paths of robots are sparsified separately, so that a merge can still be undone.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Protocol

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.kernels.compiled import borrowing_kernel, kernel
from twc_env.records.geometry import compose
from twc_env.slam.mapping.team_graph import TeamGraph

LATEST, CLOSURES_KEPT = 30, 12
"""Never removed: this many latest keyframes of each robot, and the ends of this many first accepted closures between
two robots that are not loose."""
SAME_PLACE_M = 1.0
"""A keyframe this near makes another one redundant."""
SAME_SIGN_M, VIEWS_ENOUGH = 1.0, 3
"""A sign reading is redundant if the robot's kept keyframes have this many readings this near."""


@borrowing_kernel
def _is_open(pose, ranges, other):
    """Whether the beam of a scan (beams,) from a pose towards another position reaches it."""
    dx, dy = other[0] - pose[0], other[1] - pose[1]
    beams = ranges.shape[0]
    beam = int(math.floor((math.atan2(dy, dx) - pose[2]) * beams / (2 * math.pi) + 0.5)) % beams
    return abs(ranges[beam]) >= math.hypot(dx, dy)


@borrowing_kernel
def _adds_sign(places, first, end, before, robots, owner, robot, is_kept):
    """Whether any sign from first to end - 1 has fewer than `VIEWS_ENOUGH` readings in the robot's kept keyframes."""
    for k in range(first, end):
        views = 0
        for j in range(before):
            if is_kept[owner[j]] and robots[owner[j]] == robot:
                views += math.hypot(places[j, 0] - places[k, 0], places[j, 1] - places[k, 1]) < SAME_SIGN_M
        if views < VIEWS_ENOUGH:
            return True
    return False


@kernel
def carriers_of(poses, scans, robots, may_go, sign_ends, sign_places):
    """(nodes,) the kept node that makes each node redundant, its carrier; -1 for nodes that are kept.

    poses (nodes, 3) and scans (nodes, beams) in order of arrival; robots (nodes,); may_go (nodes,) bool; sign_places
    (signs, 2) in the map frame, sorted by node; sign_ends (nodes,): end of each node's range in them.
    """
    count = poses.shape[0]
    carriers, is_kept, owner = np.full(count, -1), np.ones(count, np.bool_), np.empty(sign_places.shape[0], np.int64)
    for n in range(count):
        first = sign_ends[n - 1] if n > 0 else 0
        for k in range(first, sign_ends[n]):
            owner[k] = n
        if not may_go[n]:
            continue
        nearest_m2 = SAME_PLACE_M**2
        for m in range(n):
            dx, dy = poses[m, 0] - poses[n, 0], poses[m, 1] - poses[n, 1]
            if dx * dx + dy * dy >= nearest_m2 or not is_kept[m] or robots[m] != robots[n]:
                continue
            if _is_open(poses[m], scans[m], poses[n]) and _is_open(poses[n], scans[n], poses[m]):
                nearest_m2, carriers[n] = dx * dx + dy * dy, m
        if carriers[n] >= 0:
            if _adds_sign(sign_places, first, sign_ends[n], first, robots, owner, robots[n], is_kept):
                carriers[n] = -1
            else:
                is_kept[n] = False
    return carriers


class KeyframeUser(Protocol):
    """A data structure that refers to keyframes by node index or key."""

    def sparsify(self, kept: Array) -> None:
        """Remove keyframes that the graph no longer holds; kept (k,): the former indices of its nodes."""


class KeyframeSparsification:
    """Removes redundant keyframes from a graph and its users."""

    def __init__(self, graph: TeamGraph, users: Sequence[KeyframeUser]):
        self._graph, self._users = graph, users

    def sparsify(self, robots: tuple[int, ...], end: int) -> Array:
        """Remove the redundant nodes before index `end` in the map of these robots.

        Returns the kept nodes (k,) of all robots by their former indices.
        """
        nodes = self._graph.nodes_of(robots)
        may_go = self._may_go(nodes, end) if end > 0 else np.zeros(len(nodes), bool)
        if not may_go.any():
            return np.arange(self._graph.node_count)
        poses, scans = self._graph.rows_of(nodes)
        carriers = carriers_of(poses, scans, self._graph.robot_of_node[nodes], may_go, *self._sign_readings(nodes))
        removed = np.flatnonzero(carriers >= 0)
        if not len(removed):
            return np.arange(self._graph.node_count)
        kept = self._graph.sparsify(nodes[removed], nodes[carriers[removed]])
        for user in self._users:
            user.sparsify(kept)
        return kept

    def _may_go(self, nodes: Array, end: int) -> Array:
        """(k,) bool: which of these nodes may be removed.

        Kept are all from index `end` on, each robot's first and latest ones and its last one with a closure, the ends
        of pending closures, and those of the first `CLOSURES_KEPT` closures between two robots, so that merges can
        still be reviewed and undone.
        """
        graph = self._graph
        paths = map(graph.path_of, range(len(graph.keyframes)))
        stay = [node for own in paths for part in (own[:1], own[-LATEST:]) for node in part.tolist()]
        stay += graph.last_closure_node.tolist()
        counts: dict[tuple[int, int], int] = {}
        for closure in graph.closures:
            ends = closure.candidate.target, closure.candidate.source
            pair = min(ends)[0], max(ends)[0]
            is_fixed = closure.status == "accepted" and pair[0] != pair[1] and not closure.is_loose
            is_kept = is_fixed and counts.get(pair, 0) < CLOSURES_KEPT
            counts[pair] = counts.get(pair, 0) + is_kept
            if is_kept or closure.status == "pending":
                stay += [graph.node(key) for key in ends]
        return (nodes < end) & ~np.isin(nodes, stay)

    def _sign_readings(self, nodes: Array) -> tuple[Array, Array]:
        """sign_ends (k,) and sign_places (signs, 2) of all nodes (k,) of some robots, as `carriers_of` takes them."""
        paths = [iter(path) for path in self._graph.keyframes]
        keyframes = [next(paths[robot]) for robot in self._graph.robot_of_node[nodes].tolist()]
        counts = [len(keyframe.signs) for keyframe in keyframes]
        local = np.zeros((sum(counts), 3))
        local[:, :2] = np.reshape([sign.position_m for keyframe in keyframes for sign in keyframe.signs], (-1, 2))
        places = compose(np.repeat(self._graph.poses[nodes], counts, axis=0), local)[:, :2]
        return np.cumsum(counts), np.ascontiguousarray(places)
