"""The map of a group of robots as one that lasts, of a size that the building bounds, whatever the number of sessions.

As `keyframe_sparsification`, but newest first and over the paths of all robots and sessions: a keyframe is dropped if a
newer one stands nearby in free line of sight, and newer ones have read its signs often enough; of each square metre at
most `PER_CELL_MAX` stay. What newer evidence contradicts is taken out of old scans (`outdated_beams`).
"""

from __future__ import annotations

import math
from collections import Counter

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.records.geometry import between, compose
from twc_env.records.lasting_map import LastingMap
from twc_env.records.messages import GridMap, Keyframe
from twc_env.slam.mapping.keyframe_sparsification import carriers_of
from twc_env.slam.mapping.team_graph import TeamGraph
from twc_env.slam.pose_graph.graph_arrays import ODOMETRY
from twc_env.slam.pose_graph.graph_sparsification import Edges, sparsified
from twc_env.slam.scans.outdated_beams import without_outdated

PER_CELL_MAX, CELL_M = 4, 1.0
"""Keyframes that are kept in each square of this side, the newest."""
HELD_COVARIANCE = np.diag([1e-6, 1e-6, 1e-8])
"""Of the motions between keyframes of an earlier session [m2, m2, rad2]: their poses are held."""


def saved_map(
    graph: TeamGraph, robots: tuple[int, ...], grid: GridMap, range_max_m: float, prior: LastingMap | None
) -> LastingMap:
    """The map of a group of robots; prior: the map that its robot `graph.prior` stands for, if it is among them."""
    nodes = graph.nodes_of(robots)
    poses, scans_m = graph.rows_of(nodes)
    paths = [iter(path) for path in graph.keyframes]
    keyframes = [next(paths[robot]) for robot in graph.robot_of_node[nodes].tolist()]
    is_old = graph.robot_of_node[nodes] == (-1 if graph.prior is None else graph.prior)
    if is_old.any():
        scans_m = scans_m.copy()
        scans_m[is_old] = without_outdated(poses[is_old], scans_m[is_old], grid, range_max_m)
    stays = _newest(poses, scans_m, keyframes)
    kept = np.flatnonzero(stays)
    session = 0 if prior is None else prior.sessions
    sessions_of = np.full(len(nodes), session)
    if prior is not None:
        sessions_of[is_old] = prior.sessions_of[[k.index for k, old in zip(keyframes, is_old, strict=True) if old]]
    edges = _edges(graph, nodes, keyframes, is_old, stays, prior)
    return LastingMap(
        poses[kept], scans_m[kept], sessions_of[kept], tuple(keyframes[k].signs for k in kept.tolist()),
        tuple(keyframes[k].fingerprint for k in kept.tolist()), *edges,
        _cropped(grid), range_max_m, session + 1,
    )  # fmt: skip


def _newest(poses: Array, scans_m: Array, keyframes: list[Keyframe]) -> Array:
    """(k,) bool: the keyframes that a lasting map keeps; poses (k, 3), scans (k, beams) in order of arrival."""
    newest_first = slice(None, None, -1)
    signs = [keyframe.signs for keyframe in keyframes[newest_first]]
    counts = [len(own) for own in signs]
    local = np.zeros((sum(counts), 3))
    local[:, :2] = np.reshape([sign.position_m for own in signs for sign in own], (-1, 2))
    backwards = np.ascontiguousarray(poses[newest_first])
    places = np.ascontiguousarray(compose(np.repeat(backwards, counts, axis=0), local)[:, :2])
    count = len(poses)
    carriers = carriers_of(
        backwards, np.ascontiguousarray(scans_m[newest_first]), np.zeros(count, np.int64), np.ones(count, bool),
        np.cumsum(counts), places,
    )  # fmt: skip
    stays, held = carriers < 0, Counter[tuple[int, int]]()
    for k in np.flatnonzero(stays).tolist():
        cell = math.floor(backwards[k, 0] / CELL_M), math.floor(backwards[k, 1] / CELL_M)
        held[cell] += 1
        stays[k] = held[cell] <= PER_CELL_MAX
    return stays[newest_first]


def _edges(
    graph: TeamGraph, nodes: Array, keyframes: list[Keyframe], is_old: Array, stays: Array, prior: LastingMap | None
) -> tuple[Array, Array, Array, Array]:
    """The used edges among the kept keyframes, as `LastingMap` has them: those of this session, with odometry along
    dropped keyframes composed, and those of earlier ones of which both ends are kept."""
    is_gone = np.zeros(graph.node_count, bool)
    is_gone[nodes[~stays]] = True
    edges = sparsified(
        Edges(graph.ends, graph.measured, graph.information, graph.closure_of_edge, graph.is_used), is_gone
    )
    number_of = np.full(graph.node_count, -1)
    number_of[nodes[stays]] = np.arange(np.count_nonzero(stays))
    is_of_prior = np.zeros(graph.node_count, bool)
    is_of_prior[nodes[is_old]] = True
    ends = number_of[edges.ends]
    chosen = edges.is_used & (ends >= 0).all(axis=1) & ~is_of_prior[edges.ends].all(axis=1)
    found = ends[chosen], edges.measured[chosen], edges.information[chosen], edges.closure[chosen] != ODOMETRY
    if prior is None:
        return found
    now = np.full(len(prior.poses), -1)
    now[[keyframes[k].index for k in np.flatnonzero(is_old).tolist()]] = number_of[nodes[is_old]]
    ends = now[prior.edge_ends]
    before = (ends >= 0).all(axis=1)
    earlier = ends[before], prior.edge_measured[before], prior.edge_information[before], prior.is_closure[before]
    both = [np.concatenate(pair) for pair in zip(earlier, found, strict=True)]
    return both[0], both[1], both[2], both[3]


def _cropped(grid: GridMap) -> GridMap:
    """The known part of a grid, copied."""
    known = grid.log_odds != 0
    rows, columns = (np.flatnonzero(known.any(axis=axis)) for axis in (1, 0))
    if not len(rows):
        return GridMap(grid.log_odds.copy(), np.array(grid.origin_m), grid.resolution_m)
    origin_m = np.asarray(grid.origin_m) + np.array([columns[0], rows[0]]) * grid.resolution_m
    return GridMap(
        grid.log_odds[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1].copy(), origin_m, grid.resolution_m
    )


def keyframes_of(prior: LastingMap, robot: int) -> list[Keyframe]:
    """The keyframes of a lasting map, as those of one robot of this number whose odometry is never wrong."""
    motions = np.concatenate([np.zeros((1, 3)), between(prior.poses[:-1], prior.poses[1:])])
    travels_m = np.cumsum(np.hypot(motions[:, 0], motions[:, 1]))
    scans_m = np.ascontiguousarray(prior.scans_m, float)
    return [
        Keyframe(
            robot, k, 0, 0.0, prior.poses[k], motions[k], HELD_COVARIANCE, float(travels_m[k]), scans_m[k],
            prior.signs[k], prior.fingerprints[k],
        )
        for k in range(len(prior.poses))
    ]  # fmt: skip
