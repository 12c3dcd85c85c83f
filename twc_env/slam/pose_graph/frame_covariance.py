"""Covariance of the relative poses of the robots' frames in a merged pose graph, from all its edges.

The frame of a robot is defined by its whole trajectory: its error is the mean rigid motion of the robot's pose errors.
The covariance between two frames tells how well two robots are merged, whichever edges connect them.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.slam.pose_graph.solver import Graph, NormalEquations


def frame_covariances(poses: Array, graph: Graph, robot_of: Array) -> Array:
    """(robots, robots, 3, 3) covariance of the relative pose of two robots' frames, at the centroid of poses (n, 3).

    robot_of (n,): robot of each pose, counted from 0. All edges of the graph are used; unconnected parts get the large
    covariance given by `pose_graph.NEGLIGIBLE_DAMPING`.
    """
    count = int(robot_of.max()) + 1
    equations = NormalEquations(graph.edges, graph.measured, graph.information, len(poses), 0, graph.shared)
    moves, middle = np.zeros((count, 3, len(poses), 3)), poses[:, :2].mean(axis=0)
    for robot in range(count):
        own = np.flatnonzero(robot_of == robot)
        ahead, left = middle - poses[own, :2].mean(axis=0)
        moves[robot][:, own] = np.array([[1.0, 0.0, -left], [0.0, 1.0, ahead], [0.0, 0.0, 1.0]])[:, None] / len(own)
    moves[:, :, 0] = 0.0  # the fixed pose
    flat = moves.reshape(3 * count, -1)
    joint = flat @ equations.solve_right_sides(poses, moves.reshape(3 * count, -1, 3)).reshape(3 * count, -1).T
    joint = joint.reshape(count, 3, count, 3).transpose(0, 2, 1, 3)
    own, cross = joint[np.arange(count), np.arange(count)], joint + np.swapaxes(joint, 2, 3)
    return own[:, None] + own[None] - cross


def frame_stds(poses: Array, graph: Graph, robot_of: Array) -> Array:
    """(robots, robots, 2) standard deviations of `frame_covariances`: position (both axes together) and heading."""
    variance = np.diagonal(frame_covariances(poses, graph, robot_of), axis1=2, axis2=3)
    return np.sqrt(np.maximum(np.stack([variance[..., 0] + variance[..., 1], variance[..., 2]], axis=-1), 0.0))
