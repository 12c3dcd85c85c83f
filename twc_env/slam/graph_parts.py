"""The part of a pose graph that some robots' latest nodes make up, as a graph of its own."""

from __future__ import annotations

import numpy as np

from twc_env.kernels import borrowing_kernel, kernel
from twc_env.slam.graph_arrays import ODOMETRY


@borrowing_kernel
def _is_of_part(ends, is_inside, first, robot_of_node):
    a, b = ends[0], ends[1]
    return max(a, b) >= first and is_inside[robot_of_node[a]] and is_inside[robot_of_node[b]]


@kernel
def part_of(is_inside, first, robot_of_node, ends, measured, information, closure_of_edge, is_used):
    """See `TeamGraph.part`; is_inside (robots,) bool."""
    is_kept = np.zeros(robot_of_node.shape[0], np.bool_)
    for n in range(first, robot_of_node.shape[0]):
        is_kept[n] = is_inside[robot_of_node[n]]
    edge_count = 0
    for e in range(ends.shape[0]):
        if _is_of_part(ends[e], is_inside, first, robot_of_node):
            is_kept[ends[e, 0]] = is_kept[ends[e, 1]] = True
            edge_count += 1
    local = np.full(robot_of_node.shape[0], -1)
    count = 0
    for n in range(robot_of_node.shape[0]):
        if is_kept[n]:
            local[n] = count
            count += 1
    nodes, edges, inner = np.empty(count, np.int64), np.empty(edge_count, np.int64), np.empty((edge_count, 2), np.int64)
    motions, weights = np.empty((edge_count, 3)), np.empty((edge_count, 3, 3))
    closures, used = np.empty(edge_count, np.bool_), np.empty(edge_count, np.bool_)
    for n in range(robot_of_node.shape[0]):
        if local[n] >= 0:
            nodes[local[n]] = n
    k = 0
    for e in range(ends.shape[0]):
        if not _is_of_part(ends[e], is_inside, first, robot_of_node):
            continue
        a, b = local[ends[e, 0]], local[ends[e, 1]]
        edges[k], inner[k, 0], inner[k, 1] = e, a, b
        closures[k], used[k] = closure_of_edge[e] != ODOMETRY, is_used[e]
        for i in range(3):
            motions[k, i] = measured[e, i]
            for j in range(3):
                weights[k, i, j] = information[e, i, j]
        k += 1
    return nodes, edges, inner, motions, weights, closures, used
