"""Each robot drives to the nearest frontier of its group's merged map; when none is left, it seeks the other robots.

Robots of one group share a map and spread out over its frontiers: those near the goal of a teammate are claimed. A
group that is not complete yet and has no frontier left tours the signs and the places not visited for longest, because
maps merge where two robots have both been. This is the reference team of the results.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.config import EnvConfig
from twc_env.planning import Disc, Plan, Terrain
from twc_env.records.messages import Belief

from ..shared.explorer import Explorer
from ..shared.explorer_state import ExplorerConfig
from ..shared.tours import Tours


class NearestFrontier(Explorer):
    """Nearest frontiers (Yamauchi 1998) with claims of teammates' goals, and tours of robots without a frontier."""

    def __init__(self, config: EnvConfig, explorer: ExplorerConfig | None = None):
        super().__init__(config, explorer)
        self._tours = Tours(self.finder, self.explorer, config.dynamics.time_step_s)

    def best_plan(
        self, agent: str, beliefs: dict[str, Belief], terrain: Terrain, discs: list[Disc]
    ) -> tuple[Plan | None, str]:
        """The plan to a frontier, else of a tour; and its kind ("" for no plan)."""
        belief, robot = beliefs[agent], self.robots[agent]
        plan = self._plan_to_frontier(agent, beliefs, terrain, discs)
        if plan is not None:
            return plan, "frontier"
        plan = self._tours.plan(robot, belief, terrain, discs, self.banned(robot, belief, {}), self.random)
        return plan, "tour" if plan is not None else ""

    def _plan_to_frontier(
        self, agent: str, beliefs: dict[str, Belief], terrain: Terrain, discs: list[Disc]
    ) -> Plan | None:
        """The nearest frontier that is not claimed by a teammate and has not failed recently."""
        sizes = terrain.frontier_sizes
        if len(sizes) < 2:
            return None
        robot, belief, explorer = self.robots[agent], beliefs[agent], self.explorer
        penalty = np.where(sizes < explorer.frontier_cells_min, explorer.small_penalty_m, 0.0)
        penalty[sizes < explorer.frontier_cells_last] = np.inf
        centres = terrain.frontier_centres_m
        for goal_m in self.goals_of_teammates_m(agent, beliefs):
            claimed = np.hypot(*(centres - goal_m).T) < explorer.claim_radius_m
            claimed[terrain.label_near(goal_m, 0.3)] = True
            penalty[claimed] += explorer.claim_penalty_m
        for place in self.banned(robot, belief, beliefs):
            label = terrain.label_near(place, explorer.failed_radius_m / 2)
            small = np.hypot(*(centres - place).T) < explorer.failed_radius_m
            penalty[small] = np.inf
            if sizes[label] < 25:
                penalty[label] = np.inf
        if robot.goal_kind == "frontier":
            own = terrain.label_near(robot.goal_m, 0.4)
            penalty[np.arange(len(penalty)) != own] += explorer.change_penalty_m if own else 0.0
        if not np.isfinite(penalty[1:]).any():
            return None
        penalty = penalty + self.extra_penalty_m(agent, beliefs, terrain)
        return self.finder.cheapest(terrain, robot.pose[:2], terrain.labels, penalty, discs)

    def extra_penalty_m(self, agent: str, beliefs: dict[str, Belief], terrain: Terrain) -> Array:
        """(frontiers,) additional penalty of each frontier [m]; zeros here."""
        return np.zeros(len(terrain.frontier_sizes))

    def goals_of_teammates_m(self, agent: str, beliefs: dict[str, Belief]) -> list[Array]:
        """Frontier goals (2,) of other robots of the group."""
        teammates = [other for other, b in beliefs.items() if other != agent and b.robot in beliefs[agent].teammates]
        return [self.robots[teammate].goal_m for teammate in teammates if self.robots[teammate].goal_kind == "frontier"]
