"""Segments: the parts of a robot's path between which it was lifted and put down elsewhere.

A mapper treats each segment like a robot of its own, whose map must be merged with the others by place recognition.
Segment r is the first of robot r; later ones are numbered from the count of robots on. A map of an earlier session is
a segment of no robot.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.errors import TwcError
from twc_env.records.messages import Keyframe

NO_ROBOT = -1
"""Owner of the segment that stands for a map of an earlier session."""


class Segments:
    """Which segments there are of which robots, as far as one mapper knows."""

    def __init__(self, robot_count: int):
        self.owners = list(range(robot_count))
        """Robot of each segment; `NO_ROBOT` of a prior map."""
        self.current = list(range(robot_count))
        """The latest segment of each robot."""
        self._first_index = [0] * robot_count
        """Index of each segment's first keyframe among those of its robot."""

    @property
    def is_whole(self) -> bool:
        """Whether no robot was ever carried."""
        return len(self.owners) == len(self.current)

    def begin(self, keyframe: Keyframe) -> int:
        """A new segment of the keyframe's robot begins with it; returns its number."""
        self.current[keyframe.robot] = len(self.owners)
        self.owners.append(keyframe.robot)
        self._first_index.append(keyframe.index)
        return self.current[keyframe.robot]

    def add_prior(self) -> int:
        """A segment of no robot, for a map of an earlier session; returns its number."""
        self.owners.append(NO_ROBOT)
        self._first_index.append(0)
        return len(self.owners) - 1

    def numbered(self, keyframe: Keyframe) -> Keyframe:
        """The keyframe as one of its robot's latest segment."""
        segment = self.current[keyframe.robot]
        if segment == keyframe.robot:
            return keyframe
        return replace(keyframe, robot=segment, index=keyframe.index - self._first_index[segment])

    def of(self, robot: int) -> list[int]:
        """The segments of a robot, in order. Raises TwcError for an unknown robot."""
        found = [segment for segment, owner in enumerate(self.owners) if owner == robot]
        if not found:
            raise TwcError(f"robots are 0 to {len(self.current) - 1}; got {robot!r}")
        return found

    def of_robots(self, ids: Array) -> Array:
        """(k, 2) robots and indices among their keyframes of keyframes (k, 2: segment, index in it); `NO_ROBOT` and the
        index in the map of those of a prior map."""
        return np.stack([np.array(self.owners)[ids[:, 0]], np.array(self._first_index)[ids[:, 0]] + ids[:, 1]], axis=1)

    def robots_in(self, segments: tuple[int, ...]) -> tuple[int, ...]:
        """The robots whose latest segment is among these."""
        if self.is_whole:
            return segments
        return tuple(robot for robot, segment in enumerate(self.current) if segment in segments)

    def latest(self, robots: Array) -> Array:
        """(k,) latest segments of robots (k,)."""
        return np.array(self.current, np.int64)[robots]
