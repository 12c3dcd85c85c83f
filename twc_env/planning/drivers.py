"""Drive the robots of a team to their goals on their estimated maps: following paths, arrival, replanning, failure.

What a robot does in a time step is one kernel over arrays, called once for all robots. Only those that need their map,
a new path or a way out of a corner are attended to one by one.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import cast

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.config import DynamicsConfig
from twc_env.kernels.compiled import kernel
from twc_env.planning.felt_obstacles import FeltObstacles, shown
from twc_env.planning.follow import (
    LOOK_AHEAD_M,
    drive_to,
    is_path_blocked,
    look_ahead_point,
    room_around_m,
    steer_along,
)
from twc_env.planning.moving_obstacles import MovingObstacles
from twc_env.planning.path_finder import Disc, PathFinder
from twc_env.planning.terrain import Terrain, has_frontier_near
from twc_env.records.geometry import compose, inverse, transform_points
from twc_env.records.messages import Belief
from twc_env.records.team_messages import NOBODY, TeamBeliefs

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
WAIT_WEIGHT = 0.1
"""Who waits for people is stuck, too, after a longer time: a chair beside a robot that turns also seems to move."""
BACK_OUT_S = 1.2
"""A stuck robot backs out toward the longest ranges for this long, then the goal has failed."""
TEAMMATE_RADIUS_M, TEAMMATE_COST, TEAMMATE_RANGE_M = 0.6, 12, 6.0
"""Teammates up to `TEAMMATE_RANGE_M` away raise the traversal cost within `TEAMMATE_RADIUS_M`."""
FELT_RADIUS_M, FELT_COST = 0.35, 30
"""What a robot bumped into without seeing it raises the traversal cost within `FELT_RADIUS_M`."""
NARROW_FACTOR = 0.6
"""Factor on the robot's radius if there is no path for the full radius."""

IDLE, DRIVING, ARRIVED, FAILED = range(4)
STATUS = "idle", "driving", "arrived", "failed"
FREE_BELOW = Terrain.FREE_BELOW

_STATUS, _GOAL_X, _GOAL_Y, _IS_FRONTIER, _ARRIVAL_M, _TICKS, _BACK_OUT_TICKS = range(7)
_ANCHOR_X, _ANCHOR_Y, _ANCHOR_TICK, _VERSION, _TEAMMATES, _X, _Y, _HEADING, _CORNERS, _SEGMENT = range(7, 17)
_SPEED_MAX, _TURN_MAX, _TIME_STEP, _RADIUS, _CHECK_TICKS, _REPLAN_TICKS, _STUCK_S, _BACK_OUT, _REVERSES = range(17, 26)
_COLUMNS = 26
"""Columns of `Drivers._state`: goal, place where the robot was last seen to move, map and pose of the last step,
corners of its path and the segment it is on; then constants of the robot."""
_NOTHING, _MAP, _PATH, _WAY_OUT = range(4)
"""What a robot needs in a time step: nothing, a look at its map, a new path, or a way out."""


@kernel
def _follow(own, path, ranges, points, command):
    """Fill command (2,) with speed and turn rate along the path."""
    segment, x, y, _ = look_ahead_point(path[: int(own[_CORNERS])], int(own[_SEGMENT]), own[_X], own[_Y], LOOK_AHEAD_M)
    own[_SEGMENT] = segment
    c, s = math.cos(own[_HEADING]), math.sin(own[_HEADING])
    dx, dy = x - own[_X], y - own[_Y]
    command[0], command[1] = steer_along(
        ranges, points, c * dx + s * dy, -s * dx + c * dy, own[_SPEED_MAX], own[_TURN_MAX], own[_TIME_STEP],
        own[_RADIUS], False, own[_REVERSES] > 0.0,
    )  # fmt: skip


@kernel
def _tick(own, path, pose, ranges, points, is_mapped, is_blocked, command):
    """One time step of a robot that drives; returns what it needs.

    is_mapped, is_blocked: whether its frontier is gone and its path is closed, if this is a step of the check.
    """
    own[_X], own[_Y], own[_HEADING] = pose[0], pose[1], pose[2]
    own[_TICKS] += 1
    if own[_BACK_OUT_TICKS] > 0:
        own[_BACK_OUT_TICKS] -= 1
        if own[_BACK_OUT_TICKS] == 0:
            own[_STATUS] = FAILED
        return _WAY_OUT
    is_check = own[_TICKS] % own[_CHECK_TICKS] == 0
    if own[_IS_FRONTIER] and is_check:
        has_arrived = is_mapped
    else:
        has_arrived = math.hypot(own[_GOAL_X] - own[_X], own[_GOAL_Y] - own[_Y]) <= own[_ARRIVAL_M]
    if has_arrived:
        own[_STATUS] = ARRIVED
        return _NOTHING
    if math.hypot(own[_X] - own[_ANCHOR_X], own[_Y] - own[_ANCHOR_Y]) > STUCK_M:
        own[_ANCHOR_X], own[_ANCHOR_Y], own[_ANCHOR_TICK] = own[_X], own[_Y], own[_TICKS]
    if (own[_TICKS] - own[_ANCHOR_TICK]) * own[_TIME_STEP] >= own[_STUCK_S]:
        own[_BACK_OUT_TICKS] = own[_BACK_OUT]
        return _WAY_OUT
    if own[_CORNERS] == 0 or own[_TICKS] % own[_REPLAN_TICKS] == 0 or (is_check and is_blocked):
        return _PATH
    _follow(own, path, ranges, points, command)
    return _NOTHING


@kernel
def _drive(state, paths, poses, ranges, beams, versions, teammates, points, commands, needs):
    """Fill commands (robots, 2) and needs (robots,). Robots that need their map have not moved on yet."""
    for i in range(state.shape[0]):
        own = state[i]
        commands[i, 0] = commands[i, 1] = 0.0
        needs[i] = _NOTHING
        if own[_STATUS] != DRIVING:
            continue
        count = 0
        for k in range(teammates.shape[1]):
            count += teammates[i, k] >= 0
        has_jumped = own[_VERSION] != versions[i] or own[_TEAMMATES] != count
        if has_jumped or (own[_TICKS] + 1) % own[_CHECK_TICKS] == 0:
            needs[i] = _MAP
        else:
            needs[i] = _tick(own, paths[i], poses[i, 0], ranges[i, : beams[i]], points, False, False, commands[i])


@kernel
def _drive_with_map(own, path, pose, ranges, points, log_odds, origin, resolution, reach, command):
    """`_tick` of one robot that may look at its map. reach: `ARRIVAL_M` in cells."""
    is_mapped = is_blocked = False
    if (own[_TICKS] + 1) % own[_CHECK_TICKS] == 0:
        if own[_IS_FRONTIER]:
            row = math.floor((own[_GOAL_Y] - origin[1]) / resolution)
            column = math.floor((own[_GOAL_X] - origin[0]) / resolution)
            is_mapped = not has_frontier_near(log_odds, row, column, reach, FREE_BELOW)
        if own[_CORNERS] > 0 and not is_mapped and (own[_TICKS] + 1) % own[_REPLAN_TICKS] != 0:
            corners = path[: int(own[_CORNERS])]
            is_blocked = is_path_blocked(corners, int(own[_SEGMENT]), pose, own[_RADIUS], log_odds, origin, resolution)
    return _tick(own, path, pose, ranges, points, is_mapped, is_blocked, command)


class Drivers:
    """Drives each robot to the goal given to `start`; `commands` returns the speeds of the next tick."""

    def __init__(
        self, dynamics: Sequence[DynamicsConfig], finder: PathFinder, waits_for_people: bool = False,
        feels: bool = False, reverses: Sequence[bool] = (), has_glass: bool = False,
    ):  # fmt: skip
        """waits_for_people: slow down while something moves close to a robot; feels: avoid what one bumped into;
        reverses (robots,): whether each drives backwards where its path leads back, by default none; has_glass: of
        `MovingObstacles`."""
        self._dynamics, self._finder = dynamics, finder
        self._obstacles = [MovingObstacles(own, has_glass) for own in dynamics] if waits_for_people else None
        self._felt = [FeltObstacles(own) for own in dynamics] if feels else []
        self._felt_m = [np.zeros((0, 2)) for _ in dynamics]
        """(k, 2) of each robot, in its frame: what it has felt."""
        self._state = np.zeros((len(dynamics), _COLUMNS))
        backwards = reverses or [False] * len(dynamics)
        for row, own, is_reversing in zip(self._state, dynamics, backwards, strict=True):
            tick_s = own.time_step_s
            periods = [max(1, round(period_s / tick_s)) for period_s in (CHECK_S, REPLAN_S)]
            stuck_s = STUCK_S * max(1.0, 1.0 / own.speed_max_m_s)
            row[_SPEED_MAX:] = (
                own.speed_max_m_s, own.turn_rate_max_rad_s, tick_s, own.robot_radius_m, *periods, stuck_s,
                max(1, round(BACK_OUT_S / tick_s)), is_reversing,
            )  # fmt: skip
        self._paths = np.zeros((len(dynamics), 8, 2))
        self._points, self._needs = np.empty((0, 2)), np.zeros(len(dynamics), np.int64)
        self._beams = np.zeros(len(dynamics), np.int64)

    @property
    def is_driving(self) -> Array:
        """(robots,) bool: whether each is on its way; new at each call."""
        return self._state[:, _STATUS] == DRIVING

    @property
    def goals_m(self) -> Array:
        """(robots, 2) the last goal of each, in its map as of its last time step."""
        return self._state[:, _GOAL_X : _GOAL_Y + 1]

    def goal_in(self, robot: int, belief: Belief) -> Array:
        """(2,) the last goal of a robot in its present map, which may have jumped since its last time step."""
        goal_m: Array = self._state[robot, _GOAL_X : _GOAL_Y + 1]
        if self.is_of(robot, belief):
            return goal_m.copy()
        return transform_points(self._jump(robot, belief.pose_map_robot), goal_m[None])[0]

    def is_of(self, robot: int, belief: Belief) -> bool:
        """Whether a robot has the map still in which its goal is."""
        return (self._state[robot, _VERSION], self._state[robot, _TEAMMATES]) == map_id(belief)

    def status(self, robot: int) -> str:
        """ "idle", "driving", "arrived" or "failed"."""
        return STATUS[int(self._state[robot, _STATUS])]

    def start(
        self, robot: int, goal_m: Array, belief: Belief, kind: str = "place", arrival_m: float = ARRIVAL_M
    ) -> None:
        """Send a robot to goal_m (2,) in the map frame.

        kind: "place", "view", "frontier" (has arrived once the frontier is mapped) or "teammate" (arrives at
        `TEAMMATE_ARRIVAL_M`). Another view while it drives does not free a robot that is stuck: it still backs out.
        """
        own, (x, y) = self._state[robot], belief.pose_map_robot[:2]
        if kind == "view" and own[_STATUS] == DRIVING and self.is_of(robot, belief):  # as chosen anew all the time
            own[_ANCHOR_TICK] -= own[_TICKS]
        else:
            own[_ANCHOR_X], own[_ANCHOR_Y], own[_ANCHOR_TICK], own[_BACK_OUT_TICKS] = x, y, 0, 0
        own[_STATUS], own[_GOAL_X : _GOAL_Y + 1], own[_IS_FRONTIER] = DRIVING, goal_m, kind == "frontier"
        own[_ARRIVAL_M] = TEAMMATE_ARRIVAL_M if kind == "teammate" else arrival_m
        own[_TICKS] = own[_CORNERS] = 0
        own[_VERSION], own[_TEAMMATES] = map_id(belief)
        own[_X : _HEADING + 1] = belief.pose_map_robot

    def stop(self, robot: int) -> None:
        """Drop the goal of a robot."""
        self._state[robot, _STATUS], self._state[robot, _CORNERS] = IDLE, 0

    def commands(self, beliefs: Sequence[Belief], terrain_of: Callable[[Belief, float], Terrain]) -> Array:
        """(robots, 2) speed [m/s] and turn rate [rad/s] for the next tick; (0, 0) for robots that do not drive.

        `terrain_of(belief, factor)` returns the `Terrain` of the belief's grid for robots of `factor` times the radius;
        called only for planning.
        """
        if hasattr(beliefs, "is_stacked"):
            team = cast(TeamBeliefs, beliefs)
            ranges_m, poses, teammates = self._stacked(team.ranges_m), team.poses, team.teammates
            versions, grids = np.array(team.map_versions), team.grids
        else:
            ranges_m = self._stacked([belief.ranges_m for belief in beliefs])
            poses = np.array([[belief.pose_map_robot] for belief in beliefs])
            counts = np.array([len(belief.teammates) for belief in beliefs])
            teammates = np.where(np.arange(counts.max()) < counts[:, None], 0, NOBODY)  # only their number counts
            versions, grids = np.array([belief.map_version for belief in beliefs]), [each.grid for each in beliefs]
        if self._felt:
            ranges_m = self._with_felt(beliefs, ranges_m)
        commands = np.empty((len(self._state), 2))
        kept = self._state, self._paths
        _drive(*kept, poses, ranges_m, self._beams, versions, teammates, self._points, commands, self._needs)
        for robot, needed in enumerate(self._needs.tolist()):
            if needed != _NOTHING:
                own, path, circle = self._state[robot], self._paths[robot], ranges_m[robot, : self._beams[robot]]
                if needed == _MAP:
                    grid = grids[robot]
                    origin, cell_m = np.asarray(grid.origin_m, float), float(grid.resolution_m)
                    ids = int(versions[robot]), int((teammates[robot] >= 0).sum())
                    self._follow_map_jump(robot, poses[robot, 0], ids)
                    needed = _drive_with_map(
                        own, path, poses[robot, 0], circle, self._points, grid.log_odds, origin, cell_m,
                        round(ARRIVAL_M / cell_m), commands[robot],
                    )  # fmt: skip
                if needed == _WAY_OUT:
                    commands[robot] = self._way_out(robot, circle)
                elif needed == _PATH and self._plan(robot, beliefs[robot], terrain_of):
                    _follow(own, self._paths[robot], circle, self._points, commands[robot])
                elif needed == _PATH:
                    own[_STATUS] = FAILED
        for robot, (belief, felt) in enumerate(zip(beliefs, self._felt, strict=False)):
            if self._state[robot, _STATUS] == DRIVING and (back_m_s := felt.retreat_m_s(belief)):
                commands[robot] = back_m_s, 0.0
        if self._obstacles is not None:
            self._wait_for_people(beliefs, commands)
        for felt, speed_m_s in zip(self._felt, commands[:, 0].tolist(), strict=False):
            felt.tell(speed_m_s)
        return commands

    def _with_felt(self, beliefs: Sequence[Belief], ranges_m: Array) -> Array:
        """The scans with what each robot bumped into; one that has felt something more plans anew, and has time."""
        before, self._felt_m = self._felt_m, [felt.feel(each) for felt, each in zip(self._felt, beliefs, strict=True)]
        for own, old, new in zip(self._state, before, self._felt_m, strict=True):
            if len(new) > len(old):
                own[_CORNERS], own[_ANCHOR_TICK] = 0, own[_TICKS]
        if not any(map(len, self._felt_m)):
            return ranges_m
        ranges_m = ranges_m.copy()
        for row, beams, points_m in zip(ranges_m, self._beams.tolist(), self._felt_m, strict=True):
            row[:beams] = shown(row[:beams], points_m)
        return ranges_m

    def _stacked(self, ranges_m: Sequence[Array | None] | Array) -> Array:
        """The scans in one array (robots, most beams), of whose rows the first `_beams` count."""
        if isinstance(ranges_m, np.ndarray):
            self._beams[:] = ranges_m.shape[1]
            stacked = ranges_m
        else:
            scans = [np.empty(0) if scan is None else scan for scan in ranges_m]
            self._beams[:] = [len(scan) for scan in scans]
            stacked = np.zeros((len(scans), int(self._beams.max())))
            for row, scan in zip(stacked, scans, strict=True):
                row[: len(scan)] = scan
        if len(self._points) < stacked.shape[1]:
            self._points = np.empty((stacked.shape[1], 2))
        return stacked

    def _follow_map_jump(self, robot: int, pose: Array, ids: tuple[int, int]) -> None:
        """Transform the goal if the map frame jumped, and drop the path."""
        own = self._state[robot]
        if (own[_VERSION], own[_TEAMMATES]) != ids:
            jump = self._jump(robot, pose)
            for first in (_GOAL_X, _ANCHOR_X):
                own[first : first + 2] = transform_points(jump, own[None, first : first + 2])[0]
            own[_CORNERS] = 0
            own[_VERSION], own[_TEAMMATES] = ids

    def _jump(self, robot: int, pose: Array) -> Array:
        """(3,) the pose of the map of a robot's last time step in its present one, where its pose is (3,)."""
        return compose(pose, inverse(self._state[robot, _X : _HEADING + 1]))

    def _plan(self, robot: int, belief: Belief, terrain_of: Callable[[Belief, float], Terrain]) -> bool:
        """Find a path; False if there is none."""
        own = self._state[robot]
        here_m, goal_m = own[_X : _Y + 1], own[_GOAL_X : _GOAL_Y + 1]
        discs = [
            Disc(float(pose[0]), float(pose[1]), TEAMMATE_RADIUS_M, TEAMMATE_COST)
            for pose in belief.teammates.values()
            if math.dist(pose[:2], here_m) < TEAMMATE_RANGE_M and math.dist(pose[:2], goal_m) > TEAMMATE_RADIUS_M
        ]
        for x, y in transform_points(own[_X : _HEADING + 1], self._felt_m[robot]).tolist():
            discs.append(Disc(x, y, FELT_RADIUS_M, FELT_COST))
        for squeeze in (1.0, NARROW_FACTOR):
            terrain = terrain_of(belief, squeeze)
            labels = terrain.no_labels()
            labels[terrain.patch(goal_m, GOAL_SQUARE_SHARE * float(own[_ARRIVAL_M]))] = 1
            plan = self._finder.cheapest(terrain, here_m, labels, np.zeros(2), discs)
            if plan is not None:
                count = len(plan.path_m)
                if count > self._paths.shape[1]:
                    self._paths = np.pad(self._paths, ((0, 0), (0, count), (0, 0)))
                self._paths[robot, :count] = plan.path_m
                own[_CORNERS], own[_SEGMENT] = count, 0
                return True
        return False

    def _way_out(self, robot: int, ranges_m: Array) -> tuple[float, float]:
        """Speed [m/s] and turn rate [rad/s] toward the longest ranges of the scan."""
        dynamics = self._dynamics[robot]
        if len(ranges_m) == 0:
            return 0.0, 0.5 * dynamics.turn_rate_max_rad_s
        bearing = 2 * math.pi * int(np.argmax(room_around_m(ranges_m))) / len(ranges_m)
        reverses = bool(self._state[robot, _REVERSES])
        return drive_to(0.6 * math.cos(bearing), 0.6 * math.sin(bearing), ranges_m, dynamics, reverses=reverses)

    def _wait_for_people(self, beliefs: Sequence[Belief], commands: Array) -> None:
        """Slow down robots near which something moves."""
        for robot, (belief, obstacles) in enumerate(zip(beliefs, self._obstacles or (), strict=True)):
            own, wanted = self._state[robot], float(commands[robot, 0])
            commands[robot, 0] = allowed = obstacles.limited(belief, wanted)
            if abs(allowed) < abs(wanted) and own[_STATUS] == DRIVING:
                own[_ANCHOR_TICK] += 1.0 - WAIT_WEIGHT


def map_id(belief: Belief) -> tuple[int, int]:
    """Differs whenever the map frame has jumped."""
    return belief.map_version, len(belief.teammates)
