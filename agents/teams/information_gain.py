"""Information gain: the view that is expected to tell most, for its way.

Bourgault, Makarenko, Williams, Grocholsky and Durrant-Whyte ("Information based adaptive robotic exploration", IROS
2002) choose the action with the greatest expected reduction of the map's entropy: each unknown cell in view is worth
one bit. The way is weighed against it as by Gonzalez-Banos and Latombe ("Navigation strategies for exploring indoor
environments", IJRR 2002): gain times exp(-lambda length). Candidates are the frontiers and places on a lattice of
open floor; unlike with frontiers, a view over a large room counts more than a gap beside a cupboard. What the goals
of teammates will show is not counted again.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.config import EnvConfig, shared_config
from twc_env.planning import Disc, Plan, Terrain, ViewGain
from twc_env.records.messages import Belief

from ..shared.frontier_team import FrontierTeam

DECAY_PER_M = 0.2
"""lambda of Gonzalez-Banos and Latombe."""
SPACING_M = 1.5
"""Spacing of the lattice of candidates."""
GAIN_MIN_M2 = 0.3
"""Views that show less are not worth a way."""


class InformationGain(FrontierTeam):
    """A robot decides anew when the view that it drives to would show nothing any more."""

    def __init__(self, config: EnvConfig):
        super().__init__(config)
        self._range_m = shared_config(config).lidar.range_max_m

    def reset(self, seed: int, agents: Sequence[str]) -> None:
        """Discard all state."""
        super().reset(seed, agents)
        self._taken: dict[str, tuple[tuple[int, int], list[Array]]] = {}

    def best_plan(
        self, agent: str, beliefs: dict[str, Belief], terrain: Terrain, discs: list[Disc]
    ) -> tuple[Plan | None, str]:
        """The plan to the best view, else to the nearest frontier or of a patrol."""
        robot, belief = self.robots[agent], beliefs[agent]
        frontiers = self.frontiers(agent, beliefs, terrain, discs)
        if not len(frontiers.labels):
            return self.patrol(agent, beliefs, terrain, discs)
        seen_m = self._views_taken_m(agent, belief)
        views = ViewGain(terrain, self._range_m)
        for goal_m in self.heard_goals_m(agent, beliefs).values():
            views.claim(goal_m)
        is_new = all(math.dist(place, robot.goal_m) >= self.explorer.failed_radius_m for place in seen_m)
        is_kept = is_new and robot.goal_kind in ("place", "frontier")
        if is_kept and views.area_m2(robot.goal_m[None])[0] >= GAIN_MIN_M2:
            plan = self.plan_to_place(terrain, agent, robot.goal_m, discs, 0.2)
            if plan is not None:
                return plan, robot.goal_kind
        labels = terrain.no_labels()
        stride = max(1, round(SPACING_M / terrain.resolution_m))
        rows, columns = (
            stride * k + stride // 2 for k in np.nonzero(terrain.cost[stride // 2 :: stride, stride // 2 :: stride])
        )
        labels[rows, columns] = np.arange(len(rows)) + 1
        cells = np.floor(terrain.to_cells(frontiers.places_m)).astype(int)
        labels[cells[:, 0], cells[:, 1]] = len(rows) + 1 + np.arange(len(cells))
        count = len(rows) + len(cells)
        lengths_m, places_m = self.finder.nearest_of_labels(terrain, labels, count)
        candidates = np.flatnonzero(np.isfinite(lengths_m))
        for place in [*self.banned(robot, belief, {}), *seen_m]:
            candidates = candidates[np.hypot(*(places_m[candidates] - place).T) >= self.explorer.failed_radius_m]
        expected_m2 = views.area_m2(places_m[candidates])
        worth = expected_m2 * np.exp(-DECAY_PER_M * lengths_m[candidates])
        worth[expected_m2 < GAIN_MIN_M2] = 0.0
        if len(candidates) == 0 or not worth.any():
            plan = self.plan_to(terrain, agent, frontiers.labels, discs)
            return (plan, "frontier") if plan is not None else self.patrol(agent, beliefs, terrain, discs)
        best = candidates[int(np.argmax(worth))]
        plan = self.finder.cheapest(
            terrain, robot.pose[:2], labels, np.where(np.arange(count + 1) == best, 0.0, math.inf), discs
        )
        return plan, ("place" if best <= len(rows) else "frontier") if plan is not None else ""

    def _views_taken_m(self, agent: str, belief: Belief) -> list[Array]:
        """Where the robot has gone for a view, in its present map: what it did not show there, it will not show."""
        robot, map_id = self.robots[agent], (belief.map_version, len(belief.teammates))
        if self._taken.get(agent, (map_id, []))[0] != map_id or agent not in self._taken:
            self._taken[agent] = map_id, []
        taken = self._taken[agent][1]
        if math.dist(robot.goal_m, robot.pose[:2]) <= self.explorer.failed_radius_m:
            taken.append(robot.goal_m.copy())
        return taken
