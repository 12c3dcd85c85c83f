"""Parts of a pose graph that nothing connects, poses for vertices that have none, poses that no closure checks, and
parts that hang on a single closure."""

from __future__ import annotations

import math
from collections import deque

import numpy as np
from numpy.typing import NDArray as Array
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from twc_env.records.geometry import compose_one
from twc_env.records.planar_graph import PlanarGraph

Motion = tuple[float, float, float]


def components_of(graph: PlanarGraph) -> Array:
    """(n,) number of the component of each vertex, in the order of their first vertices; landmarks connect too."""
    n, m = len(graph.poses), len(graph.landmark_ids)
    ends = np.concatenate([graph.edges, graph.landmark_observations + np.array([0, n])])
    pairs = coo_array((np.ones(len(ends), np.int8), (ends[:, 0], ends[:, 1])), shape=(n + m, n + m))
    labels = connected_components(pairs, directed=False)[1][:n]
    first, number = np.unique(labels, return_index=True)[1], np.unique(labels, return_inverse=True)[1]
    rank = np.empty(len(first), np.int64)
    rank[np.argsort(first)] = np.arange(len(first))
    return rank[number.ravel()]


def placed_poses(graph: PlanarGraph) -> Array:
    """(n, 3) poses of the file; others are laid along the edges, odometry first, from those that have one.

    A component without any begins at (0, 0, 0).
    """
    poses: list[Motion] = [(x, y, heading) for x, y, heading in graph.poses.tolist()]
    is_placed = [not math.isnan(x) for x, _, _ in poses]
    if all(is_placed):
        return np.array(graph.poses)
    ways: list[list[tuple[int, Motion, bool]]] = [[] for _ in poses]
    for (a, b), motion, is_along in zip(
        graph.edges.tolist(), graph.measured.tolist(), graph.is_odometry.tolist(), strict=True
    ):
        ways[a].append((b, tuple(motion), is_along))
        ways[b].append((a, _back(tuple(motion)), is_along))
    waiting: deque[int] = deque(k for k, known in enumerate(is_placed) if known)
    later: deque[tuple[int, int, Motion]] = deque()
    for seed in range(len(poses)):
        while True:
            while waiting:
                at = waiting.popleft()
                for to, motion, is_along in ways[at]:
                    if not is_placed[to] and is_along:
                        poses[to], is_placed[to] = compose_one(poses[at], motion), True
                        waiting.append(to)
                    elif not is_placed[to]:
                        later.append((at, to, motion))
            while later and is_placed[later[0][1]]:
                later.popleft()
            if not later:
                break
            at, to, motion = later.popleft()
            poses[to], is_placed[to] = compose_one(poses[at], motion), True
            waiting.append(to)
        if not is_placed[seed]:
            poses[seed], is_placed[seed] = (0.0, 0.0, 0.0), True
            waiting.append(seed)
    return np.array(poses)


def _back(motion: Motion) -> Motion:
    c, s = math.cos(motion[2]), math.sin(motion[2])
    return -c * motion[0] - s * motion[1], s * motion[0] - c * motion[1], -motion[2]


def unchecked_poses(count: int, edges: Array) -> Array:
    """(count,) bool: poses on no cycle of the edges (e, 2): every edge at them is a bridge."""
    out = np.ones(count, bool)
    out[edges[poses_behind(count, edges) == 0].ravel()] = False
    return out


def hanging_parts(count: int, edges: Array, is_closure: Array, witnesses: Array) -> dict[int, int]:
    """Closures whose error nothing would show, and the poses of the smaller part that each alone holds.

    Of edges (e, 2) between `count` poses; witnesses (w, 2) are pairs whose relative pose something else tells.
    """
    behind = poses_behind(count, np.concatenate([edges, witnesses]))[: len(edges)]
    return {e: int(behind[e]) for e in np.flatnonzero((behind > 0) & is_closure).tolist()}


def poses_apart(count: int, edges: Array) -> int:
    """Of `count` poses those outside of the largest part that the edges (e, 2) connect."""
    pairs = coo_array((np.ones(len(edges), np.int8), (edges[:, 0], edges[:, 1])), shape=(count, count))
    return count - int(np.bincount(connected_components(pairs, directed=False)[1]).max(initial=0))


def poses_behind(count: int, edges: Array) -> Array:
    """(e,) of edges (e, 2) that are bridges: the poses of the smaller part behind them; 0 of others (Tarjan 1974)."""
    ways: list[list[tuple[int, int]]] = [[] for _ in range(count)]
    for e, a, b in zip(range(len(edges)), *edges.T.tolist(), strict=True):
        ways[a].append((b, e))
        ways[b].append((a, e))
    order, low, below = [-1] * count, [0] * count, [1] * count
    behind = np.zeros(len(edges), np.int64)
    clock = 0
    for root in range(count):
        if order[root] >= 0:
            continue
        bridges = []
        stack = [(root, -1, iter(ways[root]))]
        order[root] = low[root] = clock
        clock += 1
        while stack:
            at, came_by, rest = stack[-1]
            for to, e in rest:
                if e == came_by:
                    continue
                if order[to] < 0:
                    order[to] = low[to] = clock
                    clock += 1
                    stack.append((to, e, iter(ways[to])))
                    break
                low[at] = min(low[at], order[to])
            else:
                stack.pop()
                if stack:
                    before = stack[-1][0]
                    low[before] = min(low[before], low[at])
                    below[before] += below[at]
                    if low[at] > order[before]:
                        bridges.append((came_by, below[at]))
        for e, poses in bridges:
            behind[e] = min(poses, below[root] - poses)
    return behind
