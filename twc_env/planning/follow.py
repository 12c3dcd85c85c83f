"""Path following of a differential-drive robot: a look-ahead point, and obstacle avoidance on the latest scan."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.config import DynamicsConfig, EnvConfig
from twc_env.kernels.compiled import kernel
from twc_env.planning.terrain import Terrain, is_wall_near
from twc_env.records.messages import UNSEEN_M, GridMap

OBSTACLE_RANGE_M = 1.6
"""Scan points further away than this are ignored."""
MARGIN_M = 0.04
"""Required clearance between the robot's rim and the scan points."""
SLACK_M = 0.01
"""A robot within `MARGIN_M` may still lose this much clearance, down to this much."""
GAP_MARGIN_M = 0.015
"""Required clearance on each side in narrow gaps, which are passed slowly."""
SLOWDOWN_M = 0.22
"""Clearance below which the robot slows down."""
HORIZON_STEPS = 6
"""Steps ahead for which a command is checked."""
BRAKING_M_S2 = 1.2
LOOK_AHEAD_M = 0.5
"""Distance along the path to the point that is steered to."""
DETOUR_LENGTH_M = 0.5
DETOUR_STEP_RAD = 0.2
"""If the straight line is blocked, bearings this far apart are tried on both sides."""
CHECK_LENGTH_M, CHECK_STEP_M = 3.0, 0.1
"""Length of the path that is checked for walls, and the spacing of the points on it."""
_WALL_ABOVE = Terrain.WALL_ABOVE


@kernel
def _points_in_range(ranges, range_max, points):
    """Fill points (beams, 2) with the scan points nearer than `range_max`, in the robot frame; returns their count.

    Negative ranges met no wall (`SensorFrame.ranges_m`) and give no point.
    """
    beams = ranges.shape[0]
    step = 2.0 * math.pi / beams
    count = 0
    for i in range(beams):
        if 0.0 < ranges[i] < range_max:
            points[count, 0] = ranges[i] * math.cos(i * step)
            points[count, 1] = ranges[i] * math.sin(i * step)
            count += 1
    return count


@kernel
def _arc_clearance(points, count, speed, turn_rate, time_step, steps):
    """Least distance [m] of any point to the robot's centre along an arc, integrated at the midpoint heading."""
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
    """Least distance [m] of any point to the segment of `length` from the robot toward `bearing`."""
    c, s = math.cos(bearing), math.sin(bearing)
    least = 1e9
    for k in range(count):
        along = min(max(c * points[k, 0] + s * points[k, 1], 0.0), length)
        least = min(least, (points[k, 0] - along * c) ** 2 + (points[k, 1] - along * s) ** 2)
    return math.sqrt(least)


@kernel
def _detour_bearing(points, count, bearing, needed, length):
    """The bearing nearest to the given one whose segment has clearance `needed`; the given one if none has."""
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
def _fastest_command(points, count, bearing, speed_max, turn_max, time_step, radius, needed, slowdown, steps):
    """Fastest (speed, turn rate) toward `bearing` whose arc has the clearance `needed`; speed 0 if none has."""
    bearing -= 2.0 * math.pi * math.floor((bearing + math.pi) / (2.0 * math.pi))
    turn_rate = min(max(2.5 * bearing, -turn_max), turn_max)
    speed = speed_max * math.cos(bearing) ** 3 if abs(bearing) < 1.2 else 0.0
    for scale in (1.0, 0.7, 0.45, 0.25, 0.12):
        clear = _arc_clearance(points, count, scale * speed, turn_rate, time_step, steps)
        if clear >= needed:
            room = max(0.35, min(1.0, (clear - radius) / slowdown))
            return min(scale * speed, speed_max * room), turn_rate
    return 0.0, turn_rate


@kernel
def _steer(
    points, count, target_x, target_y, speed_max, turn_max, time_step, radius, margin, slowdown, steps, patience
):
    """Speed and turn rate toward a target in the robot frame.

    patience: slow down before obstacles, but make no detour around them.
    """
    bearing, distance = math.atan2(target_y, target_x), math.hypot(target_x, target_y)
    nearest = _ray_clearance(points, count, 0.0, 0.0)
    needed = max(min(radius + margin, nearest - SLACK_M), min(nearest - 1e-6, radius + SLACK_M))
    speed_max = min(speed_max, math.sqrt(2.0 * BRAKING_M_S2 * distance))
    length = min(distance, DETOUR_LENGTH_M)
    clear = _ray_clearance(points, count, bearing, length)
    if not patience and clear < needed:
        if clear >= radius + GAP_MARGIN_M:
            needed = radius + GAP_MARGIN_M
            speed_max *= 0.3
        else:
            bearing = _detour_bearing(points, count, bearing, needed, DETOUR_LENGTH_M)
            speed_max *= 0.5
    return _fastest_command(points, count, bearing, speed_max, turn_max, time_step, radius, needed, slowdown, steps)


@kernel
def steer_along(ranges, points, target_x, target_y, speed_max, turn_max, time_step, radius, patience, reverses):
    """Speed and turn rate toward a target in the robot frame, avoiding the obstacles in ranges (beams,); points (beams,
    2) is scratch. reverses: drive backwards to a target behind, which saves the time of turning around."""
    count = _points_in_range(ranges, OBSTACLE_RANGE_M, points)
    gear = -1.0 if reverses and target_x < 0.0 else 1.0
    if gear < 0.0:
        points[:count] = -points[:count]
    speed, turn_rate = _steer(
        points, count, gear * target_x, gear * target_y, speed_max, turn_max, time_step, radius, MARGIN_M, SLOWDOWN_M,
        HORIZON_STEPS, patience,
    )  # fmt: skip
    return gear * speed, turn_rate


@kernel
def look_ahead_point(path, index, x, y, look_ahead):
    """The point `look_ahead` along path (k, 2) after the point nearest to (x, y); searches from segment `index` on.

    Returns (segment of the nearest point, x, y, distance to the path).
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


@kernel
def is_path_blocked(path, segment, pose, radius, log_odds, origin, resolution):
    """Whether a wall is nearer than the robot's radius [m] to a point of the next `CHECK_LENGTH_M` of path (k, 2), of
    which the robot is on this segment."""
    first, last = segment, path.shape[0] - 1
    reach = radius / resolution
    total, x, y = 0.0, pose[0], pose[1]
    for k in range(first + 1, last + 1):
        total += math.sqrt((path[k, 0] - x) * (path[k, 0] - x) + (path[k, 1] - y) * (path[k, 1] - y))
        x, y = path[k, 0], path[k, 1]
    x, y, corner = pose[0], pose[1], first  # the corner that was passed last, at path length `passed`
    passed = ahead = 0.0
    if corner < last:
        ahead = math.sqrt((path[corner + 1, 0] - x) ** 2 + (path[corner + 1, 1] - y) ** 2)
    for k in range(math.ceil((min(CHECK_LENGTH_M, total) + 1e-9) / CHECK_STEP_M)):
        at = k * CHECK_STEP_M
        while corner < last and ahead <= at:
            corner, passed, x, y = corner + 1, ahead, path[corner + 1, 0], path[corner + 1, 1]
            if corner < last:
                ahead += math.sqrt((path[corner + 1, 0] - x) ** 2 + (path[corner + 1, 1] - y) ** 2)
        px, py = x, y
        if corner < last:
            px = (path[corner + 1, 0] - x) / (ahead - passed) * (at - passed) + x
            py = (path[corner + 1, 1] - y) / (ahead - passed) * (at - passed) + y
        if is_wall_near(log_odds, (py - origin[1]) / resolution, (px - origin[0]) / resolution, _WALL_ABOVE, reach):
            return True
    return False


@dataclass(slots=True, eq=False)
class Follower:
    """Follows one path by steering toward the point `look_ahead_m` further along it."""

    dynamics: DynamicsConfig
    look_ahead_m: float = LOOK_AHEAD_M
    reverses: bool = False
    """Whether it drives backwards where the path leads back."""
    gear: float = 1.0
    """1 if it drove forward last, -1 if it drove backwards."""
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
        """Whether a path is set."""
        return len(self.path_m) > 0

    def is_blocked(self, pose: Array, grid: GridMap, radius_m: float) -> bool:
        """Whether a wall of the grid is nearer than this to the next `CHECK_LENGTH_M` of the path from the robot on."""
        origin = np.asarray(grid.origin_m, float)
        return is_path_blocked(self.path_m, self._index, pose, radius_m, grid.log_odds, origin, grid.resolution_m)

    def command(self, pose: Array, ranges_m: Array | None, patience: bool = False) -> tuple[float, float]:
        """Speed [m/s] and turn rate [rad/s] for the next step; (0, 0) without a path."""
        if not self.has_path:
            return 0.0, 0.0
        self._index, x, y, _ = look_ahead_point(self.path_m, self._index, pose[0], pose[1], self.look_ahead_m)
        c, s = math.cos(pose[2]), math.sin(pose[2])
        dx, dy = x - pose[0], y - pose[1]
        ahead, left = c * dx + s * dy, -s * dx + c * dy
        speed, turn_rate = drive_to(ahead, left, ranges_m, self.dynamics, patience, self.reverses)
        self.gear = -1.0 if self.reverses and ahead < 0.0 else 1.0
        return speed, turn_rate


_NO_RANGES = np.empty(0)


def can_reverse(own: EnvConfig) -> bool:
    """Whether a robot with these settings sees as well behind as ahead, and is not carried by somebody who walks."""
    return own.lidar.field_of_view_rad >= 2.0 * math.pi - 1e-6 and own.odometry.platform != "handheld"


def drive_to(
    x_m: float,
    y_m: float,
    ranges_m: Array | None,
    dynamics: DynamicsConfig,
    patience: bool = False,
    reverses: bool = False,
) -> tuple[float, float]:
    """Speed [m/s] and turn rate [rad/s] toward a point in the robot frame, avoiding the obstacles in ranges_m (beams,).

    patience: slow down before obstacles, but make no detour around them; reverses: as in `steer_along`.
    """
    ranges = _NO_RANGES if ranges_m is None else np.asarray(ranges_m, dtype=np.float64)
    return steer_along(
        ranges, np.empty((len(ranges), 2)), x_m, y_m, dynamics.speed_max_m_s, dynamics.turn_rate_max_rad_s,
        dynamics.time_step_s, dynamics.robot_radius_m, patience, reverses,
    )  # fmt: skip


def room_around_m(ranges_m: Array) -> Array:
    """(beams,) free distance in the direction of each beam: the least of its neighbours' ranges, at most 3 m.

    Beams without information (`UNSEEN_M`) do not count; where all neighbours are such beams, the room is 0.
    """
    half = max(1, round(0.04 * len(ranges_m)))
    ranges = np.where(ranges_m == UNSEEN_M, np.inf, np.minimum(np.abs(ranges_m), 3.0))
    ring = np.concatenate([ranges[-half:], ranges, ranges[:half]])
    room = np.lib.stride_tricks.sliding_window_view(ring, 2 * half + 1).min(axis=1)
    return np.where(np.isinf(room), 0.0, room)


def as_action(speed_m_s: float, turn_rate_rad_s: float, dynamics: DynamicsConfig) -> Array:
    """(2,) float32 speed and turn rate as shares of their maxima, clipped to [-1, 1]."""
    shares = (speed_m_s / dynamics.speed_max_m_s, turn_rate_rad_s / dynamics.turn_rate_max_rad_s)
    return np.array([min(max(v, -1.0), 1.0) for v in shares], np.float32)
