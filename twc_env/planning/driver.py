"""Drive one robot to a goal on its estimated map: path planning, path following, replanning, arrival and failure."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.config import DynamicsConfig
from twc_env.planning.follow import Follower, drive_to, room_around_m
from twc_env.planning.moving_obstacles import MovingObstacles
from twc_env.planning.path_finder import Disc, PathFinder
from twc_env.planning.terrain import Terrain, is_frontier, path_is_blocked
from twc_env.records.geometry import compose, inverse, transform_points
from twc_env.records.messages import Belief

CHECK_S = 0.5
"""Period of checking the path, or a frontier goal, against the newest map."""
REPLAN_S = 4.0
"""Period of replanning."""
ARRIVAL_M = 0.35
TEAMMATE_ARRIVAL_M = 1.2
GOAL_SQUARE_SHARE = 0.65
"""Half side of the square in which paths end, as a share of the arrival distance; its corners lie inside the latter."""
STUCK_S, STUCK_M = 3.0, 0.3
"""A robot is stuck if it moved no further than `STUCK_M` in `STUCK_S`; one slower than 1 m/s has longer."""
BACK_OUT_S = 1.2
"""A stuck robot backs out toward the longest ranges for this long, then the goal has failed."""
TEAMMATE_RADIUS_M, TEAMMATE_COST, TEAMMATE_RANGE_M = 0.6, 12, 6.0
"""Teammates up to `TEAMMATE_RANGE_M` away raise the traversal cost within `TEAMMATE_RADIUS_M`."""
CHECK_LENGTH_M = 3.0
"""Length of the path that is checked for walls."""
NARROW_FACTOR = 0.6
"""Factor on the robot's radius if there is no path for the full radius."""


class Driver:
    """Drives one robot to the goal given to `start`; `command` returns the speeds of the next tick."""

    def __init__(self, dynamics: DynamicsConfig, finder: PathFinder, waits_for_people: bool = False):
        """waits_for_people: stop while something moves close to the robot."""
        self._dynamics, self._finder = dynamics, finder
        self._obstacles = MovingObstacles(dynamics) if waits_for_people else None
        self._follower = Follower(dynamics)
        self.status = "idle"
        """"idle", "driving", "arrived" or "failed"."""

    def start(self, goal_m: Array, belief: Belief, kind: str = "place", arrival_m: float = ARRIVAL_M) -> None:
        """Head for goal_m (2,) in the map frame.

        kind: "place", "frontier" (has arrived once the frontier is mapped) or "teammate" (arrives at
        `TEAMMATE_ARRIVAL_M`).
        """
        self._goal_m = np.asarray(goal_m, float).copy()
        self._is_frontier = kind == "frontier"
        self._arrival_m = TEAMMATE_ARRIVAL_M if kind == "teammate" else arrival_m
        self._map_id, self._pose = map_id(belief), belief.pose_map_robot
        self._ticks, self._back_out_ticks = 0, 0
        self._anchor = (float(self._pose[0]), float(self._pose[1]), 0)
        self._follower.stop()
        self.status = "driving"

    def stop(self) -> None:
        """Drop the goal."""
        self._follower.stop()
        self.status = "idle"

    def command(self, belief: Belief, terrain_of) -> tuple[float, float]:
        """Speed [m/s] and turn rate [rad/s] for the next tick; (0, 0) unless driving.

        `terrain_of(belief, factor)` returns the `Terrain` of the belief's grid for robots of `factor` times the radius;
        called only for planning.
        """
        speed, turn_rate = self._command(belief, terrain_of)
        if self._obstacles is not None and self._obstacles.stop(belief, speed):
            if self.status == "driving":
                self._anchor = (*self._anchor[:2], self._ticks)  # who waits is not stuck
            return 0.0, turn_rate
        return speed, turn_rate

    def _command(self, belief: Belief, terrain_of) -> tuple[float, float]:
        if self.status != "driving":
            return 0.0, 0.0
        self._follow_map_jump(belief)
        self._ticks += 1
        tick_s = self._dynamics.time_step_s
        if self._back_out_ticks > 0:
            self._back_out_ticks -= 1
            if self._back_out_ticks == 0:
                self.status = "failed"
            return self._back_out(belief)
        if self._has_arrived(belief):
            self.status = "arrived"
            return 0.0, 0.0
        if self._is_stuck(tick_s):
            self._back_out_ticks = max(1, round(BACK_OUT_S / tick_s))
            return self._back_out(belief)
        if self._needs_plan(belief, tick_s) and not self._plan(belief, terrain_of):
            self.status = "failed"
            return 0.0, 0.0
        return self._follower.command(self._pose, belief.ranges_m)

    def _follow_map_jump(self, belief: Belief) -> None:
        """Transform the goal if the map frame jumped, and drop the path."""
        if map_id(belief) != self._map_id:
            jump = compose(belief.pose_map_robot, inverse(self._pose))
            self._goal_m = transform_points(jump, self._goal_m[None])[0]
            x, y = transform_points(jump, np.array([self._anchor[:2]]))[0]
            self._anchor = (float(x), float(y), self._anchor[2])
            self._follower.stop()
            self._map_id = map_id(belief)
        self._pose = belief.pose_map_robot

    def _has_arrived(self, belief: Belief) -> bool:
        away = math.hypot(self._goal_m[0] - self._pose[0], self._goal_m[1] - self._pose[1])
        if self._is_frontier and self._ticks % max(1, round(CHECK_S / self._dynamics.time_step_s)) == 0:
            return not is_frontier(belief.grid, self._goal_m, ARRIVAL_M)
        return away <= self._arrival_m

    def _is_stuck(self, tick_s: float) -> bool:
        x, y = float(self._pose[0]), float(self._pose[1])
        if math.hypot(x - self._anchor[0], y - self._anchor[1]) > STUCK_M:
            self._anchor = (x, y, self._ticks)
        return (self._ticks - self._anchor[2]) * tick_s >= STUCK_S * max(1.0, 1.0 / self._dynamics.speed_max_m_s)

    def _needs_plan(self, belief: Belief, tick_s: float) -> bool:
        if not self._follower.has_path or self._ticks % max(1, round(REPLAN_S / tick_s)) == 0:
            return True
        if self._ticks % max(1, round(CHECK_S / tick_s)) != 0:
            return False
        ahead = self._follower.ahead(self._pose, CHECK_LENGTH_M)
        return path_is_blocked(belief.grid, ahead, self._dynamics.robot_radius_m)

    def _plan(self, belief: Belief, terrain_of) -> bool:
        discs = [
            Disc(float(pose[0]), float(pose[1]), TEAMMATE_RADIUS_M, TEAMMATE_COST)
            for pose in belief.teammates.values()
            if math.dist(pose[:2], self._pose[:2]) < TEAMMATE_RANGE_M
            and math.dist(pose[:2], self._goal_m) > TEAMMATE_RADIUS_M
        ]
        for squeeze in (1.0, NARROW_FACTOR):
            terrain: Terrain = terrain_of(belief, squeeze)
            labels = np.zeros_like(terrain.labels)
            labels[terrain.patch(self._goal_m, GOAL_SQUARE_SHARE * self._arrival_m)] = 1
            plan = self._finder.cheapest(terrain, self._pose[:2], labels, np.zeros(2), discs)
            if plan is not None:
                self._follower.start(plan.path_m)
                return True
        return False

    def _back_out(self, belief: Belief) -> tuple[float, float]:
        """Speed [m/s] and turn rate [rad/s] toward the longest ranges of the scan."""
        ranges = belief.ranges_m
        if ranges is None or len(ranges) == 0:
            return 0.0, 0.5 * self._dynamics.turn_rate_max_rad_s
        bearing = 2 * math.pi * int(np.argmax(room_around_m(ranges))) / len(ranges)
        return drive_to(0.6 * math.cos(bearing), 0.6 * math.sin(bearing), ranges, self._dynamics)


def map_id(belief: Belief) -> tuple[int, int]:
    """Differs whenever the map frame has jumped."""
    return belief.map_version, len(belief.teammates)
