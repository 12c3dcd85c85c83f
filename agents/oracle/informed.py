"""The informed team: an oracle that knows the true plan and all true poses, under the same engine and sensors.

Only where the robots drive is decided with the truth: the map is made by the engine from what they sense, like that of
every other team. It plans tours of all robots that show the floor early (`twc_env.planning.LatencyTours`), with a model
of when maps merge: robots that share none read the same signs or, where there are none, see each other, where that
brings more floor into the largest map. Once a central mapper has most of the floor in one map, and where most doors
open and close, its robots do as `information-gain` does. `partly_informed` says what each piece of this is worth.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.config import robot_configs, shared_config
from twc_env.datasets.buildings.map_export import grid_of
from twc_env.planning import Disc, FloorViews, LatencyTours, Plan, TeamState, Terrain
from twc_env.records.geometry import compose, inverse, transform_points
from twc_env.records.messages import Belief

from ..slam_aware.relay import links_between
from ..teams.information_gain import CHOOSE_S, InformationGain

LOOK_STEPS = 5
"""Period of noting where the robots are and what they see."""
PLAN_S = 2.0
"""Period of planning tours."""
TRIES_FIRST, TRIES = 6000, 400
"""Changes of the tours that are judged for the first plan, and for each later one."""
SPACING_M, SPACING_SHARE = 1.2, 0.17
"""Spacing of the places, at least, and as a share of the scanner's range."""
THERE_M = 0.75
"""Within this distance of a stop, a robot goes on to the next."""
PACE = 0.9
"""Mean speed where robots do not turn, as a share of the greatest."""
DOORS_MAX = 0.5
"""Where a larger share of the doors open and close, too many tours end at shut ones: robots choose views at once."""
KNOWN_SHARE = 0.75
"""Tours are planned until all share a map that has so much of the floor."""
LOOKS_MAX = 10
"""Floor that was in view so often and is still not in the map never will be."""


class Informed(InformationGain):
    """An oracle: `give_truth` must be called after `reset`."""

    def give_truth(self, plan, state: Callable[[], Array]) -> None:
        """The true floor plan, and a function that returns the true poses first (`ExplorationEnv.state`)."""
        self._poses = lambda: state().reshape(-1, 6)[:, :3].astype(float)
        self._route: LatencyTours | None = None
        if self.config.clutter.door_share > DOORS_MAX:
            return
        self._grid = grid_of(plan, 0.1)
        own = [each.dynamics for each in robot_configs(self.config)]
        range_m = shared_config(self.config).lidar.range_max_m
        floor = Terrain(self._grid, max(each.robot_radius_m for each in own))
        spacing_m = max(SPACING_M, SPACING_SHARE * range_m)
        signs = np.array([[*sign.position_m, sign.facing_rad] for sign in plan.signs]).reshape(-1, 3)
        camera, apart_m = self.config.signs, self.config.slam.merging.spread_min_m
        self._views = FloorViews.of(floor, self._poses()[0, :2], spacing_m, range_m, signs, camera, apart_m)
        self.state = TeamState.begin(len(self.robots), self._views)
        self._looks = np.zeros(len(self._views.bits), np.int64)
        link, places_m = self.config.link, self._views.graph.places_m
        links = links_between(floor, places_m, link) if link.topology == "peer" else None
        fast, rates = np.array([[PACE * each.speed_max_m_s, each.turn_rate_max_rad_s] for each in own]).T.copy()
        self._route = LatencyTours(self._views, fast, rates, np.array(self.reverses), links=links)
        self._planned_step, self._merged = -1, self.state.is_merged
        self.explorer = replace(self.explorer, replan_s=PLAN_S)

    def act(self, beliefs: dict[str, Belief]) -> dict[str, Array]:
        """One command per robot, planned with the truth in place of the beliefs."""
        self.beginning.check(beliefs)
        poses, step = self._poses(), next(iter(beliefs.values())).step
        if self._route is not None and step % LOOK_STEPS == 0:
            self._note(beliefs, poses)
            is_late = self._planned_step < 0 or (step - self._planned_step) * self.dynamics.time_step_s >= PLAN_S
            if is_late or (self.state.is_merged != self._merged).any():
                self._plan_tours(self._route, beliefs, poses, step)
        if self._route is None:
            return super().act(beliefs)
        self._drop_stops(self._route, poses)
        true = {}
        for agent, belief in beliefs.items():
            here, teammates = poses[belief.robot], {other: poses[other] for other in self.known_to(belief)}
            true[agent] = Belief(belief.robot, step, here, self._grid, teammates, ranges_m=belief.ranges_m)
        return super().act(true)

    def best_plan(
        self, agent: str, beliefs: dict[str, Belief], terrain: Terrain, discs: list[Disc]
    ) -> tuple[Plan | None, str]:
        """The plan to the next stop of the robot's tour, or to the best view."""
        if self._route is None:
            return super().best_plan(agent, beliefs, terrain, discs)
        number, banned = beliefs[agent].robot, self.banned(self.robots[agent], beliefs[agent], {})
        while (stop := int(self._route.tours[number, 0])) >= 0:
            place = self._views.graph.places_m[stop]
            if all(np.hypot(*(place - it)) > self.explorer.failed_radius_m for it in banned):
                plan = self.plan_to_place(terrain, agent, place, discs, THERE_M / 2)
                if plan is not None:
                    return plan, "place"
            self._route.advance(number)
        return None, "wait"

    def known_to(self, belief: Belief) -> list[int]:
        """The robots of which a robot knows where they are: all others."""
        return [other for other in range(len(self.robots)) if other != belief.robot]

    def improve(self, route: LatencyTours, left_s: float, tries: int) -> None:
        """Change the tours for the better, by judging so many changes."""
        route.plan(self.state, left_s, tries, self.random)

    def _note(self, beliefs: dict[str, Belief], poses: Array) -> None:
        """Where the robots are, what they see there, and which share a map."""
        self.state.is_merged = np.eye(len(beliefs), dtype=bool)
        for belief in beliefs.values():
            self.state.stand(belief.robot, poses[belief.robot], self._views)
            self._looks += self._views.is_seen(self.state.places[belief.robot])
            for other in belief.teammates:
                self.state.is_merged[belief.robot, other] = self.state.is_merged[other, belief.robot] = True

    def _drop_stops(self, route: LatencyTours, poses: Array) -> None:
        """Go on from the stops that robots have reached."""
        away_m = np.hypot(*(self._views.graph.places_m[route.tours[:, 0]] - poses[:, :2]).T)
        for number, robot in enumerate(self.robots.values()):
            if route.tours[number, 0] >= 0 and away_m[number] < THERE_M:
                route.advance(number)
                robot.replan = True

    def _plan_tours(self, route: LatencyTours, beliefs: dict[str, Belief], poses: Array, step: int) -> None:
        """Plan the tours of all robots from what their maps hold, or leave the rest to views."""
        known = []
        for belief in beliefs.values():
            to_map = compose(belief.pose_map_robot, inverse(poses[belief.robot]))
            if len(self._views.signs):
                read_m = np.array([sign.position_m for sign in belief.signs]).reshape(-1, 2)
                self.state.read[belief.robot] = self._views.read(transform_points(inverse(to_map), read_m))
            is_known = belief.grid.level_at(transform_points(to_map, self._views.cells_m)) < 0
            self.state.seen[belief.robot] = self._views.as_words(is_known | (self._looks > LOOKS_MAX))
            known.append(is_known.mean())
        if self.state.is_merged.all() and min(known) >= KNOWN_SHARE and route.links is None:
            self._route, self.explorer = None, replace(self.explorer, replan_s=CHOOSE_S)
            return self.reset(int(self.random.integers(2**31)), list(beliefs))
        left_s = (self.config.max_cycles - step) * self.dynamics.time_step_s
        self.improve(route, left_s, TRIES_FIRST if self._planned_step < 0 else TRIES)
        self._planned_step, self._merged = step, self.state.is_merged.copy()
        for robot in self.robots.values():
            robot.replan = True
