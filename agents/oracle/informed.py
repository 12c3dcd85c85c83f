"""The informed team: an oracle that knows the true plan and all true poses, under the same engine and sensors.

It shows what a plan is worth, not what a team can know: only where the robots drive is decided with the truth, while
the map is made by the engine from what they sense, like that of every other team. Each robot drives to the place of
the greatest gain for its way: floor that nobody has seen, and what meeting is worth. Robots that share no map meet
where one has read signs and the other has not, which is worth the smaller of the two maps; with one mapper per robot,
a robot out of contact is worth what both hold more than the best map of all, shared between them.
"""

from __future__ import annotations

import copy
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.config import EnvConfig, shared_config
from twc_env.datasets.buildings.map_export import grid_of
from twc_env.planning import FREE, UNKNOWN, WALL, Disc, PathFinder, Plan, Terrain, ViewGain
from twc_env.records.geometry import compose, inverse, transform_points
from twc_env.records.messages import Belief

from ..shared.explorer import Explorer

LOOK_STEPS = 5
"""Period of noting what the robots see."""
GAIN_MIN_M2 = 0.4
"""Less unseen floor than this is not worth a way."""
SPACING_M = 1.0
"""Spacing of the candidate places."""
DECAY_PER_M, HERE_M = 0.2, 1.0
"""A place is worth exp(-decay way) of what is gained there, as in `information-gain`; nearer ones are where it is."""
READ_M = 3.0
"""A robot has read the signs that it came this near to."""
SIGNS_NEEDED, CONTACT_M = 3, 5.0
"""About as many common signs merge two maps; a robot that is this near is in contact."""


class Informed(Explorer):
    """An oracle: `give_truth` must be called after `reset`."""

    def __init__(self, config: EnvConfig):
        self._range_m, self._is_peer = shared_config(config).lidar.range_max_m, config.link.topology == "peer"
        self._ways = PathFinder()
        super().__init__(config)

    def give_truth(self, plan, state: Callable[[], Array]) -> None:
        """The true floor plan, and a function that returns the true poses first (`ExplorationEnv.state`)."""
        self._poses = lambda: state().reshape(-1, 6)[:, :3].astype(float)
        self._grid = grid_of(plan, 0.1)
        self._floor = Terrain(self._grid, max(own.robot_radius_m for own in self._own))
        self._walls = copy.copy(self._floor)  # all floor is unseen; what is no floor cannot be seen through
        self._walls.kind = np.where(self._floor.kind == FREE, UNKNOWN, WALL).astype(np.int8)
        self._seen = {agent: ViewGain(self._walls, self._range_m) for agent in self.robots}
        self._holds = {agent: view.is_claimed.copy() for agent, view in self._seen.items()}
        cells = np.argwhere(self._floor.kind == FREE)
        self._cells, self._cells_m = cells, self._floor.to_metres(cells + 0.5)
        self._signs_m = np.array([sign.position_m for sign in plan.signs]).reshape(-1, 2)
        self._has_read = {agent: np.zeros(len(self._signs_m), bool) for agent in self.robots}
        stride = round(SPACING_M / self._floor.resolution_m)
        cells = np.argwhere(self._floor.cost[::stride, ::stride] > 0) * stride
        self._places = np.zeros_like(self._floor.labels)
        self._places[tuple(cells.T)] = np.arange(len(cells)) + 1
        self._places_m = self._floor.to_metres(cells + 0.5)

    def act(self, beliefs: dict[str, Belief]) -> dict[str, Array]:
        """One command per robot, planned with the truth in place of the beliefs."""
        poses = self._poses()
        self._believed = beliefs
        true = {}
        for agent, belief in beliefs.items():
            pose = poses[belief.robot]
            teammates = {other: poses[other] for other in range(len(poses)) if other != belief.robot}
            true[agent] = Belief(belief.robot, belief.step, pose, self._grid, teammates, ranges_m=belief.ranges_m)
            if belief.step % LOOK_STEPS == 0:
                self._look(agent, pose[:2], belief)
        return super().act(true)

    def finished(self, beliefs: dict[str, Belief]) -> bool:
        """Whether there is nothing left to see, and all robots share one map."""
        return super().finished(beliefs) and all(len(b.teammates) + 1 == len(self.robots) for b in beliefs.values())

    def best_plan(
        self, agent: str, beliefs: dict[str, Belief], terrain: Terrain, discs: list[Disc]
    ) -> tuple[Plan | None, str]:
        """The plan to the place of the greatest worth for its way."""
        here = self.robots[agent].pose[:2]
        self._ways.cheapest(terrain, here, np.zeros_like(terrain.labels), np.zeros(1), discs)
        lengths_m, _ = self._ways.nearest_of_labels(terrain, self._places, len(self._places_m))
        worth = self._worth_m2(agent, beliefs)
        if not worth.any():  # all floor was in view, but some of it is missing in the map
            worth = self._missing_m2(agent)
        worth = np.where(lengths_m[1:] < HERE_M, 0.0, worth * np.exp(-DECAY_PER_M * lengths_m[1:]))
        for place in self.banned(self.robots[agent], beliefs[agent], {}):
            worth[np.hypot(*(self._places_m - place).T) < 2 * self.explorer.failed_radius_m] = 0.0
        best = int(np.argmax(worth))
        if worth[best] <= 0.0:
            return None, "wait"
        penalty = np.full(len(worth) + 1, np.inf)
        penalty[best + 1] = 0.0
        plan = self.finder.cheapest(terrain, here, self._places, penalty, discs)
        return plan, "place" if plan is not None else ""

    def _worth_m2(self, agent: str, beliefs: dict[str, Belief]) -> Array:
        """(places,) what it is worth to be at each place, as area [m2]."""
        views, mine = ViewGain(self._walls, self._range_m), self._believed[agent]
        for seen in self._seen.values():
            views.is_claimed |= seen.is_claimed
        worth = self._gain_m2(agent, views)
        group = [a for a, b in self._believed.items() if b.robot in (mine.robot, *mine.teammates)]
        read = np.any([self._has_read[a] for a in group], axis=0)
        area_m2 = {other: self._floor.resolution_m**2 * held.sum() for other, held in self._holds.items()}
        for other, belief in self._believed.items():
            if other not in group:  # a common sign brings the smaller of two maps nearer to the larger
                for sign in self._signs_m[self._has_read[other] & ~read]:
                    near = np.hypot(*(self._places_m - sign).T) < READ_M / 2
                    worth[near] = np.maximum(worth[near], min(area_m2[agent], area_m2[other]) / SIGNS_NEEDED)
            elif other != agent and self._is_peer and belief.contact_steps.get(mine.robot, -1) < belief.step:
                both_m2 = self._floor.resolution_m**2 * (self._holds[other] | self._holds[agent]).sum()
                near = np.hypot(*(self._places_m - beliefs[other].pose_map_robot[:2]).T) < CONTACT_M
                worth[near] = np.maximum(worth[near], (both_m2 - max(area_m2.values())) / 2)
        return worth

    def _missing_m2(self, agent: str) -> Array:
        """(places,) floor in view from each place that the robot's map lacks [m2]."""
        belief = self._believed[agent]
        pose_map_building = compose(belief.pose_map_robot, inverse(self._poses()[belief.robot]))
        is_known = belief.grid.level_at(transform_points(pose_map_building, self._cells_m)) != 0
        walls = copy.copy(self._walls)
        walls.kind = walls.kind.copy()
        walls.kind[tuple(self._cells[is_known].T)] = FREE
        return self._gain_m2(agent, ViewGain(walls, self._range_m))

    def _gain_m2(self, agent: str, views: ViewGain) -> Array:
        """(places,) unseen floor in view from each place [m2], without what others drive to."""
        for other, robot in self.robots.items():
            if other != agent and robot.goal_kind == "place":
                views.claim(robot.goal_m)
        gain_m2 = views.area_m2(self._places_m)
        return np.where(gain_m2 < GAIN_MIN_M2, 0.0, gain_m2)

    def _look(self, agent: str, here: Array, belief: Belief) -> None:
        """Note what a robot sees, reads and is sent."""
        self._seen[agent].claim(here)
        self._holds[agent] |= self._seen[agent].is_claimed
        for other, theirs in self._believed.items():
            if theirs.robot in belief.teammates and belief.contact_steps.get(theirs.robot, -1) == belief.step:
                self._holds[agent] |= self._holds[other]
        self._has_read[agent] |= np.hypot(*(self._signs_m - here).T) < READ_M
