"""Information gain: the view that is expected to tell most, for its way.

Bourgault, Makarenko, Williams, Grocholsky and Durrant-Whyte ("Information based adaptive robotic exploration", IROS
2002) choose the action with the greatest expected reduction of the map's entropy: each unknown cell in view is worth
one bit. The way is weighed against it as by Gonzalez-Banos and Latombe ("Navigation strategies for exploring indoor
environments", IJRR 2002): gain times exp(-lambda length). Candidates are the frontiers and places on a lattice of
open floor; unlike with frontiers, a view over a large room counts more than a gap beside a cupboard. What the goals
of teammates will show is not counted again. Robots choose anew twice a second: what a goal is worth changes with
every scan.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.config import EnvConfig, robot_configs
from twc_env.planning import Disc, Plan, Terrain, find_views
from twc_env.records.messages import Belief

from ..shared.frontier_team import FrontierTeam

CHOOSE_S = 0.5
"""Period of choosing; docs/learning.md has what a shorter one is worth to a rule that ranks the same views."""
OFFERED = 8
"""Views that are tried in turn if the best cannot be reached."""


class InformationGain(FrontierTeam):
    """A robot drives to the best view and decides anew while it drives."""

    told_kinds = ("place",)
    drives_backwards = True

    def __init__(self, config: EnvConfig):
        super().__init__(config)
        self.explorer = replace(self.explorer, replan_s=CHOOSE_S)
        self._ranges_m = [own.lidar.range_max_m for own in robot_configs(config)]

    def reset(self, seed: int, agents: Sequence[str]) -> None:
        """Discard all state."""
        super().reset(seed, agents)
        self._taken: dict[str, tuple[tuple[int, int], list[Array]]] = {}

    def best_plan(
        self, agent: str, beliefs: dict[str, Belief], terrain: Terrain, discs: list[Disc]
    ) -> tuple[Plan | None, str]:
        """The plan to the best view, else of a patrol."""
        self._listen(agent, beliefs)  # to those that have just chosen: robots that swap goals at once swap them back
        robot, belief = self.robots[agent], beliefs[agent]
        spent_m = np.array([*self.banned(robot, belief, {}), *self._views_taken_m(agent, belief)]).reshape(-1, 2)
        claimed_m = np.array([*self.heard_goals_m(agent, beliefs).values()]).reshape(-1, 2)
        range_m = self._ranges_m[belief.robot]
        found = find_views(belief, terrain, self.finder, OFFERED, range_m, claimed_m, spent_m, discs)
        for place_m in found.frontiers_m:
            plan = self.plan_to_place(terrain, agent, place_m, discs, 0.2)
            if plan is not None:
                return plan, "place"
        return self.patrol(agent, beliefs, terrain, discs)

    def _views_taken_m(self, agent: str, belief: Belief) -> list[Array]:
        """Where the robot has gone for a view, in its present map: what it did not show there, it will not show."""
        robot, map_id = self.robots[agent], (belief.map_version, len(belief.teammates))
        if self._taken.get(agent, (map_id, []))[0] != map_id or agent not in self._taken:
            self._taken[agent] = map_id, []
        taken = self._taken[agent][1]
        is_near = math.dist(robot.goal_m, robot.pose[:2]) <= self.explorer.failed_radius_m
        if is_near and not (taken and np.array_equal(taken[-1], robot.goal_m)):
            taken.append(robot.goal_m.copy())
        return taken
