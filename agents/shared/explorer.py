"""Navigation that all exploring teams share: following paths, arrival, goals that failed, robots that are stuck.

All planning is on estimates and may be wrong, so every robot monitors its progress and gives up unreachable goals.
Where to go is decided by each team in its own file.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.config import DynamicsConfig, EnvConfig, robot_configs
from twc_env.planning import (
    Disc,
    Follower,
    PathFinder,
    Plan,
    Terrain,
    as_action,
    can_reverse,
    drive_to,
    is_frontier,
)
from twc_env.records.geometry import compose, inverse
from twc_env.records.messages import Belief, GridMap

from .beginning import Beginning
from .explorer_state import UNSEEN, ExplorerConfig, ExplorerRobot, Failure
from .openings import is_open_behind, open_bearing

LOOK_AROUND = 0.6
"""Share of its turn rate with which a robot turns on the spot."""


class Explorer(ABC):
    """Navigation of a team; `best_plan` of a subclass decides where each robot goes."""

    drives_backwards = False
    """Whether robots that can drive backwards where their path leads back, instead of turning around."""

    def __init__(self, config: EnvConfig, explorer: ExplorerConfig | None = None):
        self.dynamics: DynamicsConfig = config.dynamics
        """Of the team; that of each robot is with its follower."""
        self._own = [own.dynamics for own in robot_configs(config)]
        self.reverses = [self.drives_backwards and can_reverse(own) for own in robot_configs(config)]
        """Whether each robot does."""
        self.explorer = explorer or ExplorerConfig()
        self._has_doors = config.clutter.door_share > 0.0
        self._finished_s = self.explorer.finished_doors_s if self._has_doors else self.explorer.finished_s
        self.finder = PathFinder()
        self.reset(0, ())

    def reset(self, seed: int, agents: Sequence[str]) -> None:
        """Discard all state; the seed is used only by robots that are stuck or on a tour."""
        self.random = np.random.default_rng(seed)
        followers = [Follower(own, reverses=each) for own, each in zip(self._own, self.reverses, strict=True)]
        self.robots = {agent: ExplorerRobot(follower) for agent, follower in zip(agents, followers, strict=False)}
        self.beginning = Beginning(self.robots)
        self._terrains: dict[tuple[float, GridMap], tuple[int, Terrain]] = {}
        self._idle_since: int | None = None

    def act(self, beliefs: dict[str, Belief]) -> dict[str, Array]:
        """One command per robot; replans where necessary. Raises TwcError as `Beginning.check`."""
        self.beginning.check(beliefs)
        for agent, belief in beliefs.items():
            self._observe(self.robots[agent], belief)
        for agent in self._in_planning_order(beliefs):
            self._plan(agent, beliefs)
        actions = {agent: self._command(self.robots[agent], belief) for agent, belief in beliefs.items()}
        for agent, belief in beliefs.items():
            self.robots[agent].step_before = belief.step
        self._note_idle(beliefs)
        return actions

    def finished(self, beliefs: dict[str, Belief]) -> bool:
        """Whether all robots share one map and none has had a reachable frontier for a while."""
        if self._idle_since is None or not beliefs:
            return False
        step = next(iter(beliefs.values())).step
        return (step - self._idle_since) * self.dynamics.time_step_s >= self._finished_s

    # Observation

    def _observe(self, robot: ExplorerRobot, belief: Belief) -> None:
        """Update the state from a belief: map jumps, track, being stuck, arrival."""
        pose = np.asarray(belief.pose_map_robot, float)
        map_id = (belief.map_version, len(belief.teammates))
        if robot.map_id != UNSEEN and map_id != robot.map_id:
            robot.move_frame(compose(pose, inverse(robot.pose)))
        robot.pose, robot.map_id = pose, map_id
        x, y = float(pose[0]), float(pose[1])
        if not robot.track_m or math.hypot(robot.track_m[-1][0] - x, robot.track_m[-1][1] - y) > 0.5:
            robot.track_m.append(pose[:2].copy())
            robot.track_step.append(belief.step)
        anchor = robot.anchor
        if (
            robot.goal_kind in ("", "wait")
            or anchor is None
            or math.hypot(anchor[0] - x, anchor[1] - y) > self.explorer.stuck_m
        ):
            anchor = robot.anchor = (x, y, belief.step)
        if robot.goal_kind in ("", "wait") or belief.step <= robot.escape_until or self._has_arrived(robot, belief):
            return
        patience = max(1.0, 1.0 / robot.follower.dynamics.speed_max_m_s)  # of one slower than 1 m/s
        if (belief.step - anchor[2]) * self.dynamics.time_step_s >= patience * self.explorer.stuck_s:
            self._get_unstuck(robot, belief)

    def _has_arrived(self, robot: ExplorerRobot, belief: Belief) -> bool:
        """Handle arrival; a frontier that still exists although the robot is there counts as failed."""
        is_near = robot.goal_kind in ("frontier", "elsewhere")
        limit = self.explorer.arrival_m if is_near else self.explorer.tour_arrival_m
        if math.hypot(robot.goal_m[0] - robot.pose[0], robot.goal_m[1] - robot.pose[1]) > limit:
            robot.arrived_step = -1
            return False
        if robot.goal_kind != "frontier":
            robot.stuck_count = 0
            robot.drop_goal()
            return True
        if robot.arrived_step < 0:
            robot.arrived_step, robot.replan = belief.step, True
        elif (belief.step - robot.arrived_step) * self.dynamics.time_step_s > self.explorer.arrival_patience_s:
            self._fail_goal(robot, belief.step)
        return True

    def _fail_goal(self, robot: ExplorerRobot, step: int) -> None:
        """Exclude this goal for a while, longer with each failure."""
        radius = self.explorer.failed_radius_m
        known = [f for f in robot.failures if math.hypot(*(f.place_m - robot.goal_m)) < radius]
        failure = known[0] if known else Failure(robot.goal_m.copy(), 0, 0)
        failure.count += 1
        wait_s = self.explorer.retry_s * 2 ** min(failure.count - 1, 6)
        failure.until_step = step + round(wait_s / self.dynamics.time_step_s)
        if not known:
            robot.failures.append(failure)
        robot.drop_goal()

    def _get_unstuck(self, robot: ExplorerRobot, belief: Belief) -> None:
        """Turn to an open direction and drive there briefly; the second time in a row also give up the goal."""
        robot.stuck_count += 1
        step = belief.step
        again = robot.jam_m is not None and math.hypot(*(robot.jam_m - robot.pose[:2])) < self.explorer.jam_radius_m
        robot.jam_count = robot.jam_count + 1 if again else 1
        robot.jam_m = robot.pose[:2].copy()
        # Two robots that meet in a door both back off, for random times that grow until they no longer meet.
        robot.escape_until = step + int(self.random.integers(14, 24)) * min(
            robot.jam_count, self.explorer.jam_count_max
        )
        robot.escape_bearing = open_bearing(belief.ranges_m, self.random)
        if robot.follower.has_path:
            offset = robot.goal_m - robot.pose[:2]
            ahead = offset / max(math.hypot(*offset), 1e-6) * 0.5
            robot.obstacles.append((robot.pose[:2] + ahead, step + round(15.0 / self.dynamics.time_step_s)))
        robot.anchor = None
        if robot.stuck_count >= 2:
            robot.stuck_count = 0
            self._fail_goal(robot, step)
        robot.replan = True

    # Plans

    def _in_planning_order(self, beliefs: dict[str, Belief]) -> list[str]:
        """Robots that need a new plan now, those with a goal first."""
        due = [agent for agent, belief in beliefs.items() if self._needs_plan(self.robots[agent], belief)]
        return sorted(due, key=lambda agent: not self.robots[agent].goal_kind)

    def _needs_plan(self, robot: ExplorerRobot, belief: Belief) -> bool:
        """Whether to replan: periodically, or if the plan was dropped, its frontier mapped or its path blocked."""
        step, explorer, tick = belief.step, self.explorer, self.dynamics.time_step_s
        if step <= robot.escape_until:
            return False
        if robot.comes_to_multiple(step, explorer.replan_s / tick):
            return True
        if not robot.comes_to_multiple(step, explorer.check_s / tick):
            return robot.replan and robot.comes_to_multiple(step, 2)
        if robot.goal_kind == "wait":
            return True
        if (
            self._has_doors
            and robot.goal_kind in ("", "tour")
            and robot.comes_to_multiple(step, explorer.door_s / tick)
        ):
            return True  # a door may have opened
        if not robot.goal_kind or not robot.follower.has_path:
            return robot.replan
        if robot.goal_kind == "frontier" and not is_frontier(belief.grid, robot.goal_m, explorer.arrival_m):
            return True
        return robot.follower.is_blocked(robot.pose, belief.grid, robot.radius_m)

    def _terrain(
        self, agent: str, beliefs: dict[str, Belief], squeeze: float = 1.0, trusts_scan: bool = False
    ) -> Terrain:
        """The terrain of the robot's map for `squeeze` times its radius; shared by robots with the same map, unless it
        `trusts_scan` (`Terrain.of`)."""
        belief = beliefs[agent]
        radius_m = squeeze * self.robots[agent].radius_m
        if trusts_scan:
            return Terrain.of(belief, radius_m, trusts_scan)
        key = radius_m, belief.grid
        if key in self._terrains and self._terrains[key][0] == belief.step:
            return self._terrains[key][1]
        terrain = Terrain.of(belief, radius_m)
        self._terrains = {k: v for k, v in self._terrains.items() if v[0] == belief.step}
        self._terrains[key] = (belief.step, terrain)
        return terrain

    def _plan(self, agent: str, beliefs: dict[str, Belief]) -> None:
        """Choose goal and path of one robot: a frontier, else a tour, else any with a smaller robot radius.

        Where there are doors, a robot without a frontier also looks where its scan sees through walls of the map: one
        that was shut for long is a wall there until long after it has opened.
        """
        robot = self.robots[agent]
        robot.replan = False
        plan, kind = self._planned(agent, beliefs, self._terrain(agent, beliefs))
        if self._has_doors and kind in ("tour", ""):
            beyond, beyond_kind = self._planned(agent, beliefs, self._terrain(agent, beliefs, trusts_scan=True))
            if plan is None or beyond_kind not in ("tour", ""):
                plan, kind = beyond, beyond_kind
        step = beliefs[agent].step
        will_retry = any(f.until_step > step and f.count < self.explorer.tries for f in robot.failures)
        robot.is_idle = kind in ("tour", "") and not will_retry
        if kind == "wait":
            robot.drop_goal()
            robot.goal_kind, robot.goal_m, robot.replan = kind, robot.pose[:2].copy(), False
            return
        if plan is None:  # enclosed according to the map: noise may have narrowed a gap
            plan, kind = self._planned(
                agent, beliefs, self._terrain(agent, beliefs, self.explorer.squeeze, self._has_doors)
            )
        if plan is None and self._has_doors:
            plan, kind = self._to_elsewhere(robot, step, self._terrain(agent, beliefs)), "elsewhere"
        if plan is None:  # no goal: drop failures, look around, and try again
            robot.goal_kind = ""
            robot.failures.clear()
            robot.obstacles.clear()
            robot.follower.stop()
            return
        goal = plan.path_m[-1]
        if not robot.goal_kind or math.hypot(*(goal - robot.pose[:2])) > self.explorer.arrival_m:
            robot.arrived_step = -1
        robot.goal_m, robot.goal_kind, robot.goal_step = goal, kind, step
        robot.follower.start(plan.path_m)

    def _planned(self, agent: str, beliefs: dict[str, Belief], terrain: Terrain) -> tuple[Plan | None, str]:
        return self.best_plan(agent, beliefs, terrain, self._discs(self.robots[agent], beliefs[agent], terrain))

    def _to_elsewhere(self, robot: ExplorerRobot, step: int, terrain: Terrain) -> Plan | None:
        """A shut in robot that waited in vain goes to any other place that it can reach: a leaf that opens may have
        met it, or stand open between it and the doorway."""
        labels = terrain.no_labels()
        if robot.goal_kind == "elsewhere":
            part = terrain.patch(robot.goal_m, 0.5 * self.explorer.arrival_m)
            labels[part][terrain.cost[part] > 0] = 1
        elif (step - robot.goal_step) * self.dynamics.time_step_s >= self.explorer.retry_s:
            self.finder.spread(terrain, robot.pose[:2])
            cells = np.argwhere(terrain.cost > 0)
            is_away = np.hypot(*(terrain.to_metres(cells + 0.5) - robot.pose[:2]).T) > self.explorer.tour_arrival_m
            cells = cells[is_away & np.isfinite(self.finder.ways_to(terrain, cells))]
            if len(cells):
                labels[tuple(cells[self.random.integers(len(cells))])] = 1
        return self.finder.cheapest(terrain, robot.pose[:2], labels, np.zeros(2)) if labels.any() else None

    @abstractmethod
    def best_plan(
        self, agent: str, beliefs: dict[str, Belief], terrain: Terrain, discs: list[Disc]
    ) -> tuple[Plan | None, str]:
        """Where one robot goes next: the path, and its kind (`ExplorerRobot.goal_kind`)."""

    def _discs(self, robot: ExplorerRobot, belief: Belief, terrain: Terrain) -> list[Disc]:
        """Obstacles to avoid: teammates, positions where it got stuck, and scan points that the map does not
        explain."""
        discs = [
            Disc(float(pose[0]), float(pose[1]), 0.6, 12)
            for pose in belief.teammates.values()
            if math.hypot(*(pose[:2] - robot.pose[:2])) < 6.0
        ]
        robot.obstacles = [(place, until) for place, until in robot.obstacles if until > belief.step]
        discs += [Disc(float(place[0]), float(place[1]), 0.5, 40) for place, _ in robot.obstacles]
        return discs + self._unexplained(robot.pose, belief.ranges_m, terrain)

    def _unexplained(self, pose: Array, ranges_m: Array | None, terrain: Terrain) -> list[Disc]:
        """Discs around near scan points on open floor."""
        if ranges_m is None or len(ranges_m) == 0:
            return []
        near = np.flatnonzero((ranges_m > 0.0) & (ranges_m < 2.5))
        angles = pose[2] + near * (2 * np.pi / len(ranges_m))
        points = pose[:2] + ranges_m[near, None] * np.column_stack([np.cos(angles), np.sin(angles)])
        odd = points[terrain.is_open(points)]
        spots: list[Array] = []
        for point in odd:
            if all(math.hypot(*(point - spot)) > 0.2 for spot in spots):
                spots.append(point)
        return [Disc(float(p[0]), float(p[1]), 0.35, 30) for p in spots[:12]]

    def banned(self, robot: ExplorerRobot, belief: Belief, beliefs: dict[str, Belief]) -> list[Array]:
        """Positions of goals that failed recently: the robot's own, and those of teammates after repeated failure."""
        places = [f.place_m for f in robot.failures if f.until_step > belief.step]
        for other, teammate_belief in beliefs.items():
            if teammate_belief.robot in belief.teammates:
                failures = self.robots[other].failures
                places += [f.place_m for f in failures if f.count >= 2 and f.until_step > belief.step]
        return places

    # Commands

    def _command(self, robot: ExplorerRobot, belief: Belief) -> Array:
        """Action: speed and turn rate as shares of the maxima."""
        own = robot.follower.dynamics
        if belief.step <= robot.escape_until:
            bearing = robot.escape_bearing
            if abs(bearing) > 2.0 and is_open_behind(belief.ranges_m, robot.radius_m):
                speed, turn_rate = -0.4 * own.speed_max_m_s, 0.0  # faster than turning around
            else:
                x, y = 0.6 * math.cos(bearing), 0.6 * math.sin(bearing)
                speed, turn_rate = drive_to(x, y, belief.ranges_m, own)
            robot.escape_bearing = math.remainder(bearing - turn_rate * self.dynamics.time_step_s, 2 * math.pi)
        elif robot.goal_kind == "wait" or self._is_shut_in(robot, belief):
            speed, turn_rate = 0.0, 0.0
        elif robot.arrived_step >= 0 or not robot.goal_kind:
            speed, turn_rate = 0.0, LOOK_AROUND * own.turn_rate_max_rad_s  # look around: turning creates keyframes
        else:
            speed, turn_rate = robot.follower.command(robot.pose, belief.ranges_m, self._has_to_wait(robot, belief))
        return as_action(speed, turn_rate, own)

    def _is_shut_in(self, robot: ExplorerRobot, belief: Belief) -> bool:
        """Whether a robot without a goal waits for a door to open, after half a turn every `retry_s`."""
        if not self._has_doors or robot.goal_kind:
            return False
        tick_s, rate_rad_s = self.dynamics.time_step_s, LOOK_AROUND * robot.follower.dynamics.turn_rate_max_rad_s
        return (belief.step * tick_s) % self.explorer.retry_s > math.pi / rate_rad_s

    def _has_to_wait(self, robot: ExplorerRobot, belief: Belief) -> bool:
        """Whether a teammate with right of way (a lower number) is close ahead."""
        gear = robot.follower.gear
        for teammate, pose in belief.teammates.items():
            if teammate >= belief.robot:
                continue
            dx, dy = pose[0] - robot.pose[0], pose[1] - robot.pose[1]
            dx, dy = gear * dx, gear * dy
            if dx * dx + dy * dy < 1.0 and abs(math.remainder(math.atan2(dy, dx) - robot.pose[2], 2 * math.pi)) < 0.8:
                return True
        return False

    def _note_idle(self, beliefs: dict[str, Belief]) -> None:
        """Update the step since which the whole merged team has had no frontier."""
        merged = all(len(b.teammates) + 1 == len(self.robots) for b in beliefs.values())
        if not (merged and all(self.robots[agent].is_idle for agent in beliefs)):
            self._idle_since = None
        elif self._idle_since is None:
            self._idle_since = next(iter(beliefs.values())).step
