"""Oracles that lack a piece of what the informed team knows: how far each falls behind it is what the piece is worth.

They show where the limit of a team without the truth lies. Like the informed team they decide only where robots drive.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray as Array
from scipy.ndimage import binary_dilation

from twc_env.datasets.buildings.map_export import grid_of
from twc_env.planning import LatencyTours, TeamState
from twc_env.records.geometry import compose, inverse, transform_points
from twc_env.records.messages import Belief, GridMap

from ..teams.information_gain import InformationGain
from .informed import LOOK_STEPS, Informed


class WithoutMerging(Informed):
    """Knows the plan and where all robots are, but not what makes maps merge: floor in any map counts as mapped."""

    def improve(self, route: LatencyTours, left_s: float, tries: int) -> None:
        """As the informed team, as if all robots had one map from the start."""
        together = np.bitwise_or.reduce(self.state.seen, axis=0)
        one = replace(
            self.state,
            seen=np.tile(together, (len(self.robots), 1)),
            is_merged=np.ones_like(self.state.is_merged),
        )
        links, route.links = route.links, None
        route.plan(one, left_s, tries, self.random)
        route.links = links


class WithoutTeammates(Informed):
    """Knows the plan and where each robot is, but robots know of others only while they share a map."""

    def known_to(self, belief: Belief) -> list[int]:
        """Those that its own map tells."""
        return list(belief.teammates)

    def improve(self, route: LatencyTours, left_s: float, tries: int) -> None:
        """As the informed team, for the robots of each map by themselves."""
        for group in np.unique(self.state.is_merged, axis=0):
            places, seen, read, poses = (
                each[group] for each in (self.state.places, self.state.seen, self.state.read, self.state.poses)
            )
            is_merged, sightings = (each[np.ix_(group, group)] for each in (self.state.is_merged, self.state.sightings))
            own = TeamState(places, seen, is_merged, read, poses, sightings)
            tours = replace(
                route,
                speeds_m_s=route.speeds_m_s[group],
                turn_rates_rad_s=route.turn_rates_rad_s[group],
                reverses=route.reverses[group],
            )
            tours.tours = route.tours[group]
            tours.plan(own, left_s, tries, self.random)
            alike = (self.state.is_merged == group).all(axis=1)
            route.tours[alike] = tours.tours[alike[group]]


class WithoutPlan(InformationGain):
    """Knows where all robots are and what all of them have mapped, in one frame from the start, but not the plan.

    It does as `information-gain`, on the part of the true plan that is in anybody's map.
    """

    def give_truth(self, plan, state: Callable[[], Array]) -> None:
        """As of the informed team; of the plan it uses what is mapped."""
        self._poses = lambda: state().reshape(-1, 6)[:, :3].astype(float)
        self._plan_grid = grid_of(plan, 0.1)
        self._is_floor = self._plan_grid.log_odds < 0
        self._known = np.zeros_like(self._is_floor)
        self._grid = replace(self._plan_grid, log_odds=np.zeros_like(self._plan_grid.log_odds))

    def act(self, beliefs: dict[str, Belief]) -> dict[str, Array]:
        """One command per robot."""
        self.beginning.check(beliefs)
        poses, step = self._poses(), next(iter(beliefs.values())).step
        if any(robot.comes_to_multiple(step, LOOK_STEPS) for robot in self.robots.values()):
            self._grid = self._mapped(beliefs, poses)
        told = {}
        for agent, belief in beliefs.items():
            others = {other: pose for other, pose in enumerate(poses) if other != belief.robot}
            told[agent] = Belief(belief.robot, step, poses[belief.robot], self._grid, others, ranges_m=belief.ranges_m)
        return super().act(told)

    def _mapped(self, beliefs: dict[str, Belief], poses: Array) -> GridMap:
        """The plan where it is in the map of any robot; walls where floor beside them is."""
        for belief in beliefs.values():
            left = np.argwhere(self._is_floor & ~self._known)
            to_map = compose(belief.pose_map_robot, inverse(poses[belief.robot]))
            levels = belief.grid.level_at(transform_points(to_map, self._plan_grid.centre_of(left)))
            self._known[tuple(left[levels != 0].T)] = True
        is_told = self._known | (binary_dilation(self._known, np.ones((3, 3), bool)) & ~self._is_floor)
        return replace(self._plan_grid, log_odds=self._plan_grid.log_odds * is_told)
