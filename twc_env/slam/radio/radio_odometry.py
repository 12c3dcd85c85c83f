"""Online odometry correction by radio SLAM, for one robot without laser; radio constraints start from the result.

Whenever the path has grown by a third, all of it is solved as a log (`radio_slam`), so that the total time is a few
times that of the last solution. Motions since then are odometry, corrected by the systematic errors of the solved part.
"""

from __future__ import annotations

import dataclasses
import math

import numpy as np
from numpy.typing import NDArray

from twc_env.config import RadioSlamConfig
from twc_env.records.geometry import between
from twc_env.records.messages import Keyframe
from twc_env.slam.odometry.odometry_calibration import Calibration, Motions, calibration

CUES = ("wifi",)
"""Cues used: inside a building LTE is too imprecise to correct odometry, alone or beside WiFi."""
FIRST_M, GROWTH = 40.0, 1.33
"""Path length of the first solution, and growth factor until the next."""
PLACES_MAX, PLACE_LENGTH_MAX_M = 100, 10.0
"""Maximum number of places, to bound the time of the step that solves; a path on which they would be further apart than
PLACE_LENGTH_MAX_M is solved again only at its end."""


class RadioOdometry:
    """Corrected motions between one robot's keyframes."""

    def __init__(self, config: RadioSlamConfig):
        self._config = config
        self._keyframes: list[Keyframe] = []
        self._solved: NDArray = np.zeros((0, 3))
        """(k - 1, 3) motions of the solved part, of k keyframes."""
        self._calibration = Calibration()
        self._due_m = FIRST_M
        self.is_corrected = False
        """Whether the last solution improved on odometry."""

    def add(self, keyframe: Keyframe) -> None:
        """Append a keyframe."""
        self._keyframes.append(keyframe)

    @property
    def is_due(self) -> bool:
        """Whether to call `solve` now."""
        return bool(self._keyframes) and self._keyframes[-1].travel_m >= self._due_m

    def solve(self, is_last: bool = False) -> None:
        """Solve the whole path; at its end with as many places as a log."""
        from twc_env.slam.radio import radio_slam  # slow to import, and used without laser only

        places_max = self._config.places_max if is_last else min(self._config.places_max, PLACES_MAX)
        log = radio_slam.log_of(self._keyframes)
        result = radio_slam.solve(log, dataclasses.replace(self._config, places_max=places_max), CUES)
        self.is_corrected = not result.fell_back
        self._solved = between(result.poses[:-1], result.poses[1:])
        self._calibration = calibration(Motions(log.motions, log.turned_rad), result.poses)
        due_m = GROWTH * self._keyframes[-1].travel_m
        self._due_m = due_m if due_m <= PLACES_MAX * PLACE_LENGTH_MAX_M else math.inf

    @property
    def motions(self) -> NDArray:
        """(keyframes - 1, 3) corrected motions."""
        count = len(self._solved)
        rest = np.array([keyframe.motion for keyframe in self._keyframes[count + 1 :]]).reshape(-1, 3)
        return np.concatenate([self._solved, self._calibration.applied(Motions(rest, rest[:, 2])).motion])
