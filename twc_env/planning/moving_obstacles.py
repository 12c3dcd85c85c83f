"""How fast a robot may drive where something moves close to it: an obstacle where there was free space in the scan
before. The nearer, the slower, so that it stands before somebody who walks towards it has come: speed and separation
monitoring as in ISO/TS 15066, with people of usual speed. Only what the robot drives towards counts: one that people
have come close to may go where they are not.

Glass returns some beams and lets others pass, so that it seems to appear again and again where it is. What has done so
for seconds in one place is no person (`GLASS_TIMES`)."""

from __future__ import annotations

import math
from collections import deque

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.config import DynamicsConfig, EnvConfig, robot_configs
from twc_env.kernels.compiled import kernel
from twc_env.records.geometry import transform_points
from twc_env.records.messages import Belief

LAG_S = 0.3
"""Age of the earlier scan: who walks at 1.3 m/s has moved 0.4 m since."""
SHIFT_M = 0.12
"""An end point this far inside the free space of the earlier scan has moved."""
REACH_M = 1.1
"""Obstacles further from the robot's rim are ignored."""
PERSON_M_S, REACTION_S = 1.3, 0.2
"""Somebody walks towards the robot this fast, and it begins to brake so late."""
LEG_M = 0.14
"""A body is this much wider than the leg that the scan shows."""
BESIDE_M = 0.25
"""Where somebody moves, narrow things this near to the rim are taken for people who move too slowly to be noticed."""
WIDTH_M = 0.6
"""Wider things are walls, of which a moving robot sees new parts, not people."""
STEP_M = 0.15
"""Greatest difference of neighbouring ranges on one thing."""
BESIDE_COS = 0.2
"""What is further to the side than this is passed."""
HOLD_S = 0.4
"""Something that stops stays a moving obstacle for this long ..."""
BESIDE_HOLD_S = 2.0
"""... and narrow things beside the robot for this long."""
GLASS_TIMES, GLASS_BIN_S, GLASS_MEMORY_S = 7, 0.5, 5.0
"""Glass is what has seemed to move in one place in so many parts of so long of the last seconds, but the latest part.
Somebody who walks by does so in one or two."""
GLASS_M = 0.15
"""Within this distance it is one place."""
GLASS_MAX = 4096
"""Most places that are remembered."""
_AROUND_M = 0.1 * np.array([[x, y] for x in (-1.0, 0.0, 1.0) for y in (-1.0, 0.0, 1.0)])
"""A wall of the map this near to an end point is what it met."""


def has_glass(config: EnvConfig) -> bool:
    """Whether scanners see glass now and then, where there is any."""
    return any(own.lidar.glass_return_probability < 1.0 for own in robot_configs(config))


@kernel
def _limit(
    ranges, is_wall, pose, old_ranges, old_pose, radius, reach, beside, forward, teammates, teammate_radius, braking,
    moved, now, bin_steps,
):  # fmt: skip
    """Greatest speed towards end points within `reach` on something narrow that lies well inside the free space of the
    old scan, infinite if there are none; and whether something narrow, moved or not, is nearer than `beside`, except
    at beams that meet a wall of the map, is_wall (beams,).

    The beams beside its bearing must have been free as well: along a grazing wall, ranges of neighbours differ. Points
    behind a robot that drives forward (1) or back (-1), or within teammate_radius of teammates (k, 2), do not count.
    Of a speed, only its share towards the point is limited.

    moved (k, 3): ring of where something moved (x, y) and when (step), with the number of all so far in its last row;
    empty if there is no glass. now: this step; bin_steps: `GLASS_BIN_S`.
    """
    remembers = moved.shape[0] > 0
    beams = ranges.shape[0]
    per_beam = beams / (2.0 * math.pi)
    c, s = math.cos(pose[2]), math.sin(pose[2])
    old_c, old_s = math.cos(old_pose[2]), math.sin(old_pose[2])
    limit, is_beside = math.inf, False
    for i in range(beams):
        if not 0.0 < ranges[i] < reach:
            continue
        ax, ay = ranges[i] * math.cos(i / per_beam), ranges[i] * math.sin(i / per_beam)
        towards = forward * ax / ranges[i]
        if towards <= BESIDE_COS:
            continue
        speed = _stops_within(ranges[i] - radius - LEG_M, braking) / towards
        is_near = not is_beside and ranges[i] < beside and not is_wall[i]
        if not (speed < limit or is_near or remembers):
            continue
        is_teammate = False
        for k in range(teammates.shape[0]):
            is_teammate |= (ax - teammates[k, 0]) ** 2 + (ay - teammates[k, 1]) ** 2 < teammate_radius**2
        if is_teammate:
            continue
        if is_near:
            is_beside = _width(ranges, i) < WIDTH_M
        if not (speed < limit or remembers):
            continue
        wx, wy = pose[0] + c * ax - s * ay - old_pose[0], pose[1] + s * ax + c * ay - old_pose[1]
        dx, dy = old_c * wx + old_s * wy, old_c * wy - old_s * wx
        away, beam = math.sqrt(dx * dx + dy * dy), int(np.floor(math.atan2(dy, dx) * per_beam))
        is_free = True
        for b in range(beam - 1, beam + 3):
            is_free &= old_ranges[b % beams] > away + SHIFT_M
        if not is_free or _width(ranges, i) >= WIDTH_M:
            continue
        if remembers:
            x, y = pose[0] + c * ax - s * ay, pose[1] + s * ax + c * ay
            is_glass = _has_come_and_gone(moved, x, y, now, bin_steps)
            _remember(moved, x, y, now)
            if is_glass:
                continue
        limit = min(limit, speed)
    return limit, is_beside


@kernel
def _has_come_and_gone(moved, x, y, now, bin_steps):
    """Whether something seemed to move within GLASS_M of (x, y) in GLASS_TIMES parts of the time before this part."""
    times, last = 0, -1
    count = int(moved[-1, 0])
    for k in range(max(0, count - moved.shape[0] + 1), count):
        row = k % (moved.shape[0] - 1)
        part = (now - int(moved[row, 2])) // bin_steps
        if part < 1 or part * GLASS_BIN_S > GLASS_MEMORY_S or part == last:
            continue
        if (moved[row, 0] - x) ** 2 + (moved[row, 1] - y) ** 2 < GLASS_M**2:
            times, last = times + 1, part
    return times >= GLASS_TIMES


@kernel
def _remember(moved, x, y, now):
    """Add that something seemed to move at (x, y)."""
    row = int(moved[-1, 0]) % (moved.shape[0] - 1)
    moved[row, 0], moved[row, 1], moved[row, 2] = x, y, now
    moved[-1, 0] += 1.0


@kernel
def _stops_within(room, braking):
    """Speed v [m/s] from which the robot stands before somebody has come who is `room` [m] away: the root of
    v^2 / 2 b + (PERSON_M_S / b + REACTION_S) v + PERSON_M_S * REACTION_S = room, with deceleration b."""
    left, half = room - PERSON_M_S * REACTION_S, PERSON_M_S + braking * REACTION_S
    return 0.0 if left <= 0.0 else math.sqrt(half * half + 2.0 * braking * left) - half


@kernel
def _width(ranges, i):
    """Width [m] of the thing that beam i hit, up to a little more than `WIDTH_M`."""
    beams = ranges.shape[0]
    step = 2.0 * math.pi / beams
    first = last = i
    while last - first < beams and (last - first) * step * ranges[i] < WIDTH_M:
        if abs(ranges[(first - 1) % beams] - ranges[first % beams]) < STEP_M:
            first -= 1
        elif abs(ranges[(last + 1) % beams] - ranges[last % beams]) < STEP_M:
            last += 1
        else:
            break
    a, b, angle = ranges[first % beams], ranges[last % beams], (last - first) * step
    return math.sqrt(max(a * a + b * b - 2.0 * a * b * math.cos(angle), 0.0))


def _teammates_of(belief: Belief) -> Array:
    """(k, 2) believed positions of the teammates in the robot frame."""
    if not belief.teammates:
        return np.zeros((0, 2))
    offset = np.array([pose[:2] for pose in belief.teammates.values()]) - belief.pose_map_robot[:2]
    c, s = math.cos(belief.pose_map_robot[2]), math.sin(belief.pose_map_robot[2])
    return np.stack([c * offset[:, 0] + s * offset[:, 1], c * offset[:, 1] - s * offset[:, 0]], axis=1)


def _meets_walls(belief: Belief, reach_m: float) -> Array:
    """(beams,) whether each beam up to a range meets a wall of the robot's map: the frame of a door is narrow, too."""
    ranges_m = np.asarray(belief.ranges_m)
    is_wall, near = np.zeros(len(ranges_m), bool), np.flatnonzero((ranges_m > 0.0) & (ranges_m < reach_m))
    if len(near):
        angles = 2.0 * np.pi / len(ranges_m) * near
        ends = ranges_m[near, None] * np.column_stack([np.cos(angles), np.sin(angles)])
        ends = transform_points(np.asarray(belief.pose_map_robot, float), ends)
        is_wall[near] = (belief.grid.level_at(ends[:, None] + _AROUND_M) > 0).any(axis=1)
    return is_wall


class MovingObstacles:
    """Remembers the recent scans of one robot."""

    def __init__(self, dynamics: DynamicsConfig, has_glass: bool = False):
        """has_glass: as the function of this name says."""
        self._dynamics = dynamics
        self._moved, self._step = np.zeros((GLASS_MAX + 1 if has_glass else 0, 3)), 0
        self._bin_steps = max(1, round(GLASS_BIN_S / dynamics.time_step_s))
        self._earlier: deque[tuple[Array, Array]] = deque(maxlen=max(1, round(LAG_S / dynamics.time_step_s)) + 1)
        self._hold_steps, self._beside_steps, self._held_m_s, self._forward = 0, 0, math.inf, 1.0

    def limited(self, belief: Belief, speed_m_s: float) -> float:
        """The speed [m/s] of a robot that wants this one; call once per step."""
        is_wall = None
        if belief.ranges_m is not None and len(belief.ranges_m):
            is_wall = _meets_walls(belief, self._dynamics.robot_radius_m + BESIDE_M)
        limit_m_s = self.limit_m_s(belief.pose_odom, belief.ranges_m, speed_m_s, _teammates_of(belief), is_wall)
        return math.copysign(min(abs(speed_m_s), limit_m_s), speed_m_s)

    def limit_m_s(
        self,
        pose_odom: Array,
        ranges_m: Array | None,
        speed_m_s: float,
        teammates_m: Array,
        is_wall: Array | None = None,
    ) -> float:
        """Greatest speed [m/s] while something moves nearby, not behind a robot of this speed, or did shortly before;
        call once per step.

        pose_odom (3,): in a frame that does not jump; teammates_m (k, 2): positions of teammates in the robot frame,
        which do not count; is_wall (beams,): those that meet a wall of the map, which nobody beside the robot is.
        """
        if ranges_m is None or len(ranges_m) == 0:
            return math.inf
        ranges = np.ascontiguousarray(ranges_m, float)
        self._earlier.append((np.array(pose_odom, float), ranges))
        old_pose, old_ranges = self._earlier[0]
        forward, radius_m = 1.0 if speed_m_s >= 0.0 else -1.0, self._dynamics.robot_radius_m
        found_m_s, is_beside = _limit(
            ranges, np.zeros(len(ranges), bool) if is_wall is None else is_wall, self._earlier[-1][0], old_ranges,
            old_pose, radius_m, radius_m + REACH_M, radius_m + BESIDE_M, forward,
            np.ascontiguousarray(teammates_m, float), 2.0 * radius_m, self._dynamics.acceleration_max_m_s2,
            self._moved, self._step, self._bin_steps,
        )  # fmt: skip
        self._step += 1
        tick_s = self._dynamics.time_step_s
        if found_m_s < math.inf:
            self._hold_steps, self._beside_steps = round(HOLD_S / tick_s), round(BESIDE_HOLD_S / tick_s)
            self._held_m_s = found_m_s
        elif forward != self._forward:
            self._hold_steps = self._beside_steps = 0
        else:
            self._hold_steps, self._beside_steps = max(self._hold_steps - 1, 0), max(self._beside_steps - 1, 0)
        self._forward = forward
        if is_beside and self._beside_steps > 0:
            return 0.0
        return self._held_m_s if self._hold_steps > 0 else math.inf
