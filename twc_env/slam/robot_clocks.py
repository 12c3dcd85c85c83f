"""The robots' own clocks: each may count from anywhere, jump ahead, or stand where frames were lost."""

from __future__ import annotations

import dataclasses
import math

import numpy as np

from twc_env.config import EnvConfig
from twc_env.messages import SensorFrame

GAP_S, GAP_TIMES = 0.25, 3.0
"""Between two frames of a robot there is a gap where they are further apart than this, and so many times as far as the
two before ..."""
ASTRAY_TIMES = 3.0
"""... and where the gyro, over that time, turned by so many times more or less than odometry may err: then it did not
turn at that rate all the time, or the time is wrong."""


class RobotClocks:
    """Times of frames, counted by each robot from its first one; gaps that contradict its gyro are left out."""

    def __init__(self, config: EnvConfig, count: int):
        self.times_s = np.full(count, -np.inf)
        """(robots,) of the last frame of each, by its own clock."""
        self.given = np.zeros(count, np.int64)
        """(robots,) how many frames each gave, which whoever takes them counts."""
        self._skipped_s = np.zeros(count)
        """(robots,) what its clock counted before its first frame and in gaps."""
        self._paces_s = np.full(count, config.dynamics.time_step_s)
        """(robots,) between the last two frames of each."""
        self._astray_rad = ASTRAY_TIMES * config.slam.odometry_filter.odometry_turn_std_rad

    def told(self, frame: SensorFrame, is_first: bool) -> SensorFrame:
        """The same frame with the time since the robot's first. After a gap odometry alone says how far it turned, in
        as much time as was between the two frames before."""
        robot, rate_rad_s, turned_rad = frame.robot, frame.turn_rate_rad_s, float(frame.odometry[2])
        elapsed_s, pace_s = frame.time_s - self.times_s[robot], self._paces_s[robot]
        self.times_s[robot] = frame.time_s
        is_gap = max(GAP_S, GAP_TIMES * pace_s) < elapsed_s < math.inf
        if is_first:
            self._skipped_s[robot] = frame.time_s
        elif is_gap and abs(rate_rad_s * elapsed_s - turned_rad) > self._astray_rad:
            self._skipped_s[robot] += elapsed_s - pace_s
            rate_rad_s = turned_rad / pace_s
        elif 0.0 < elapsed_s < math.inf:
            self._paces_s[robot] = elapsed_s
        if self._skipped_s[robot] == 0.0:
            return frame
        now_s = float(frame.time_s - self._skipped_s[robot])
        return dataclasses.replace(frame, time_s=now_s, turn_rate_rad_s=float(rate_rad_s))
