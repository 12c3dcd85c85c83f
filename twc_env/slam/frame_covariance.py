"""How surely a pose graph says where the ways of its robots lie to each other: all of it, odometry as well as closures.

A robot's frame is where its whole way, as it lies in the map, places that map: the mean of what its poses are off by.
Two robots are as surely merged as their frames agree, whatever ties lead from one to the other.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.slam.pose_graph import Graph, NormalEquations


def frame_covariances(poses: Array, graph: Graph, robot_of: Array) -> Array:
    """(robots, robots, 3, 3) covariance of where frames of two robots lie to each other, at the middle of poses (n, 3).

    robot_of (n,) says whose each pose is, counted from 0. All edges of the graph are believed; what they
    do not join is unsure by `pose_graph.NEGLIGIBLE_DAMPING`.
    """
    count = int(robot_of.max()) + 1
    equations = NormalEquations(graph.edges, graph.measured, graph.information, len(poses), 0, graph.shared)
    moves, middle = np.zeros((count, 3, len(poses), 3)), poses[:, :2].mean(axis=0)
    for robot in range(count):
        own = np.flatnonzero(robot_of == robot)
        ahead, left = middle - poses[own, :2].mean(axis=0)
        moves[robot][:, own] = np.array([[1.0, 0.0, -left], [0.0, 1.0, ahead], [0.0, 0.0, 1.0]])[:, None] / len(own)
    moves[:, :, 0] = 0.0  # the pose that is held
    flat = moves.reshape(3 * count, -1)
    joint = flat @ equations.answers(poses, moves.reshape(3 * count, -1, 3)).reshape(3 * count, -1).T
    joint = joint.reshape(count, 3, count, 3).transpose(0, 2, 1, 3)
    own, cross = joint[np.arange(count), np.arange(count)], joint + np.swapaxes(joint, 2, 3)
    return own[:, None] + own[None] - cross


def frame_stds(poses: Array, graph: Graph, robot_of: Array) -> Array:
    """(robots, robots, 2) standard deviations [m, rad] of `frame_covariances`, both axes taken together."""
    variance = np.diagonal(frame_covariances(poses, graph, robot_of), axis1=2, axis2=3)
    return np.sqrt(np.maximum(np.stack([variance[..., 0] + variance[..., 1], variance[..., 2]], axis=-1), 0.0))
