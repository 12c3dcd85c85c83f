"""Motions that odometry alone has told, as along a corridor's axis: put right once more is known of its scale.

A robot learns by what share its odometry reads too long where scans fix all directions, that is often only at the end
of a way that it has gone by odometry. Its graph holds that way as it was believed when it was gone.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.messages import Keyframe

MOVED_M = 0.05
"""What has been learned is put to use when it makes a robot's way so much longer or shorter."""


class LoneOdometry:
    """Of each robot such motions, as edges of a graph, and the scale by which they stand there."""

    def __init__(self, robot_count: int):
        self._edges: list[list[int]] = [[] for _ in range(robot_count)]
        self._read_m: list[list[tuple[float, float]]] = [[] for _ in range(robot_count)]
        """What odometry read, along the axes of the keyframe at the end of each."""
        self._applied: list[list[float]] = [[] for _ in range(robot_count)]
        self._length_m = [0.0] * robot_count

    def add(self, keyframe: Keyframe, edge: int) -> None:
        """Note a new keyframe, to which this edge leads."""
        ahead, left = keyframe.by_odometry_m
        if ahead == left == 0.0:
            return
        robot, scale = keyframe.robot, keyframe.odometry_scale[0]
        self._edges[robot].append(edge)
        self._read_m[robot].append((ahead / (1.0 - scale), left / (1.0 - scale)))
        self._applied[robot].append(scale)
        self._length_m[robot] += float(np.hypot(*self._read_m[robot][-1]))

    def learned(self, robot: int, scale: float) -> tuple[Array, Array] | None:
        """Edges (k,) and what is to be added to each [m], (k, 2), by the scale known now; None: too little."""
        if not self._edges[robot]:
            return None
        less = np.array(self._applied[robot]) - scale
        if np.abs(less).max() * self._length_m[robot] < MOVED_M:
            return None
        self._applied[robot] = [scale] * len(less)
        return np.array(self._edges[robot]), less[:, None] * np.array(self._read_m[robot])

    def clear(self) -> None:
        """The edges are others now: what stands there stays."""
        for robot in range(len(self._edges)):
            self._edges[robot], self._read_m[robot], self._applied[robot] = [], [], []
            self._length_m[robot] = 0.0
