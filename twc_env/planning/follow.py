"""Drive along a path on differential wheels: steer to a point ahead, and never into what the scanner sees now."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.config import DynamicsConfig
from twc_env.geometry import points_along, travelled_m
from twc_env.kernels import kernel

SIGHT_M = 1.6
"""Scan points further away than this do not matter to the next command."""
MARGIN_M = 0.04
"""A command must keep the robot's rim this far from every scan point."""
SLACK_M = 0.01
"""A robot that is nearer to something than the margin may still come nearer by this much, but no nearer than this."""
SQUEEZE_M = 0.015
"""In a gap that leaves no more, it goes on, slowly, as long as so much is left on each side."""
CAUTION_M = 0.22
"""With less than this between rim and scan points ahead, the robot slows down."""
HORIZON_STEPS = 6
"""A command is checked this many steps ahead."""
BRAKING_M_S2 = 1.2
DETOUR_LENGTH_M = 0.5
DETOUR_STEP_RAD = 0.2
"""When the straight way is blocked, bearings this far apart are tried on both sides."""


@kernel
def _near_points(ranges, sight, points):
    """Scan points (k, 2) in the robot frame nearer than `sight`; returns how many."""
    beams = ranges.shape[0]
    step = 2.0 * math.pi / beams
    count = 0
    for i in range(beams):
        if ranges[i] < sight:
            points[count, 0] = ranges[i] * math.cos(i * step)
            points[count, 1] = ranges[i] * math.sin(i * step)
            count += 1
    return count


@kernel
def _arc_clearance(points, count, speed, turn_rate, time_step, steps):
    """Least distance from the robot's centre to any point while it drives an arc."""
    x = y = heading = 0.0
    least = 1e9
    for _ in range(steps):
        heading += 0.5 * turn_rate * time_step
        x += speed * time_step * math.cos(heading)
        y += speed * time_step * math.sin(heading)
        heading += 0.5 * turn_rate * time_step
        for k in range(count):
            away = (points[k, 0] - x) ** 2 + (points[k, 1] - y) ** 2
            if away < least:
                least = away
    return math.sqrt(least)


@kernel
def _ray_clearance(points, count, bearing, length):
    """Least distance of any point to the straight way of `length` toward `bearing`."""
    c, s = math.cos(bearing), math.sin(bearing)
    least = 1e9
    for k in range(count):
        along = min(max(c * points[k, 0] + s * points[k, 1], 0.0), length)
        least = min(least, (points[k, 0] - along * c) ** 2 + (points[k, 1] - along * s) ** 2)
    return math.sqrt(least)


@kernel
def _way_around(points, count, bearing, needed, length):
    """The bearing nearest to the wanted one whose straight way is clear; the wanted one when none is."""
    for k in range(1, 13):
        left, right = bearing + k * DETOUR_STEP_RAD, bearing - k * DETOUR_STEP_RAD
        is_left_clear = _ray_clearance(points, count, left, length) >= needed
        is_right_clear = _ray_clearance(points, count, right, length) >= needed
        if is_left_clear and (not is_right_clear or abs(left) <= abs(right)):
            return left
        if is_right_clear:
            return right
    return bearing


@kernel
def _fastest(points, count, bearing, speed_max, turn_max, time_step, radius, needed, caution, steps):
    """Turn toward `bearing` and drive as fast as the points allow: (speed, turn rate), speed 0 when nothing goes."""
    bearing -= 2.0 * math.pi * math.floor((bearing + math.pi) / (2.0 * math.pi))
    turn_rate = min(max(2.5 * bearing, -turn_max), turn_max)
    speed = speed_max * math.cos(bearing) ** 3 if abs(bearing) < 1.2 else 0.0
    for scale in (1.0, 0.7, 0.45, 0.25, 0.12):
        clear = _arc_clearance(points, count, scale * speed, turn_rate, time_step, steps)
        if clear >= needed:
            room = max(0.35, min(1.0, (clear - radius) / caution))
            return min(scale * speed, speed_max * room), turn_rate
    return 0.0, turn_rate


@kernel
def _drive(points, count, target_x, target_y, speed_max, turn_max, time_step, radius, margin, caution, steps, patience):
    """Speed and turn rate toward a target in the robot frame that keep clear of the points.

    `patience` True: only slow down for what is in the way; False: also look for a way around it.
    """
    bearing, distance = math.atan2(target_y, target_x), math.hypot(target_x, target_y)
    nearest = _ray_clearance(points, count, 0.0, 0.0)
    needed = max(min(radius + margin, nearest - SLACK_M), min(nearest - 1e-6, radius + SLACK_M))
    speed_max = min(speed_max, math.sqrt(2.0 * BRAKING_M_S2 * distance))
    length = min(distance, DETOUR_LENGTH_M)
    clear = _ray_clearance(points, count, bearing, length)
    if not patience and clear < needed:
        if clear >= radius + SQUEEZE_M:  # a gap just wide enough: straight through it, slowly
            needed = radius + SQUEEZE_M
            speed_max *= 0.3
        else:
            bearing = _way_around(points, count, bearing, needed, DETOUR_LENGTH_M)
            speed_max *= 0.5
    return _fastest(points, count, bearing, speed_max, turn_max, time_step, radius, needed, caution, steps)


@kernel
def _point_ahead(path, index, x, y, look_ahead):
    """The point `look_ahead` further along path (k, 2) than the nearest one to (x, y); searches on from `index`.

    Returns (segment index, x, y, distance from the path).
    """
    count = path.shape[0]
    best, best_k, best_t = 1e18, index, 0.0
    for k in range(index, count - 1):
        ax, ay = path[k, 0], path[k, 1]
        dx, dy = path[k + 1, 0] - ax, path[k + 1, 1] - ay
        length2 = dx * dx + dy * dy
        t = 0.0 if length2 == 0.0 else min(1.0, max(0.0, ((x - ax) * dx + (y - ay) * dy) / length2))
        away = (x - ax - t * dx) ** 2 + (y - ay - t * dy) ** 2
        if away < best:
            best, best_k, best_t = away, k, t
        if k > index and away > best + 4.0:
            break
    left = look_ahead
    k, t = best_k, best_t
    while k < count - 1:
        dx, dy = path[k + 1, 0] - path[k, 0], path[k + 1, 1] - path[k, 1]
        length = math.hypot(dx, dy)
        if (1.0 - t) * length >= left and length > 0.0:
            t += left / length
            return best_k, path[k, 0] + t * dx, path[k, 1] + t * dy, math.sqrt(best)
        left -= (1.0 - t) * length
        k, t = k + 1, 0.0
    return best_k, path[count - 1, 0], path[count - 1, 1], math.sqrt(best)


@dataclass(slots=True, eq=False)
class Follower:
    """Follows one path; set `path_m` to give it another."""

    dynamics: DynamicsConfig
    look_ahead_m: float = 0.5
    path_m: Array = field(default_factory=lambda: np.empty((0, 2)))
    _index: int = 0

    def start(self, path_m: Array) -> None:
        """Follow path_m (k, 2), in the frame of the poses given to `command`."""
        self.path_m = np.ascontiguousarray(path_m, dtype=float)
        self._index = 0

    def stop(self) -> None:
        """Drop the path."""
        self.path_m = np.empty((0, 2))

    @property
    def has_path(self) -> bool:
        """Whether there is a path to follow."""
        return len(self.path_m) > 0

    def ahead(self, pose: Array, length_m: float) -> Array:
        """(k, 2) points along the next stretch of the path, from the robot on, a decimetre apart."""
        corners = np.vstack([pose[:2], self.path_m[self._index + 1 :]])
        return points_along(corners, np.arange(0.0, min(length_m, travelled_m(corners)[-1]) + 1e-9, 0.1))

    def command(self, pose: Array, ranges_m: Array | None, patience: bool = False) -> tuple[float, float]:
        """Speed [m/s] and turn rate [rad/s] for the next step; (0, 0) without a path."""
        if not self.has_path:
            return 0.0, 0.0
        self._index, x, y, _ = _point_ahead(self.path_m, self._index, pose[0], pose[1], self.look_ahead_m)
        c, s = math.cos(pose[2]), math.sin(pose[2])
        dx, dy = x - pose[0], y - pose[1]
        return drive_to(c * dx + s * dy, -s * dx + c * dy, ranges_m, self.dynamics, patience)


_NO_RANGES = np.empty(0)


def drive_to(
    x_m: float, y_m: float, ranges_m: Array | None, dynamics: DynamicsConfig, patience: bool = False
) -> tuple[float, float]:
    """Speed and turn rate toward a point in the robot frame, slowing for and steering around what ranges_m shows."""
    ranges = _NO_RANGES if ranges_m is None else np.asarray(ranges_m, dtype=np.float64)
    points = np.empty((len(ranges), 2))
    count = _near_points(ranges, SIGHT_M, points)
    return _drive(
        points, count, x_m, y_m, dynamics.speed_max_m_s, dynamics.turn_rate_max_rad_s, dynamics.time_step_s,
        dynamics.robot_radius_m, MARGIN_M, CAUTION_M, HORIZON_STEPS, patience,
    )  # fmt: skip


def room_around_m(ranges_m: Array) -> Array:
    """(beams,) how far the way is open toward each beam of a scan: the least of the ranges around it, 3 m at most."""
    half = max(1, round(0.04 * len(ranges_m)))
    ring = np.minimum(np.concatenate([ranges_m[-half:], ranges_m, ranges_m[:half]]), 3.0)
    return np.lib.stride_tricks.sliding_window_view(ring, 2 * half + 1).min(axis=1)


def as_action(speed_m_s: float, turn_rate_rad_s: float, dynamics: DynamicsConfig) -> Array:
    """(2,) float32 in [-1, 1]: shares of the maxima."""
    shares = (speed_m_s / dynamics.speed_max_m_s, turn_rate_rad_s / dynamics.turn_rate_max_rad_s)
    return np.array([min(max(v, -1.0), 1.0) for v in shares], np.float32)
