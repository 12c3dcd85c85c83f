"""A map that lasts: what an engine knows of a building at the end of a session, for the next one to begin with."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.records.messages import Fingerprint, GridMap, SignObservation


@dataclass(frozen=True, slots=True, eq=False)
class LastingMap:
    """Keyframes, pose graph and grid of one map, all in its frame. Estimates only."""

    poses: Array
    """(keyframes, 3) in order of arrival."""
    scans_m: Array
    """(keyframes, beams) as `Keyframe.ranges_m`."""
    sessions_of: Array
    """(keyframes,) int: the session in which each was taken, from 0."""
    signs: tuple[tuple[SignObservation, ...], ...]
    """Texts read near each keyframe."""
    fingerprints: tuple[Fingerprint, ...]
    """Radio fingerprint of each keyframe."""
    edge_ends: Array
    """(edges, 2) int: keyframes that an edge of the pose graph joins."""
    edge_measured: Array
    """(edges, 3) pose of the second end in the frame of the first."""
    edge_information: Array
    """(edges, 3, 3) in the axes of the second end, as in g2o files."""
    is_closure: Array
    """(edges,) bool: a loop closure, not odometry."""
    grid: GridMap
    range_max_m: float
    """The scanner's; a scan that reads as much saw no wall."""
    sessions: int
    """Number of sessions so far."""

    @classmethod
    def of_grid(cls, grid: GridMap, beam_count: int, range_max_m: float) -> LastingMap:
        """A map of which nothing but the grid is known; for scanners of this kind."""
        none, edges = np.zeros(0, np.int64), np.zeros((0, 3))
        return cls(
            np.zeros((0, 3)), np.zeros((0, beam_count)), none, (), (), none.reshape(0, 2), edges,
            np.zeros((0, 3, 3)), none.astype(bool), grid, range_max_m, 0,
        )  # fmt: skip
