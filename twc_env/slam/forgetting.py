"""What one mapper lets go of once its map is large: keyframes that tell nothing that others do not tell.

The map of a building that is known well needs no more of them, however often robots pass: as in the pruning of laser
scans for lifelong mapping (Kretzschmar and Stachniss 2012), but by place: a keyframe goes if another one of its robot
that stays was taken nearby, with nothing in between, and the signs that it read were read often enough. So there are
as many in the end as the building has room for. Robots are thinned each for itself, so that a merge can be undone.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Protocol

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.geometry import compose
from twc_env.kernels import borrowing_kernel, kernel
from twc_env.slam.team_graph import TeamGraph

LATEST, TIES = 30, 12
"""Of each robot so many of its latest keyframes, and of two robots' first accepted closures that are not loose, are
never forgotten."""
SAME_PLACE_M = 1.0
"""Keyframes this near see the same."""
SAME_SIGN_M, VIEWS_ENOUGH = 1.0, 3
"""A sign that was read so often within this need not be read there again."""


@borrowing_kernel
def _is_open(pose, ranges, other):
    """Whether a scan (beams,) taken at a pose reaches as far as another place."""
    dx, dy = other[0] - pose[0], other[1] - pose[1]
    beams = ranges.shape[0]
    beam = int(math.floor((math.atan2(dy, dx) - pose[2]) * beams / (2 * math.pi) + 0.5)) % beams
    return abs(ranges[beam]) >= math.hypot(dx, dy)


@borrowing_kernel
def _adds_sign(places, first, end, before, robots, owner, robot, is_kept):
    """Whether any of the signs from `first` to `end` was read too seldom, as far as that is kept, by its robot."""
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
    """(nodes,) of each that may go and tells nothing new, which of those that stay tells it; -1 for those that stay.

    poses (nodes, 3) and scans (nodes, beams) in the order in which they came, robots (nodes,), may_go (nodes,) bool;
    sign_places (signs, 2) in the map, those read at one node after those of the nodes before, which end at sign_ends
    (nodes,).
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


class Knower(Protocol):
    """What holds things about keyframes by the graph's numbers or names."""

    def forget(self, kept: Array) -> None:
        """Let go of what is about keyframes that the graph holds no more; kept (k,): the old numbers of its nodes."""


class Forgetting:
    """Lets go of keyframes of one graph, and of what others know about them."""

    def __init__(self, graph: TeamGraph, knowers: Sequence[Knower]):
        self._graph, self._knowers = graph, knowers

    def forget(self, robots: tuple[int, ...], end: int) -> Array:
        """Let go of those nodes before `end` in the map of some robots that tell nothing that others do not.

        (k,): the nodes that stay, of all robots, by their numbers until now.
        """
        nodes = self._graph.nodes_of(robots)
        may_go = self._may_go(nodes, end) if end > 0 else np.zeros(len(nodes), bool)
        if not may_go.any():
            return np.arange(self._graph.node_count)
        poses, scans = self._graph.rows_of(nodes)
        carriers = carriers_of(poses, scans, self._graph.robot_of_node[nodes], may_go, *self._sightings(nodes))
        gone = np.flatnonzero(carriers >= 0)
        if not len(gone):
            return np.arange(self._graph.node_count)
        kept = self._graph.forget(nodes[gone], nodes[carriers[gone]])
        for knower in self._knowers:
            knower.forget(kept)
        return kept

    def _may_go(self, nodes: Array, end: int) -> Array:
        """(k,) bool: which of some nodes may be forgotten: none from `end` on.

        Nor each robot's first and latest and its last one with a closure. Nor those by which two robots were
        first tied to each other, so that merges can still be judged and undone, or whose closures wait for a merge.
        """
        graph = self._graph
        paths = map(graph.path_of, range(len(graph.keyframes)))
        stay = [node for own in paths for part in (own[:1], own[-LATEST:]) for node in part.tolist()]
        stay += graph.tied.tolist()
        ties: dict[tuple[int, int], int] = {}
        for closure in graph.closures:
            ends = closure.candidate.target, closure.candidate.source
            pair = min(ends)[0], max(ends)[0]
            speaks = closure.status == "accepted" and pair[0] != pair[1] and not closure.is_loose
            is_tie = speaks and ties.get(pair, 0) < TIES
            ties[pair] = ties.get(pair, 0) + is_tie
            if is_tie or closure.status == "pending":
                stay += [graph.node(key) for key in ends]
        return (nodes < end) & ~np.isin(nodes, stay)

    def _sightings(self, nodes: Array) -> tuple[Array, Array]:
        """Where the signs of all nodes (k,) of some robots end, and their places, as `carriers_of` takes them."""
        paths = [iter(path) for path in self._graph.keyframes]
        keyframes = [next(paths[robot]) for robot in self._graph.robot_of_node[nodes].tolist()]
        counts = [len(keyframe.signs) for keyframe in keyframes]
        local = np.zeros((sum(counts), 3))
        local[:, :2] = np.reshape([sign.position_m for keyframe in keyframes for sign in keyframe.signs], (-1, 2))
        places = compose(np.repeat(self._graph.poses[nodes], counts, axis=0), local)[:, :2]
        return np.cumsum(counts), np.ascontiguousarray(places)
