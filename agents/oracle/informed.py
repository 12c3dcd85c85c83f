"""The informed team: an oracle that knows the true plan and all true poses, under the same engine and sensors.

It shows what a plan is worth, not what a team can know: only where the robots drive is decided with the truth, while
the map is made by the engine from what they sense, like that of every other team. It plans tours of all robots that
show the floor early (`twc_env.planning.LatencyTours`), with a model of when maps merge: robots that share none meet, or
drive along each other's trails, where that brings more floor into the largest map. The tours are planned anew every few
seconds, and whenever maps merged, from what is missing in the maps.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.config import EnvConfig, robot_configs, shared_config
from twc_env.datasets.buildings.map_export import grid_of
from twc_env.planning import Disc, FloorViews, LatencyTours, Plan, TeamState, Terrain, place_graph
from twc_env.records.geometry import compose, inverse, transform_points
from twc_env.records.messages import Belief

from ..shared.explorer import Explorer
from ..slam_aware.relay import in_range

LOOK_STEPS = 5
"""Period of noting where the robots are and what they see."""
PLAN_S = 5.0
"""Period of planning."""
TRIES_FIRST, TRIES = 6000, 400
"""Changes of the tours that are judged for the first plan, and for each later one."""
SPACING_M, SPACING_SHARE = 1.2, 0.17
"""Spacing of the places, at least, and as a share of the scanner's range."""
THERE_M = 0.75
"""Within this distance of a stop, a robot goes on to the next."""
TRAIL_M = 2.5
"""Robots that pass a place within this distance of each other's path can match what they see there."""
COMMON_MIN, COMMON_MIN_RADIO = 4, 12
"""About so many common places merge two maps, with and without scan matching."""
PACE = 0.8
"""Mean speed, as a share of the greatest."""
LOOKS_MAX = 30
"""Floor that was in view so often and is still not in the map never will be."""


class Informed(Explorer):
    """An oracle: `give_truth` must be called after `reset`."""

    def __init__(self, config: EnvConfig):
        self._config, self._range_m = config, shared_config(config).lidar.range_max_m
        self._is_peer = config.link.topology == "peer"
        super().__init__(config)

    def give_truth(self, plan, state: Callable[[], Array]) -> None:
        """The true floor plan, and a function that returns the true poses first (`ExplorationEnv.state`)."""
        self._poses = lambda: state().reshape(-1, 6)[:, :3].astype(float)
        self._grid = grid_of(plan, 0.1)
        self._floor = Terrain(self._grid, max(own.robot_radius_m for own in self._own))
        graph = place_graph(self._floor, self._poses()[0, :2], max(SPACING_M, SPACING_SHARE * self._range_m))
        self._views = FloorViews.of(self._floor, graph, self._range_m, TRAIL_M)
        self._state = TeamState.begin(len(self.robots), self._views)
        self._looks = np.zeros(len(self._views.bits), np.int64)
        speeds = [PACE * own.dynamics.speed_max_m_s for own in robot_configs(self._config)]
        common_min = COMMON_MIN if self._config.slam.cues.lidar else COMMON_MIN_RADIO
        self._tours = LatencyTours(self._views, np.array(speeds), common_min, self._links() if self._is_peer else None)
        self._planned_step, self._merged = -1, self._state.is_merged

    def act(self, beliefs: dict[str, Belief]) -> dict[str, Array]:
        """One command per robot, planned with the truth in place of the beliefs."""
        poses, step = self._poses(), next(iter(beliefs.values())).step
        if step % LOOK_STEPS == 0:
            for belief in beliefs.values():
                place = int(np.argmin(np.hypot(*(self._views.graph.places_m - poses[belief.robot, :2]).T)))
                self._state.pass_place(belief.robot, place, self._views)
                self._looks += self._views.is_seen(place)
            self._note_merges(beliefs)
            if self._is_due(step):
                self._plan_tours(beliefs, poses, step)
        true = {}
        for agent, belief in beliefs.items():
            teammates = {other: poses[other] for other in range(len(poses)) if other != belief.robot}
            pose = poses[belief.robot]
            true[agent] = Belief(belief.robot, belief.step, pose, self._grid, teammates, ranges_m=belief.ranges_m)
        return super().act(true)

    def finished(self, beliefs: dict[str, Belief]) -> bool:
        """Whether there is nothing left to see, and all robots share one map."""
        return super().finished(beliefs) and all(len(b.teammates) + 1 == len(self.robots) for b in beliefs.values())

    def best_plan(
        self, agent: str, beliefs: dict[str, Belief], terrain: Terrain, discs: list[Disc]
    ) -> tuple[Plan | None, str]:
        """The plan to the next stop of the robot's tour."""
        robot, number = self.robots[agent], beliefs[agent].robot
        banned = self.banned(robot, beliefs[agent], {})
        while (stop := int(self._tours.tours[number, 0])) >= 0:
            place = self._views.graph.places_m[stop]
            is_there = np.hypot(*(place - robot.pose[:2])) < THERE_M
            if not is_there and all(np.hypot(*(place - it)) > self.explorer.failed_radius_m for it in banned):
                plan = self._plan_to(terrain, robot.pose[:2], place, discs)
                if plan is not None:
                    return plan, "place"
            self._tours.advance(number)
        return None, "wait"

    def _plan_to(self, terrain: Terrain, here: Array, place_m: Array, discs: list[Disc]) -> Plan | None:
        labels = terrain.no_labels()
        part = terrain.patch(place_m, THERE_M / 2)
        labels[part][terrain.cost[part] > 0] = 1
        return self.finder.cheapest(terrain, here, labels, np.zeros(2), discs)

    def _is_due(self, step: int) -> bool:
        """Whether the tours are to be planned anew."""
        late = (step - self._planned_step) * self.dynamics.time_step_s >= PLAN_S
        return self._planned_step < 0 or late or bool((self._state.is_merged != self._merged).any())

    def _plan_tours(self, beliefs: dict[str, Belief], poses: Array, step: int) -> None:
        """Plan the tours of all robots from what their maps hold."""
        for belief in beliefs.values():
            pose_map_building = compose(belief.pose_map_robot, inverse(poses[belief.robot]))
            is_known = belief.grid.level_at(transform_points(pose_map_building, self._views.cells_m)) < 0
            self._state.seen[belief.robot] = self._views.as_words(is_known | (self._looks > LOOKS_MAX))
        tries = TRIES if self._planned_step >= 0 else TRIES_FIRST
        left_s = self._config.max_cycles * self.dynamics.time_step_s - step * self.dynamics.time_step_s
        self._tours.plan(self._state, left_s, tries, self.random)
        self._planned_step, self._merged = step, self._state.is_merged.copy()
        for robot in self.robots.values():
            robot.replan = True

    def _note_merges(self, beliefs: dict[str, Belief]) -> None:
        """Which robots share a map, by their beliefs."""
        is_merged = np.eye(len(beliefs), dtype=bool)
        for belief in beliefs.values():
            for other in belief.teammates:
                is_merged[belief.robot, other] = is_merged[other, belief.robot] = True
        self._state.is_merged = is_merged

    def _links(self) -> Array:
        """(places, places) bool: whether robots there hear each other."""
        places_m, link = self._views.graph.places_m, self._config.link
        links = np.eye(len(places_m), dtype=bool)
        for place, here in enumerate(places_m):
            near = np.flatnonzero(np.hypot(*(places_m - here).T) <= link.range_max_m)
            links[place, near] = in_range(self._floor, places_m[near], here, link)
        return links | links.T
