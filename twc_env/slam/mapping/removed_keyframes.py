"""Poses of removed keyframes, so that a robot's complete trajectory stays available."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.records.geometry import between, compose

_ENTRY = np.dtype([("robot", "i4"), ("index", "i4"), ("step", "i4"), ("carrier", "i4"), ("pose", "f4", 3)])
"""Robot, keyframe index and step; carrier: the node to which the keyframe is attached; pose in the carrier's frame."""


class RemovedKeyframes:
    """Removed keyframes, each rigidly attached to a node that is kept, its carrier."""

    def __init__(self) -> None:
        self._entries = np.zeros(0, _ENTRY)

    def __len__(self) -> int:
        return len(self._entries)

    def add(self, keyframes: tuple[Array, Array, Array], nodes: Array, carrier_of: Array, poses: Array) -> None:
        """Add removed keyframes: their robots, indices, steps and nodes (k,).

        carrier_of (nodes,): the kept node that carries each node, itself if it is kept; poses (nodes, 3).
        """
        new = np.zeros(len(nodes), _ENTRY)
        new["robot"], new["index"], new["step"] = keyframes
        new["carrier"] = nodes
        entries = self._entries = np.concatenate([self._entries, new])
        before, after = entries["carrier"], carrier_of[entries["carrier"]]
        moved = np.flatnonzero(before != after)
        relative = between(poses[after[moved]], poses[before[moved]])
        entries["pose"][moved] = compose(relative, entries["pose"][moved])
        entries["carrier"] = after

    def renumber(self, number_of: Array) -> None:
        """Renumber the nodes; number_of (n,): new indices."""
        self._entries["carrier"] = number_of[self._entries["carrier"]]

    def steps_among(self, robot: int, held: Array, steps: Array) -> Array:
        """(keyframes,) steps of a robot's complete path, from those of its keyframes in the graph, of indices held."""
        own = self._entries[self._entries["robot"] == robot]
        whole = np.empty(len(held) + len(own), steps.dtype)
        whole[held], whole[own["index"]] = steps, own["step"]
        return whole

    def poses_among(self, robot: int, held: Array, own_poses: Array, poses: Array) -> Array:
        """(keyframes, 3) poses of the complete path; own_poses (k, 3) of the robot's nodes, poses (nodes, 3) of all."""
        own = self._entries[self._entries["robot"] == robot]
        whole = np.empty((len(held) + len(own), 3))
        whole[held], whole[own["index"]] = own_poses, compose(poses[own["carrier"]], own["pose"])
        return whole
