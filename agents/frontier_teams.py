"""Frontier teams with other ways of task allocation from the literature, based on the nearest-frontier team.

They differ only for robots that share a map: a robot alone goes to the nearest frontier.
"""

from __future__ import annotations

from abc import ABC, abstractmethod

import numpy as np
from numpy.typing import NDArray as Array
from scipy.optimize import linear_sum_assignment

from twc_env.config import EnvConfig
from twc_env.planning import PathFinder, Terrain
from twc_env.records.messages import Belief

from .nearest_frontier import NearestFrontier

WORTH_M = 10.0
"""Detour that a frontier is worth if no other robot will see it (1 / beta of Burgard et al.)."""
UNREACHABLE_M = 1e4


class CostUtility(NearestFrontier):
    """Utility minus cost (Burgard, Moors, Stachniss, Schneider 2005): a frontier visible from the goal of a teammate is
    worth less, the nearer that goal is."""

    def __init__(self, config: EnvConfig):
        super().__init__(config)
        self._sight_m = config.lidar.range_max_m

    def extra_penalty_m(self, agent: str, beliefs: dict[str, Belief], terrain: Terrain) -> Array:
        """(frontiers,) the lost utility of each."""
        centres = terrain.frontier_centres_m
        worth = np.ones(len(centres))
        for goal_m in self.goals_of_teammates_m(agent, beliefs):
            worth -= np.clip(1.0 - np.hypot(*(centres - goal_m).T) / self._sight_m, 0.0, 1.0)
        return WORTH_M * (1.0 - np.maximum(worth, 0.0))


class _SharedOut(NearestFrontier, ABC):
    """Each frontier is assigned to one robot of the group; those of others get the penalty of claimed frontiers."""

    def __init__(self, config: EnvConfig):
        super().__init__(config)
        self._ways = PathFinder()

    def extra_penalty_m(self, agent: str, beliefs: dict[str, Belief], terrain: Terrain) -> Array:
        """(frontiers,) penalty of those assigned to others."""
        belief, count = beliefs[agent], len(terrain.frontier_sizes)
        if not belief.teammates:
            return np.zeros(count)
        poses = [belief.pose_map_robot, *belief.teammates.values()]
        lengths_m = np.array([self._lengths_m(terrain, pose) for pose in poses])
        is_mine = np.ones(count, bool)
        is_mine[1:] = self.shared_out(lengths_m[:, 1:])
        return np.where(is_mine, 0.0, self.explorer.claim_penalty_m)

    @abstractmethod
    def shared_out(self, lengths_m: Array) -> Array:
        """(frontiers,) bool: which are assigned to the first robot, from path lengths (robots, frontiers)."""

    def _lengths_m(self, terrain: Terrain, pose: Array) -> Array:
        count = len(terrain.frontier_sizes)
        if not self._ways.spread(terrain, np.asarray(pose, float)[:2]):
            return np.full(count, UNREACHABLE_M)
        lengths_m, _ = self._ways.nearest_of_labels(terrain, terrain.labels, count - 1)
        return np.minimum(lengths_m, UNREACHABLE_M)


class Assignment(_SharedOut):
    """One frontier per robot, with minimum total path length (the Hungarian method, Kuhn 1955)."""

    def shared_out(self, lengths_m: Array) -> Array:
        """The frontier of the first robot; all frontiers if it got none, with fewer frontiers than robots."""
        robots, frontiers = linear_sum_assignment(lengths_m)
        mine = frontiers[robots == 0]
        return np.isin(np.arange(lengths_m.shape[1]), mine) if len(mine) else np.ones(lengths_m.shape[1], bool)


class Voronoi(_SharedOut):
    """Each robot takes the frontiers to which it is closest."""

    def shared_out(self, lengths_m: Array) -> Array:
        """The frontiers to which no teammate has a shorter path."""
        return lengths_m[0] <= lengths_m.min(axis=0)
