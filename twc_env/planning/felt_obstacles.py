"""Obstacles that a robot bumped into and its scanner does not see, from commands and odometry: shown in its scans.

As Kobuki's `kobuki_bumper2pc` does for ROS, where an event of the bumper becomes points ahead of the robot, which
planners treat like those of a scanner, and its `kobuki_safety_controller`, which then drives back. Here nothing but
standing still tells that there is something.
"""

from __future__ import annotations

import math
from collections import deque

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.config import DynamicsConfig
from twc_env.kernels.compiled import kernel
from twc_env.records.geometry import compose, inverse, transform_points
from twc_env.records.messages import Belief

STALL_S = 0.5
"""A robot that moved less than `STALL_SHARE` of what it was told for this long has bumped into something, ..."""
STALL_SHARE, STALL_M = 0.3, 0.04
"""... if it was told to move this far at least."""
SEEN_M, SEEN_RAD = 0.1, 0.5
"""What the scan shows this close to the rim, within this angle of the motion, explains the bump."""
AHEAD_M = 0.02
"""Distance of the remembered point from the rim."""
SIZE_M = 0.08
"""Radius of the disc that the scan shows in place of a point."""
RETREAT_S, RETREAT_M_S = 0.8, 0.25
"""After a bump a robot drives back this long and this fast, to where it can turn and look for another way, ..."""
RETREAT_ROOM_M, BEHIND_RAD = 0.25, 1.0
"""... if the scan shows nothing this close to the rim, within this angle of the motion."""
MEMORY_S = 120.0
POINTS_MAX = 32
"""The oldest is forgotten first."""


@kernel
def _show(ranges, points, size):
    """Shorten ranges (beams,) to discs of radius `size` around points (k, 2) in the robot frame."""
    beams = ranges.shape[0]
    per_beam = beams / (2.0 * math.pi)
    for k in range(points.shape[0]):
        away, beam = math.hypot(points[k, 0], points[k, 1]), math.atan2(points[k, 1], points[k, 0]) * per_beam
        half = math.asin(min(size / max(away, 1e-6), 1.0)) * per_beam
        for n in range(math.ceil(beam - half), math.floor(beam + half) + 1):
            if ranges[n % beams] <= 0.0 or ranges[n % beams] > away:
                ranges[n % beams] = away


class FeltObstacles:
    """Remembers where one robot bumped into what it does not see, in the frame of its odometry."""

    def __init__(self, dynamics: DynamicsConfig):
        self._dynamics = dynamics
        steps = max(1, round(STALL_S / dynamics.time_step_s))
        self._told_m: deque[float] = deque(maxlen=steps)
        self._poses: deque[Array] = deque(maxlen=steps + 1)
        self._speed_m_s = 0.0
        """That the robot would have if nothing stopped it."""
        self._points = np.zeros((0, 2))
        self._until: list[int] = []
        """Step until which each is remembered."""
        self._retreat_until, self._retreat_m_s = -1, 0.0

    def tell(self, speed_m_s: float) -> None:
        """Note the speed of the command for the next step; call once per step, after `feel`."""
        change = self._dynamics.acceleration_max_m_s2 * self._dynamics.time_step_s
        self._speed_m_s = min(max(speed_m_s, self._speed_m_s - change), self._speed_m_s + change)
        self._told_m.append(self._speed_m_s * self._dynamics.time_step_s)

    def retreat_m_s(self, belief: Belief) -> float:
        """Speed [m/s] of a robot that has just bumped into something and drives straight back; else 0."""
        if belief.step >= self._retreat_until:
            return 0.0
        if self._is_seen(belief, math.copysign(1.0, self._retreat_m_s), RETREAT_ROOM_M, BEHIND_RAD):
            self._retreat_until = -1
            return 0.0
        return self._retreat_m_s

    def feel(self, belief: Belief) -> Array:
        """(k, 2) where something is that the scanner does not show, in the robot frame; call once per step."""
        pose = np.array(belief.pose_odom, float)
        if belief.ranges_m is not None and len(belief.ranges_m) == 0:  # not switched on yet, or failed
            self._told_m.clear()
            self._poses.clear()
        self._poses.append(pose)
        told_m = sum(self._told_m)
        if len(self._poses) > len(self._told_m) == self._told_m.maxlen and abs(told_m) > STALL_M:
            moved = transform_points(inverse(self._poses[0]), pose[None, :2])[0]
            if math.hypot(*moved) < STALL_SHARE * abs(told_m):
                self._bump(belief, math.copysign(1.0, told_m))
        if not self._until:
            return self._points
        own = transform_points(inverse(pose), self._points)
        is_left = np.hypot(*own.T) > self._dynamics.robot_radius_m - AHEAD_M  # else the robot stands there
        is_left &= np.array(self._until) > belief.step
        self._points = self._points[is_left]
        self._until = [until for until, left in zip(self._until, is_left.tolist(), strict=True) if left]
        return own[is_left]

    def _bump(self, belief: Belief, forward: float) -> None:
        """Remember a point ahead (1) or behind (-1), unless the scan shows something there."""
        self._told_m.clear()
        self._poses.clear()
        self._poses.append(np.array(belief.pose_odom, float))
        if self._is_seen(belief, forward, SEEN_M, SEEN_RAD):
            return
        offset = np.array([forward * (self._dynamics.robot_radius_m + AHEAD_M), 0.0, 0.0])
        point = compose(np.asarray(belief.pose_odom, float), offset)[:2]
        until = belief.step + round(MEMORY_S / self._dynamics.time_step_s)
        self._points = np.vstack([self._points, point])[-POINTS_MAX:]
        self._until = [*self._until, until][-POINTS_MAX:]
        self._retreat_until = belief.step + round(RETREAT_S / self._dynamics.time_step_s)
        self._retreat_m_s = -forward * min(RETREAT_M_S, self._dynamics.speed_max_m_s)

    def _is_seen(self, belief: Belief, forward: float, room_m: float, angle_rad: float) -> bool:
        """Whether the scan shows something within `room_m` of the rim ahead (1) or behind (-1)."""
        if belief.ranges_m is None or len(belief.ranges_m) == 0:
            return False
        angles = 2.0 * math.pi * np.arange(len(belief.ranges_m)) / len(belief.ranges_m)
        ahead = belief.ranges_m[forward * np.cos(angles) > math.cos(angle_rad)]
        return bool(((ahead > 0.0) & (ahead < self._dynamics.robot_radius_m + room_m)).any())


def shown(ranges_m: Array | None, points_m: Array) -> Array | None:
    """The scan (beams,) with what was felt at points_m (k, 2) in the robot frame."""
    if ranges_m is None or len(ranges_m) == 0 or len(points_m) == 0:
        return ranges_m
    ranges = np.array(ranges_m, float)
    _show(ranges, np.ascontiguousarray(points_m), SIZE_M)
    return ranges
