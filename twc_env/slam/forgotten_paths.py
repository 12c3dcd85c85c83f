"""Poses of forgotten keyframes, so that a robot's complete trajectory stays available."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.geometry import between, compose

_PLACE = np.dtype([("robot", "i4"), ("index", "i4"), ("step", "i4"), ("carrier", "i4"), ("pose", "f4", 3)])
"""Robot, keyframe index and step; carrier: the node to which the keyframe is attached; pose in the carrier's frame."""


class ForgottenPaths:
    """Forgotten keyframes, each rigidly attached to a node that is kept, its carrier."""

    def __init__(self) -> None:
        self._places = np.zeros(0, _PLACE)

    def __len__(self) -> int:
        return len(self._places)

    def add(self, keyframes: tuple[Array, Array, Array], nodes: Array, carrier_of: Array, poses: Array) -> None:
        """Add forgotten keyframes: their robots, indices and steps (k,), and their nodes (k,).

        carrier_of (nodes,): the kept node that carries each node, itself if it is kept; poses (nodes, 3). Earlier
        entries whose carrier is forgotten move to its carrier.
        """
        there = np.zeros(len(nodes), _PLACE)
        there["robot"], there["index"], there["step"] = keyframes
        there["carrier"] = nodes
        places = self._places = np.concatenate([self._places, there])
        before, after = places["carrier"], carrier_of[places["carrier"]]
        moved = np.flatnonzero(before != after)
        away = between(poses[after[moved]], poses[before[moved]])
        places["pose"][moved] = compose(away, places["pose"][moved])
        places["carrier"] = after

    def renumber(self, number_of: Array) -> None:
        """Replace the node indices; number_of (n,): new index of each old one."""
        self._places["carrier"] = number_of[self._places["carrier"]]

    def steps_among(self, robot: int, held: Array, steps: Array) -> Array:
        """(keyframes,) steps of a robot's complete path; steps (k,) of its keyframes in the graph, of indices held."""
        own = self._places[self._places["robot"] == robot]
        whole = np.empty(len(held) + len(own), steps.dtype)
        whole[held], whole[own["index"]] = steps, own["step"]
        return whole

    def poses_among(self, robot: int, held: Array, own_poses: Array, poses: Array) -> Array:
        """(keyframes, 3) poses of a robot's complete path; own_poses (k, 3) of its keyframes in the graph, with indices
        held; poses (nodes, 3) of all nodes."""
        own = self._places[self._places["robot"] == robot]
        whole = np.empty((len(held) + len(own), 3))
        whole[held], whole[own["index"]] = own_poses, compose(poses[own["carrier"]], own["pose"])
        return whole
