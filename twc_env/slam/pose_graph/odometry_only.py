"""Correction of odometry edges that scan matching did not constrain, as along a corridor, for a new odometry scale.

A robot estimates its odometry scale where scans constrain all directions, often only after such a stretch. The edges
of the stretch are in the graph with the scale known at the time.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.records.messages import Keyframe

MOVED_M = 0.05
"""Edges are corrected when the length of a robot's unconstrained path changes by more than this."""


class OdometryOnlyMotions:
    """Graph edges of each robot with a part measured by odometry alone, and the scale applied to them."""

    def __init__(self, robot_count: int):
        self._edges: list[list[int]] = [[] for _ in range(robot_count)]
        self._read_m: list[list[tuple[float, float]]] = [[] for _ in range(robot_count)]
        """Raw odometry part of each edge, in the axes of the keyframe at its end."""
        self._applied: list[list[float]] = [[] for _ in range(robot_count)]
        """Scale error already corrected in each edge."""
        self._length_m = [0.0] * robot_count
        """Total raw odometry length of each robot's edges."""

    def add_robot(self) -> None:
        """Make room for one more robot."""
        self._edges.append([])
        self._read_m.append([])
        self._applied.append([])
        self._length_m.append(0.0)

    def add(self, keyframe: Keyframe, edge: int) -> None:
        """Add the odometry edge to a new keyframe."""
        ahead, left = keyframe.by_odometry_m
        if ahead == left == 0.0:
            return
        robot, scale = keyframe.robot, keyframe.odometry_scale[0]
        self._edges[robot].append(edge)
        self._read_m[robot].append((ahead / (1.0 - scale), left / (1.0 - scale)))
        self._applied[robot].append(scale)
        self._length_m[robot] += float(np.hypot(*self._read_m[robot][-1]))

    def corrections(self, robot: int, scale: float) -> tuple[Array, Array] | None:
        """Edges (k,) and corrections (k, 2) [m] for a scale error, in the axes of the keyframes at their ends.

        None if the change is less than `MOVED_M`.
        """
        if not self._edges[robot]:
            return None
        less = np.array(self._applied[robot]) - scale
        if np.abs(less).max() * self._length_m[robot] < MOVED_M:
            return None
        self._applied[robot] = [scale] * len(less)
        return np.array(self._edges[robot]), less[:, None] * np.array(self._read_m[robot])

    def clear(self) -> None:
        """Drop all edges, after the graph has renumbered them: their motions stay as they are."""
        for robot in range(len(self._edges)):
            self._edges[robot], self._read_m[robot], self._applied[robot] = [], [], []
            self._length_m[robot] = 0.0
