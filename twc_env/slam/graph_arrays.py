"""Nodes and edges of a pose graph in arrays that grow, each taken in by one compiled call."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from twc_env.kernels import borrowing_kernel, kernel
from twc_env.messages import Keyframe
from twc_env.slam.odometry_filter import invert3

Array = NDArray

ODOMETRY = -1
_ROOM = 64
"""Rows to begin with; doubled when they are full."""


@kernel
def _wrap(angle):
    return (angle + math.pi) % (2 * math.pi) - math.pi


@borrowing_kernel
def _put_node(
    node, previous, robot, step, travel, motion, covariance, ranges, poses, scans, robots, steps, travels, strains
):  # fmt: skip
    """Write a node that lies one motion after the previous one (-1: it is the first of its robot)."""
    x = y = heading = 0.0
    if previous >= 0:
        c, s = math.cos(poses[previous, 2]), math.sin(poses[previous, 2])
        x = poses[previous, 0] + c * motion[0] - s * motion[1]
        y = poses[previous, 1] + s * motion[0] + c * motion[1]
        heading = _wrap(poses[previous, 2] + motion[2])
    poses[node, 0], poses[node, 1], poses[node, 2] = x, y, heading
    for i in range(ranges.shape[0]):
        scans[node, i] = ranges[i]
    robots[node], steps[node], travels[node] = robot, step, travel
    across = 0.5 * (covariance[0, 0] + covariance[1, 1])
    for axis in range(3):
        before = strains[previous, axis] if previous >= 0 else 0.0
        strains[node, axis] = before + (across if axis < 2 else covariance[2, 2])


@borrowing_kernel
def _put_edge(edge, first, second, measurement, covariance, closure, is_used, ends, measured, information, kinds, used):
    ends[edge, 0], ends[edge, 1] = first, second
    for axis in range(3):
        measured[edge, axis] = measurement[axis]
    invert3(covariance, information[edge])
    kinds[edge], used[edge] = closure, is_used


@borrowing_kernel
def _follow(
    node, previous, edge, robot, step, travel, motion, covariance, ranges,
    poses, scans, robots, steps, travels, strains, ends, measured, information, kinds, used,
):  # fmt: skip
    """A node, and the edge of odometry that leads to it unless it is the first of its robot."""
    _put_node(
        node, previous, robot, step, travel, motion, covariance, ranges, poses, scans, robots, steps, travels, strains
    )
    if previous >= 0:
        _put_edge(
            edge, previous, node, motion, covariance, ODOMETRY, True, ends, measured, information, kinds, used
        )  # fmt: skip


class GraphArrays:
    """Row by row: nodes are keyframes in the order of their arrival, edges odometry and closures."""

    def __init__(self, beam_count: int):
        self.node_count = self.edge_count = 0
        self._nodes: list[Array] = [
            np.zeros((_ROOM, 3)),
            np.zeros((_ROOM, beam_count)),
            np.zeros(_ROOM, np.int64),
            np.zeros(_ROOM, np.int64),
            np.zeros(_ROOM),
            np.zeros((_ROOM, 3)),
        ]
        self._edges: list[Array] = [
            np.zeros((_ROOM, 2), np.int64),
            np.zeros((_ROOM, 3)),
            np.zeros((_ROOM, 3, 3)),
            np.zeros(_ROOM, np.int64),
            np.zeros(_ROOM, bool),
        ]

    def add_node(self, keyframe: Keyframe, previous: int) -> int:
        """A keyframe, put where odometry leads from the robot's previous node (-1 for its first); gives its node."""
        node, edge = self.node_count, self.edge_count
        if node == len(self._nodes[0]):
            self._nodes = [_doubled(rows) for rows in self._nodes]
        if edge == len(self._edges[0]):
            self._edges = [_doubled(rows) for rows in self._edges]
        _follow(
            node, previous, edge, keyframe.robot, keyframe.step, keyframe.travel_m, keyframe.motion,
            keyframe.motion_covariance, keyframe.ranges_m, *self._nodes, *self._edges,
        )  # fmt: skip
        self.node_count += 1
        self.edge_count += previous >= 0
        return node

    def add_edge(self, ends: tuple[int, int], measured: Array, covariance: Array, closure: int, is_used: bool) -> None:
        """A measured pose (3,) of the second end in the frame of the first; `closure` is the closure's number."""
        if self.edge_count == len(self._edges[0]):
            self._edges = [_doubled(rows) for rows in self._edges]
        _put_edge(self.edge_count, *ends, measured, covariance, closure, is_used, *self._edges)
        self.edge_count += 1

    @property
    def poses(self) -> Array:
        """(nodes, 3) of all keyframes, each in its group's map frame; may be written to."""
        return self._nodes[0][: self.node_count]

    @property
    def scans(self) -> Array:
        """(nodes, beams) [m]."""
        return self._nodes[1][: self.node_count]

    @property
    def robot_of_node(self) -> Array:
        """(nodes,) whose keyframe each is."""
        return self._nodes[2][: self.node_count]

    @property
    def step_of_node(self) -> Array:
        """(nodes,) the step at which each was taken."""
        return self._nodes[3][: self.node_count]

    @property
    def travels_m(self) -> Array:
        """(nodes,) path length of the robot up to each."""
        return self._nodes[4][: self.node_count]

    @property
    def strains(self) -> Array:
        """(nodes, 3) variances gathered along the robot's path up to each [m2, m2, rad2]."""
        return self._nodes[5][: self.node_count]

    @property
    def ends(self) -> Array:
        """(edges, 2) nodes."""
        return self._edges[0][: self.edge_count]

    @property
    def measured(self) -> Array:
        """(edges, 3) pose of the second end in the frame of the first."""
        return self._edges[1][: self.edge_count]

    @property
    def information(self) -> Array:
        """(edges, 3, 3)."""
        return self._edges[2][: self.edge_count]

    @property
    def closure_of_edge(self) -> Array:
        """(edges,) number of the closure, or `ODOMETRY`."""
        return self._edges[3][: self.edge_count]

    @property
    def is_used(self) -> Array:
        """(edges,) bool; may be written to."""
        return self._edges[4][: self.edge_count]


def _doubled(rows: Array) -> Array:
    return np.concatenate([rows, np.zeros_like(rows)])
