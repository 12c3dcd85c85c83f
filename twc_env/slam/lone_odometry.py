"""Motions that odometry alone has told, as along a corridor's axis: put right once more is known of its scale.

A robot learns by what share its odometry reads too long where scans fix all directions, that is often only at the end
of a way that it has gone by odometry. Its graph holds that way as it was believed when it was gone.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.messages import Keyframe
from twc_env.slam.growing import ROOM, grown

MOVED_M = 0.05
"""What has been learned is put to use when it makes a robot's way so much longer or shorter."""


class _Motions:
    """Those of one robot: to which node each leads, and, along the axes there, what odometry read and took off that."""

    def __init__(self) -> None:
        self.count = 0
        self._nodes, self._vectors_m = np.zeros(ROOM, np.int64), np.zeros((ROOM, 2, 2))

    @property
    def nodes(self) -> Array:
        """(k,) ascending."""
        return self._nodes[: self.count]

    @property
    def vectors_m(self) -> Array:
        """(k, 2, 2) what was read and what was taken off; may be written to."""
        return self._vectors_m[: self.count]

    def add(self, node: int, read_m: Array, less_m: Array) -> None:
        """A further one."""
        if self.count == len(self._nodes):
            self._nodes, self._vectors_m = grown(self._nodes), grown(self._vectors_m)
        self._nodes[self.count], self._vectors_m[self.count] = node, (read_m, less_m)
        self.count += 1

    def hand_on(self, heirs: Array, turns_rad: Array) -> None:
        """Each leads to another node (k,), ascending, from which its own looks turned (k,); those to one are one."""
        c, s = np.cos(turns_rad), np.sin(turns_rad)
        turned_m = self.vectors_m @ np.stack([np.stack([c, s], -1), np.stack([-s, c], -1)], -2)
        nodes, firsts = np.unique(heirs, return_index=True)
        self.count = len(nodes)
        self._nodes[: self.count], self._vectors_m[: self.count] = nodes, np.add.reduceat(turned_m, firsts)


class LoneOdometry:
    """Such motions of all robots, as edges of a graph, each named by the node to which it leads."""

    def __init__(self, robot_count: int):
        self._motions = [_Motions() for _ in range(robot_count)]

    def add(self, keyframe: Keyframe, node: int) -> None:
        """Note a new keyframe, which is this node."""
        believed_m = np.array(keyframe.by_odometry_m)
        if believed_m.any():
            read_m = believed_m / (1.0 - keyframe.odometry_scale)
            self._motions[keyframe.robot].add(node, read_m, read_m - believed_m)

    def learned(self, robot: int, scale: float) -> tuple[Array, Array] | None:
        """Nodes (k,), ascending, and what is to be added to the edges there [m], (k, 2); None: too little.

        By the share that odometry is now known to read too long.
        """
        motions = self._motions[robot]
        if not motions.count:
            return None
        read_m, less_m = motions.vectors_m[:, 0], motions.vectors_m[:, 1]
        more_m = less_m - scale * read_m
        if np.hypot(more_m[:, 0], more_m[:, 1]).sum() < MOVED_M:
            return None
        less_m[:] = scale * read_m
        return motions.nodes.copy(), more_m

    def forget(self, paths: Sequence[Array], number_of: Array, headings_rad: Array) -> None:
        """Nodes are gone, past which odometry is joined: what led to them leads to the next that stays.

        paths: the nodes of each robot; number_of (nodes,): their new numbers, -1 for those that are gone; headings_rad
        (nodes,).
        """
        for motions, path in zip(self._motions, paths, strict=True):
            if motions.count:
                stay = path[number_of[path] >= 0]
                heirs = stay[np.searchsorted(stay, motions.nodes)]
                motions.hand_on(number_of[heirs], headings_rad[motions.nodes] - headings_rad[heirs])
