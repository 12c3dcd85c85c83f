"""What one mapper lets go of once its map is large: keyframes that tell nothing that others do not tell."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.geometry import compose
from twc_env.slam.known_places import carriers_of
from twc_env.slam.team_graph import TeamGraph

LATEST, TIES = 30, 12
"""Of each robot so many of its latest keyframes, and of two robots' first accepted closures that are not loose, are
never forgotten."""


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
