"""Multi-robot multi-target potential field (Yu et al. 2021, "SMMR-Explore", ICRA 2021).

All frontiers attract a robot at once: each by its size over the length of the way to it. Robots nearby repel each
other. The robot drives to the neighbouring place of lowest potential; where its own place is the lowest, it drives to
the nearest frontier, which leads out of the local minimum.
"""

from __future__ import annotations

import math

import numpy as np

from twc_env.planning import Disc, Plan, Terrain
from twc_env.records.messages import Belief

from ..shared.frontier_team import FrontierTeam

STEP_M, DIRECTIONS = 2.0, 8
"""Distance and number of the neighbouring places."""
REPULSION_M = 5.0
"""Robots within this distance repel each other ..."""
REPULSION = 1.0
"""... by this many metres of frontier per metre of way, at contact, falling linearly to 0."""


class PotentialField(FrontierTeam):
    """Descends the potential, in steps of `STEP_M`."""

    def best_plan(
        self, agent: str, beliefs: dict[str, Belief], terrain: Terrain, discs: list[Disc]
    ) -> tuple[Plan | None, str]:
        """The plan to the neighbouring place of lowest potential, else to the nearest frontier, else of a patrol."""
        robot, belief = self.robots[agent], beliefs[agent]
        frontiers = self.frontiers(agent, beliefs, terrain, discs)
        if not len(frontiers.labels):
            return self.patrol(agent, beliefs, terrain, discs)
        nearest = int(np.argmin(frontiers.lengths_m))
        if frontiers.lengths_m[nearest] > STEP_M:
            around = robot.pose[2] + 2 * math.pi * np.arange(DIRECTIONS) / DIRECTIONS
            places_m = robot.pose[:2] + STEP_M * np.column_stack([np.cos(around), np.sin(around)])
            places_m = places_m[terrain.is_open(places_m)]
            others_m = np.array([pose[:2] for pose in belief.teammates.values()]).reshape(-1, 2)
            lowest, best = _potential(frontiers.lengths_m, frontiers.sizes_m, robot.pose[:2], others_m), None
            for place in places_m:
                lengths_m = self.ways.lengths_to_frontiers_m(terrain, place)
                if lengths_m is None:
                    continue
                value = _potential(lengths_m[frontiers.labels], frontiers.sizes_m, place, others_m)
                if value < lowest:
                    lowest, best = value, place
            plan = None if best is None else self.plan_to_place(terrain, agent, best, discs, 0.2)
            if plan is not None and plan.length_m < 2 * STEP_M:
                return plan, "place"
        plan = self.plan_to(terrain, agent, frontiers.labels[[nearest]], discs)
        return plan, "frontier" if plan is not None else ""


def _potential(lengths_m, sizes_m, place_m, others_m) -> float:
    """Potential at a place with these ways (k,) to frontiers of sizes (k,), near robots at others_m (j, 2)."""
    attraction = float((sizes_m / np.maximum(lengths_m, 0.5)).sum())
    away_m = np.hypot(*(others_m - place_m).T)
    return REPULSION * float(np.clip(1.0 - away_m / REPULSION_M, 0.0, None).sum()) - attraction
