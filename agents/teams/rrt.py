"""Frontiers detected by rapidly-exploring random trees (Umari and Mukhopadhyay, IROS 2017).

Each robot grows a local tree from where it is, which begins anew at every frontier point found, and a global tree
that is kept. Where an extension of a tree leaves the known floor, there is a frontier point. Points are filtered, and
each robot takes the one of the greatest revenue: lambda h I - N, where I is the unknown area around the point, N the
distance to it, and h > 1 for points near the robot. What teammates drive to is discounted.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.planning import Disc, Plan, RandomTree, Terrain, ViewGain, is_frontier
from twc_env.records.geometry import compose, inverse, transform_points
from twc_env.records.messages import Belief

from ..shared.frontier_team import Frontiers, FrontierTeam

SAMPLES = 1000
"""Extensions of each tree at each replanning."""
LOCAL_STEP_M, GLOBAL_STEP_M = 1.0, 4.0
"""Greatest length of an extension (eta of the paper; its package uses 1 and 15 m in open space)."""
GAIN_RADIUS_M = 2.0
"""Unknown floor within this distance of a point, in line of sight, is its information gain."""
GAIN_MIN_M2 = 0.3
"""Points with less are deleted."""
LAMBDA, HYSTERESIS, HYSTERESIS_M = 3.0, 2.0, 3.0
"""Weight of the gain against the distance, and gain within a distance of the robot (values of the authors' package)."""
CLUSTER_M = 1.0
"""Points nearer to each other than this are one."""


class RRT(FrontierTeam):
    """Each robot has its own trees and points, in the frame of its map."""

    def reset(self, seed: int, agents: Sequence[str]) -> None:
        """Discard all state."""
        super().reset(seed, agents)
        self._draws = np.random.default_rng([seed, 1])
        self._trees: dict[str, list[RandomTree]] = {}
        self._points_m: dict[str, Array] = {agent: np.zeros((0, 2)) for agent in agents}
        self._seen: dict[str, tuple[tuple[int, int], Array]] = {}

    def best_plan(
        self, agent: str, beliefs: dict[str, Belief], terrain: Terrain, discs: list[Disc]
    ) -> tuple[Plan | None, str]:
        """The plan to the point of the greatest revenue, else to the nearest frontier, else of a patrol."""
        robot, belief = self.robots[agent], beliefs[agent]
        here = robot.pose[:2]
        frontiers = self.frontiers(agent, beliefs, terrain, discs)
        if not len(frontiers.labels):
            return self.patrol(agent, beliefs, terrain, discs)
        if robot.goal_kind == "frontier" and is_frontier(belief.grid, robot.goal_m, CLUSTER_M / 2):
            plan = self.plan_to_place(terrain, agent, robot.goal_m, discs, CLUSTER_M / 2)
            if plan is not None:  # robots are assigned a point when they are done with the last one
                return plan, "frontier"
        points_m, gains_m2 = self._points(agent, beliefs, frontiers)
        revenue = LAMBDA * gains_m2 * np.where(np.hypot(*(points_m - here).T) < HYSTERESIS_M, HYSTERESIS, 1.0)
        revenue -= np.hypot(*(points_m - here).T)
        banned = self.banned(robot, belief, {})
        for k in np.argsort(-revenue, kind="stable"):
            plan = self.plan_to_place(terrain, agent, points_m[k], discs, CLUSTER_M / 2)
            if plan is not None and all(
                math.dist(place, plan.path_m[-1]) >= self.explorer.failed_radius_m for place in banned
            ):
                return plan, "frontier"
        plan = self.plan_to(terrain, agent, frontiers.labels, discs)  # no tree has reached a frontier
        return plan, "frontier" if plan is not None else ""

    def _points(self, agent: str, beliefs: dict[str, Belief], frontiers: Frontiers) -> tuple[Array, Array]:
        """(k, 2) frontier points of this robot after growing its trees, and their information gains (k,)."""
        terrain = frontiers.terrain
        pose, belief = self.robots[agent].pose, beliefs[agent]
        trees = self._trees.setdefault(agent, [RandomTree(pose[:2]), RandomTree(pose[:2])])
        map_id = belief.map_version, len(belief.teammates)
        before_id, before = self._seen.get(agent, (map_id, pose))
        if before_id != map_id:  # the frame has jumped: trees that no longer lie on free floor would be wrong
            jump = compose(pose, inverse(before))
            self._points_m[agent] = transform_points(jump, self._points_m[agent])
            trees[1] = RandomTree(pose[:2])
        self._seen[agent] = map_id, pose.copy()
        trees[0] = RandomTree(pose[:2])
        found = [
            tree.grow(terrain, self._draws.random((SAMPLES, 2)), step_m)
            for tree, step_m in zip(trees, (LOCAL_STEP_M, GLOBAL_STEP_M), strict=True)
        ]
        points_m = _clustered(np.vstack([self._points_m[agent], *found]))
        is_wide = np.isin(terrain.labels_near(points_m, CLUSTER_M / 2), frontiers.labels)
        points_m = points_m[is_wide]  # elsewhere, a tree has met a gap too narrow for a robot
        views = ViewGain(terrain, GAIN_RADIUS_M, beams=48)
        for goal_m in self.heard_goals_m(agent, beliefs).values():
            views.claim(goal_m)
        gains_m2 = views.area_m2(points_m)
        is_new = gains_m2 >= GAIN_MIN_M2
        self._points_m[agent] = points_m[is_new]
        return points_m[is_new], gains_m2[is_new]


def _clustered(points_m: Array) -> Array:
    """One point of each square of `CLUSTER_M`, the earliest: stands for the mean shift of the paper."""
    _, first = np.unique(np.floor(points_m / CLUSTER_M), axis=0, return_index=True)
    return points_m[np.sort(first)]
