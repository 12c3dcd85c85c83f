"""A robot's odometry as radio SLAM puts it right while the robot goes on: where ties begin without laser.

Whenever the way is a third longer than it was last, the whole of it is solved as a log is (`radio_slam`): so all
solving costs a few times what the last does. What came since goes on by odometry, without the constant errors that the
solved part shows.
"""

from __future__ import annotations

import dataclasses
import math

import numpy as np
from numpy.typing import NDArray

from twc_env.config import RadioSlamConfig
from twc_env.geometry import between
from twc_env.messages import Keyframe
from twc_env.slam.odometry_calibration import Calibration, Motions, calibration

CUES = ("wifi",)
"""What puts odometry right: over ways inside of a building LTE is too blurred for it, alone or beside WiFi."""
FIRST_M, GROWTH = 40.0, 1.33
"""The way is solved when it is so long, and whenever it is so many times as long as then."""
PLACES_MAX, PLACE_LENGTH_MAX_M = 100, 10.0
"""It is solved in so many places at most, for the step in which that happens is the longer the more there are; a way on
which they would lie further apart is not solved any more before its end."""


class RadioOdometry:
    """The motions between one robot's keyframes."""

    def __init__(self, config: RadioSlamConfig):
        self._config = config
        self._keyframes: list[Keyframe] = []
        self._solved: NDArray = np.zeros((0, 3))
        """(k - 1, 3) motions of the solved part, of k keyframes."""
        self._calibration = Calibration()
        self._due_m = FIRST_M
        self.is_righted = False
        """Whether radio told more than odometry when the way was solved last."""

    def add(self, keyframe: Keyframe) -> None:
        """Go on to a keyframe."""
        self._keyframes.append(keyframe)

    @property
    def is_due(self) -> bool:
        """Whether to `solve` now."""
        return bool(self._keyframes) and self._keyframes[-1].travel_m >= self._due_m

    def solve(self, is_last: bool = False) -> None:
        """Put right the whole way; at its end in as many places as a log has."""
        from twc_env.slam import radio_slam  # slow to import, and used without laser alone

        places_max = self._config.places_max if is_last else min(self._config.places_max, PLACES_MAX)
        log = radio_slam.log_of(self._keyframes)
        result = radio_slam.solve(log, dataclasses.replace(self._config, places_max=places_max), CUES)
        self.is_righted = not result.fell_back
        self._solved = between(result.poses[:-1], result.poses[1:])
        self._calibration = calibration(Motions(log.motions, log.turned_rad), result.poses)
        due_m = GROWTH * self._keyframes[-1].travel_m
        self._due_m = due_m if due_m <= PLACES_MAX * PLACE_LENGTH_MAX_M else math.inf

    @property
    def motions(self) -> NDArray:
        """(keyframes - 1, 3)."""
        count = len(self._solved)
        rest = np.array([keyframe.motion for keyframe in self._keyframes[count + 1 :]]).reshape(-1, 3)
        return np.concatenate([self._solved, self._calibration.applied(Motions(rest, rest[:, 2])).motion])
