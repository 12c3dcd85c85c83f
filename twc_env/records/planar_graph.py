"""A planar pose graph as somebody else's file holds it, put in order: what a back end can optimise, and what was left
out of it."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray as Array


@dataclass(frozen=True, slots=True, eq=False)
class PlanarGraph:
    """Poses, relative poses between them, and observations of landmarks. Vertices are in the order of their ids."""

    vertex_ids: Array
    """(n,) int64."""
    poses: Array
    """(n, 3); NaN where the file has no place for the vertex."""
    edges: Array
    """(e, 2) indices of vertices; the first has the smaller id."""
    measured: Array
    """(e, 3) pose of the second vertex in the first."""
    information: Array
    """(e, 3, 3)."""
    is_odometry: Array
    """(e,) bool: along a robot's path."""
    held: Array
    """(k,) indices of the vertices that FIX lines name."""
    held_landmarks: Array = field(default_factory=lambda: np.zeros(0, np.int64))
    """(k,) indices of the landmarks that FIX lines name."""
    landmark_ids: Array = field(default_factory=lambda: np.zeros(0, np.int64))
    landmarks_m: Array = field(default_factory=lambda: np.zeros((0, 2)))
    """(m, 2); NaN where the file has no place for it."""
    landmark_observations: Array = field(default_factory=lambda: np.zeros((0, 2), np.int64))
    """(s, 2) index of a vertex and of a landmark."""
    seen_m: Array = field(default_factory=lambda: np.zeros((0, 2)))
    """(s, 2) place of the landmark in the frame of the vertex."""
    seen_information: Array = field(default_factory=lambda: np.zeros((0, 2, 2)))
    remarks: tuple[str, ...] = ()
    """What was left out or turned round, in sentences."""
