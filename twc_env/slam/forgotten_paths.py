"""Where keyframes stand that a map holds no more: the whole path of a robot is known as long as it goes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.geometry import between, compose

_PLACE = np.dtype([("robot", "i4"), ("index", "i4"), ("step", "i4"), ("carrier", "i4"), ("pose", "f4", 3)])
"""Whose keyframe it was, which and of which step; the node it moves with, and its pose in the frame of that."""


class ForgottenPaths:
    """Each forgotten keyframe moves with one that is held, its carrier."""

    def __init__(self) -> None:
        self._places = np.zeros(0, _PLACE)

    def __len__(self) -> int:
        return len(self._places)

    def add(self, keyframes: tuple[Array, Array, Array], nodes: Array, carrier_of: Array, poses: Array) -> None:
        """Take in robots, indices and steps (k,) of keyframes whose nodes (k,) go.

        carrier_of (nodes,): which of those that stay carries each node, itself if it stays; poses (nodes, 3).
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
        """The nodes (n,) have these numbers now."""
        self._places["carrier"] = number_of[self._places["carrier"]]

    def steps_among(self, robot: int, held: Array, steps: Array) -> Array:
        """(keyframes,) steps of a robot's whole path, from those of the keyframes that are held, by their indices."""
        own = self._places[self._places["robot"] == robot]
        whole = np.empty(len(held) + len(own), steps.dtype)
        whole[held], whole[own["index"]] = steps, own["step"]
        return whole

    def poses_among(self, robot: int, held: Array, own_poses: Array, poses: Array) -> Array:
        """(keyframes, 3) the same of poses; poses (nodes, 3) of all nodes."""
        own = self._places[self._places["robot"] == robot]
        whole = np.empty((len(held) + len(own), 3))
        whole[held], whole[own["index"]] = own_poses, compose(poses[own["carrier"]], own["pose"])
        return whole
