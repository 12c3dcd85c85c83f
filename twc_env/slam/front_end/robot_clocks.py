"""The robots' own clocks: each may have any offset, jump ahead, or skip where frames were lost."""

from __future__ import annotations

import dataclasses
import math

import numpy as np

from twc_env.config import EnvConfig
from twc_env.records.messages import SensorFrame

GAP_S, GAP_TIMES = 0.25, 3.0
"""Two frames of a robot have a gap between them if they are further apart in time than this, and than this multiple of
the previous interval ..."""
GAP_MAX_S = 60.0
"""A gap longer than this is removed in any case: the gyro bias, which may change in the meantime, would add more to the
heading than the odometry's turn is uncertain."""
DEVIATION_TIMES = 3.0
"""... and if the gyro, integrated over that time, deviates from odometry by more than this multiple of its standard
deviation: then the rate was not constant, or the time is wrong."""


class RobotClocks:
    """Frame times relative to each robot's first frame; gaps that contradict its gyro and long ones are removed."""

    def __init__(self, config: EnvConfig, count: int):
        self.times_s = np.full(count, -np.inf)
        """(robots,) time of each robot's last frame, by its own clock."""
        self.given = np.zeros(count, np.int64)
        """(robots,) number of frames of each robot, counted by `CooperativeSlam.update`."""
        self._skipped_s = np.zeros(count)
        """(robots,) time before its first frame and in removed gaps."""
        self.differ = False
        """Whether the clock of some robot began later than the first frames, or has had gaps removed."""
        self._paces_s = np.full(count, config.dynamics.time_step_s)
        """(robots,) interval between its last two frames."""
        self._deviation_max_rad = DEVIATION_TIMES * config.slam.odometry_filter.odometry_turn_std_rad

    def corrected(self, frame: SensorFrame, is_first: bool) -> SensorFrame:
        """The same frame with time relative to the robot's first. After a removed gap, the turn is that of odometry,
        over the interval of the two frames before."""
        robot, rate_rad_s, turned_rad = frame.robot, frame.turn_rate_rad_s, float(frame.odometry[2])
        elapsed_s, pace_s = frame.time_s - self.times_s[robot], self._paces_s[robot]
        self.times_s[robot] = frame.time_s
        is_gap = max(GAP_S, GAP_TIMES * pace_s) < elapsed_s < math.inf
        if is_first:
            self._skipped_s[robot] = frame.time_s
        elif is_gap and (elapsed_s > GAP_MAX_S or abs(rate_rad_s * elapsed_s - turned_rad) > self._deviation_max_rad):
            self._skipped_s[robot] += elapsed_s - pace_s
            rate_rad_s = turned_rad / pace_s
        elif 0.0 < elapsed_s < math.inf:
            self._paces_s[robot] = elapsed_s
        if self._skipped_s[robot] == 0.0:
            return frame
        self.differ = True
        now_s = float(frame.time_s - self._skipped_s[robot])
        return dataclasses.replace(frame, time_s=now_s, turn_rate_rad_s=float(rate_rad_s))
