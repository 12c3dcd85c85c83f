"""Tours of a robot without frontiers: to signs and to positions not visited for longest."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.planning import Disc, PathFinder, Plan, Terrain
from twc_env.records.messages import Belief

from .explorer_state import ExplorerConfig, ExplorerRobot


class Tours:
    """Chooses tour goals, because maps merge where two robots have both been."""

    def __init__(self, finder: PathFinder, explorer: ExplorerConfig, time_step_s: float):
        self._finder, self._explorer, self._time_step_s = finder, explorer, time_step_s

    def plan(
        self, robot: ExplorerRobot, belief: Belief, terrain: Terrain, discs: list[Disc], banned: list[Array],
        random: np.random.Generator,
    ) -> Plan | None:  # fmt: skip
        """The plan to the most valuable goal: signs, and positions not visited for long."""
        explorer = self._explorer
        if robot.goal_kind == "tour":  # keep the goal, update the path
            labels = terrain.no_labels()
            if self._mark(labels, terrain, robot.goal_m, 1):
                plan = self._finder.cheapest(terrain, robot.pose[:2], labels, np.zeros(2), discs)
                if plan is not None:
                    return plan
        places, bonus = self._tour_places(belief, terrain)
        if not len(places):
            return None
        labels = terrain.no_labels()
        age_s = self._absence_s(robot, places, belief.step)
        worth = np.minimum(age_s, 600.0) * explorer.tour_speed_m_s + bonus + random.uniform(0.0, 5.0, len(places))
        penalty = np.concatenate([[np.inf], worth.max() - worth])
        for place in banned:
            penalty[1:][np.hypot(*(places - place).T) < explorer.failed_radius_m] = np.inf
        penalty[1:][np.hypot(*(places - robot.pose[:2]).T) < 1.5] = np.inf
        for k, place in enumerate(places):
            self._mark(labels, terrain, place, k + 1)
        return self._finder.cheapest(terrain, robot.pose[:2], labels, penalty, discs)

    def _tour_places(self, belief: Belief, terrain: Terrain) -> tuple[Array, Array]:
        """Open positions on a lattice and at signs (k, 2), and the bonus of each (k,)."""
        stride = max(1, round(self._explorer.tour_spacing_m / terrain.resolution_m))
        rows, columns = np.nonzero(terrain.cost[stride // 2 :: stride, stride // 2 :: stride])
        cells = np.column_stack([rows, columns]) * stride + stride // 2 + 0.5
        places = terrain.to_metres(cells)
        if not belief.signs or self._explorer.tour_sign_bonus_m == 0.0:
            return places, np.zeros(len(places))
        signs = np.array([sign.position_m for sign in belief.signs], float)
        bonus = np.concatenate([np.zeros(len(places)), np.full(len(signs), self._explorer.tour_sign_bonus_m)])
        return np.vstack([places, signs]), bonus

    def _mark(self, labels: Array, terrain: Terrain, place_m: Array, label: int) -> bool:
        """Label the open cells within half a metre of a position (signs are on walls); False if there are none."""
        part = terrain.patch(place_m, 0.5)
        open_cells = terrain.cost[part] > 0
        labels[part][open_cells] = label
        return bool(open_cells.any())

    def _absence_s(self, robot: ExplorerRobot, places: Array, step: int) -> Array:
        """(k,) seconds since the robot was last within 2 m of each position."""
        last = np.zeros(len(places))
        track, steps = np.array(robot.track_m[-600:]), np.array(robot.track_step[-600:])
        for k, place in enumerate(places):
            near = np.hypot(track[:, 0] - place[0], track[:, 1] - place[1]) < 2.0
            last[k] = steps[near].max() if near.any() else step - 1e5
        return (step - last) * self._time_step_s
