"""Actions that last many time steps: waypoints and frontiers, planned and followed on each robot's estimated map."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray as Array

from twc_env.config import ActionConfig, EnvConfig, robot_configs
from twc_env.errors import ActionError
from twc_env.exploration.actions import action_array, check_agents, shown
from twc_env.exploration.observation.observation_blocks import EXTRA_CHOICES
from twc_env.planning.candidates import NOTHING, Candidates, can_tell_places, find_candidates, find_views
from twc_env.planning.drivers import ARRIVAL_M, NARROW_FACTOR, Drivers, map_id
from twc_env.planning.follow import can_reverse
from twc_env.planning.moving_obstacles import has_glass
from twc_env.planning.other_maps import OtherMaps
from twc_env.planning.path_finder import PathFinder
from twc_env.planning.terrain import Terrain
from twc_env.records.geometry import transform_points
from twc_env.records.messages import Belief, GridMap

SIGN, TEAMMATE, STAY = (EXTRA_CHOICES.index(name) for name in ("sign", "teammate", "stay"))


def waypoint_space() -> spaces.Box:
    """(2,) goal ahead and to the left in the robot frame, in units of `action.waypoint_reach_m`."""
    return spaces.Box(-1.0, 1.0, (2,), np.float32)


def frontier_space(config: ActionConfig) -> spaces.Discrete:
    """Index of a choice: frontiers in the order of the `frontiers` block, then sign, teammate, stay."""
    return spaces.Discrete(config.frontier_slots + len(EXTRA_CHOICES))


class CandidateSearch:
    """Keeps the goal candidates of each robot: updated every `observation.frontier_period_s` and when its map jumps."""

    def __init__(self, config: EnvConfig, finder: PathFinder | None = None):
        self._config = config
        own = robot_configs(config)
        self._radii_m, self._has_doors = [each.dynamics.robot_radius_m for each in own], config.clutter.door_share > 0.0
        self._ranges_m = [each.lidar.range_max_m for each in own]
        self._period = max(1, round(config.observation.frontier_period_s / config.dynamics.time_step_s))
        self._finder = finder or PathFinder()
        self._others = OtherMaps(config.dynamics.time_step_s) if config.observation.other_maps else None
        self._looked = [(-self._period, (-1, -1))] * config.robots
        """Step, and the robot's map then (`map_id`)."""
        self.candidates: list[Candidates] = [NOTHING] * config.robots
        self._spent_m: list[list[Array]] = [[] for _ in range(config.robots)]
        """Where each robot went for a view, in its present map."""
        self._spent_map = [(-1, -1)] * config.robots

    def spend(self, robot: int, place_m: Array, belief: Belief) -> None:
        """Do not offer this view again while the robot has this map."""
        if self._spent_map[robot] != map_id(belief):
            self._spent_map[robot] = map_id(belief)
            self._spent_m[robot] = []
        self._spent_m[robot].append(place_m)

    def look(
        self,
        beliefs: Sequence[Belief],
        is_due: Sequence[bool] | Array = (),
        terrains: dict[tuple[float, GridMap, int], Terrain] | None = None,
        goals_m: Array | None = None,
        whole: Callable[[int], Belief] | None = None,
    ) -> None:
        """Update the candidates of robots for which `is_due` (robots,), and those that are old or of another map.

        terrains: as in `terrain`; goals_m: (robots, 2) places to which robots drive, each in its own map; NaN: none;
        whole: a robot's belief with what it knows of other maps, if `beliefs` lack that.
        """
        step, known = beliefs[0].step, {} if terrains is None else terrains
        for robot, belief in enumerate(beliefs):
            looked_step, looked_map = self._looked[robot]
            is_old = step - looked_step >= self._period or map_id(belief) != looked_map
            if is_old or (len(is_due) and is_due[robot]):
                self._looked[robot] = step, map_id(belief)
                terrain = self.terrain(known, belief)
                slots, range_m = self._config.action.frontier_slots, self._ranges_m[robot]
                if self._config.action.goals == "frontiers":
                    range_m = range_m if self._config.observation.gains else 0.0
                    found = find_candidates(belief, terrain, self._finder, slots, range_m)
                else:
                    spent_m = self._spent_m[robot] if self._spent_map[robot] == map_id(belief) else []
                    of_team = _goals_of_others(belief, beliefs, goals_m), np.array(spent_m).reshape(-1, 2)
                    found = find_views(belief, terrain, self._finder, slots, range_m, *of_team)
                    if not len(found.frontiers_m):  # shut in, by a map in which noise may have narrowed a gap
                        terrain = self.terrain(known, belief, NARROW_FACTOR)
                        found = find_views(belief, terrain, self._finder, slots, range_m, *of_team)
                if self._others is not None:
                    told = belief if whole is None else whole(robot)
                    been_m = told.radio_trails[0].places_m if told.radio_trails else np.zeros((0, 2))
                    away_m = self._others.away_m(told, found.frontiers_m, been_m)
                    found = replace(found, other_maps_m=away_m)
                self.candidates[robot] = found

    def terrain(
        self, known: dict[tuple[float, GridMap, int], Terrain], belief: Belief, squeeze: float = 1.0
    ) -> Terrain:
        """The terrain of the robot's grid, for `squeeze` times its radius; `known` caches those of the present step.

        The key is the grid, not the group: robots of one group may hold different maps (`link.topology = "peer"`).
        Where doors move, a squeezed one is without the walls that this robot sees through: a door that was shut for
        long is a wall in its map until long after it has opened.
        """
        radius_m, trusts_scan = squeeze * self._radii_m[belief.robot], squeeze < 1.0 and self._has_doors
        key = radius_m, belief.grid, belief.robot if trusts_scan else -1
        if key not in known:
            known[key] = Terrain.of(belief, radius_m, trusts_scan)
        return known[key]


def _goals_of_others(belief: Belief, beliefs: Sequence[Belief], goals_m: Array | None) -> Array:
    """(k, 2) goals of the robots that can tell them: in contact now, and with a map that begins in the same frame."""
    if goals_m is None:
        return np.zeros((0, 2))
    told = [
        goals_m[other]
        for other, theirs in enumerate(beliefs)
        if can_tell_places(theirs, belief) and not np.isnan(goals_m[other, 0])
    ]
    return np.array(told).reshape(-1, 2)


class MacroActions:
    """Executes the waypoint or frontier actions of all robots in one episode."""

    def __init__(self, config: EnvConfig, is_alive: Array | None = None):
        """is_alive: (robots,) bool, by default all."""
        self._config, self._action = config, config.action
        self._finder = PathFinder()
        count = config.robots
        own = robot_configs(config)
        self._drivers = Drivers(
            [each.dynamics for each in own], self._finder, config.people.count > 0, config.clutter.furniture > 0,
            [config.action.reverses and can_reverse(each) for each in own], has_glass(config),
        )  # fmt: skip
        self._search = CandidateSearch(config, self._finder)
        self._are_candidates_used = config.action.kind == "frontier" or config.observation.frontiers
        self.is_deciding = np.ones(count, bool) if is_alive is None else is_alive.copy()
        """(robots,) whether the robot's action counts in the next step; if not, it still executes its last one."""
        self._is_in_turn = config.action.timing == "in-turn"
        self._decided = np.where(self.is_deciding, -(2**30), 0)
        """When each robot decided last [ticks]."""
        if self._is_in_turn:
            self._choose_turn(self.is_deciding)
        self._stay_until = np.zeros(count, np.int64)
        self._is_view = np.zeros(count, bool)
        """Whether the last goal of each robot was a view."""
        self._terrains: dict[tuple[float, GridMap, int], Terrain] = {}
        self._terrains_of: Sequence[Belief] = ()
        """The beliefs of which the terrains are."""
        self._ticks = 0
        self._deadline = 0
        self._seconds = 1.0 / config.dynamics.time_step_s
        self._period = max(1, math.ceil(self._action.decision_max_s * self._seconds - 1e-9))

    @property
    def candidates(self) -> list[Candidates]:
        """Goals that each robot can choose; of a busy robot, for its observation only."""
        return self._search.candidates

    def mask(self, robot: int) -> Array:
        """(choices,) int8, 1 for valid choices. The only one of a busy robot is `stay`, which means continue."""
        slots = self._action.frontier_slots
        mask = np.zeros(slots + len(EXTRA_CHOICES), np.int8)
        mask[slots + STAY] = 1
        if self.is_deciding[robot]:
            candidates = self.candidates[robot]
            mask[: len(candidates.frontiers_m)] = 1
            mask[slots + SIGN] = candidates.sign_m is not None
            mask[slots + TEAMMATE] = candidates.teammate_m is not None
        return mask

    def look(self, beliefs: Sequence[Belief], whole: Callable[[int], Belief] | None = None) -> None:
        """Update the candidates of the robots that decide now, unless nothing shows or chooses them; `whole` as in
        `CandidateSearch.look`."""
        self._forget_terrains(beliefs)
        if not self._are_candidates_used:
            return
        is_driving, goals_m = self._drivers.is_driving, self._drivers.goals_m
        for robot in np.flatnonzero(self._is_view & self.is_deciding & ~is_driving).tolist():
            if self._drivers.is_of(robot, beliefs[robot]):
                self._search.spend(robot, goals_m[robot].copy(), beliefs[robot])
        claimed_m = np.full(goals_m.shape, np.nan)
        for robot in np.flatnonzero(self._is_view & is_driving).tolist():
            claimed_m[robot] = self._drivers.goal_in(robot, beliefs[robot])
        self._search.look(beliefs, self.is_deciding, self._terrains, claimed_m, whole)

    def assign(self, actions: Mapping[str, object], agents: Sequence[str], beliefs: Sequence[Belief]) -> None:
        """Set the goals of the robots that decide; actions of the others are only checked.

        Raises ActionError for a malformed action; nothing is changed then. A masked choice counts as `stay`.
        """
        check_agents(actions, agents)
        parsed = [parsed_action(self._action, actions[agent], agent) for agent in agents]
        self._decided[self.is_deciding] = self._ticks
        first = int(self._decided.min()) if self._is_in_turn else self._ticks
        self._deadline = first + self._period
        for robot, (value, belief) in enumerate(zip(parsed, beliefs, strict=True)):
            if self.is_deciding[robot]:
                self._begin(robot, belief, self._goal_of(robot, value, belief))
        self.is_deciding[:] = False

    def commands(self, beliefs: Sequence[Belief]) -> Array:
        """(robots, 2) speed [m/s] and turn rate [rad/s] for the next tick."""
        self._forget_terrains(beliefs)
        self._ticks += 1
        return self._drivers.commands(beliefs, self._terrain)

    def is_decision_due(self, is_alive: Array) -> bool:
        """Whether the step ends now; if so, updates `is_deciding`. Failed robots are not waited for and never decide.

        is_alive: (robots,) bool.
        """
        is_driving = self._drivers.is_driving
        if self._ticks < self._deadline and all(is_driving.tolist()):  # as in most steps
            return False
        is_free = ~is_driving & (self._stay_until <= self._ticks)
        if self._is_in_turn:
            self._decided[~is_alive] = self._ticks
            self._choose_turn(is_alive & (is_free | (self._decided + self._period <= self._ticks)))
            return bool(self.is_deciding.any()) or (not is_alive.any() and self._ticks >= self._deadline)
        late, awaited = self._ticks >= self._deadline, is_free[is_alive]
        has_come = awaited.all() if self._action.timing == "synchronous" else awaited.any()
        due = late or (len(awaited) > 0 and has_come)
        if due:
            self.is_deciding = is_alive.copy() if late else is_free & is_alive
        return bool(due)

    def _choose_turn(self, is_waiting: Array) -> None:
        """Of the robots that wait for their turn, the one decides that has not for longest."""
        waiting = np.flatnonzero(is_waiting)
        self.is_deciding[:] = False
        if len(waiting):
            self.is_deciding[waiting[np.argmin(self._decided[waiting])]] = True

    def _goal_of(self, robot: int, value, belief: Belief) -> tuple[str, Array] | None:
        """Kind and position (2,) in the map frame of the goal of an action; None: stay."""
        if self._action.kind == "waypoint":
            offset = np.asarray(value, float) * self._action.waypoint_reach_m
            wanted = transform_points(belief.pose_map_robot, offset[None])[0]
            return "place", self._reachable(belief, wanted)
        candidates, slots = self.candidates[robot], self._action.frontier_slots
        if value < len(candidates.frontiers_m):
            return "view" if candidates.are_views else "frontier", candidates.frontiers_m[value]
        place = {slots + SIGN: candidates.sign_m, slots + TEAMMATE: candidates.teammate_m}.get(value)
        return None if place is None else ("teammate" if value == slots + TEAMMATE else "place", place)

    def _reachable(self, belief: Belief, wanted: Array) -> Array:
        """(2,) the place nearest to the one wanted (2,) that the robot can reach; a smaller robot, where this one is
        shut in beside a wall and would have arrived before it drove off."""
        here, found = belief.pose_map_robot[:2], wanted
        for squeeze in (1.0, NARROW_FACTOR):
            terrain = self._terrain(belief, squeeze)
            place = self._finder.nearest_to(terrain, wanted) if self._finder.spread(terrain, here) else None
            if place is not None and (squeeze == 1.0 or math.dist(place, here) > ARRIVAL_M):
                found = place
            if place is None or math.dist(found, here) > ARRIVAL_M or math.dist(wanted, here) <= ARRIVAL_M:
                break
        return found

    def _begin(self, robot: int, belief: Belief, goal: tuple[str, Array] | None) -> None:
        self._stay_until[robot], self._is_view[robot] = 0, goal is not None and goal[0] == "view"
        if goal is None:
            self._drivers.stop(robot)
            self._stay_until[robot] = self._ticks + max(1, round(self._action.stay_s * self._seconds))
        else:
            self._drivers.start(robot, goal[1], belief, goal[0])

    def _forget_terrains(self, beliefs: Sequence[Belief]) -> None:
        """Terrains show where the robots stand: those of other beliefs are out of date."""
        if beliefs is not self._terrains_of:
            self._terrains.clear()
            self._terrains_of = beliefs

    def _terrain(self, belief: Belief, squeeze: float) -> Terrain:
        return self._search.terrain(self._terrains, belief, squeeze)


def parsed_action(config: ActionConfig, action: object, agent: str) -> Any:
    """The goal (2,) or the number of the choice that an action says. Raises ActionError for a malformed one."""
    if config.kind == "waypoint":
        return _waypoint(action, agent, 2)
    return _choice(action, agent, config.frontier_slots + len(EXTRA_CHOICES))


def _waypoint(action, agent: str, size: int) -> Array:
    goal = action_array(action)
    # The comparison is False for NaN.
    if goal.shape != (size,) or goal.dtype.kind not in "fiu" or not np.all(np.abs(goal) <= 1.0 + 1e-6):
        raise ActionError(
            f"action of {agent!r} must be 2 finite numbers (goal ahead, to the left) in [-1, 1]; got {shown(action)}"
        )
    return goal.astype(float)


def _choice(action, agent: str, size: int) -> int:
    array = action_array(action)
    if array.size != 1 or array.dtype.kind not in "iu" or not 0 <= int(array.reshape(-1)[0]) < size:
        raise ActionError(f"action of {agent!r} must be a whole number from 0 to {size - 1}; got {shown(action)}")
    return int(array.reshape(-1)[0])
