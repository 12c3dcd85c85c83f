"""Frontier teams that share out the work in other ways, as the literature does; the rest is the nearest-frontier team.

All of them differ only where robots share a map: a robot alone goes to the nearest frontier.
"""

from __future__ import annotations

from abc import ABC, abstractmethod

import numpy as np
from numpy.typing import NDArray as Array
from scipy.optimize import linear_sum_assignment

from agents.nearest_frontier import NearestFrontier
from twc_env.config import EnvConfig
from twc_env.messages import Belief
from twc_env.planning import PathFinder, Terrain

WORTH_M = 10.0
"""Detour that a frontier nobody else will see is worth (1 / beta of Burgard et al.)."""
UNREACHABLE_M = 1e4


class CostUtility(NearestFrontier):
    """Utility less cost (Burgard, Moors, Stachniss, Schneider 2005): a frontier that a mate's goal looks on is worth
    less, in proportion to how near that goal is."""

    def __init__(self, config: EnvConfig):
        super().__init__(config)
        self._sight_m = config.lidar.range_max_m

    def extra_penalty_m(self, agent: str, beliefs: dict[str, Belief], terrain: Terrain) -> Array:
        """(frontiers,) what each has lost of its worth."""
        centres = terrain.frontier_centres_m
        worth = np.ones(len(centres))
        for goal_m in self.goals_of_mates_m(agent, beliefs):
            worth -= np.clip(1.0 - np.hypot(*(centres - goal_m).T) / self._sight_m, 0.0, 1.0)
        return WORTH_M * (1.0 - np.maximum(worth, 0.0))


class _SharedOut(NearestFrontier, ABC):
    """Each frontier belongs to one robot of the group; those of others are as far as ones that they are bound for."""

    def __init__(self, config: EnvConfig):
        super().__init__(config)
        self._ways = PathFinder()

    def extra_penalty_m(self, agent: str, beliefs: dict[str, Belief], terrain: Terrain) -> Array:
        """(frontiers,) more for those that belong to others."""
        belief, count = beliefs[agent], len(terrain.frontier_sizes)
        if not belief.mates:
            return np.zeros(count)
        poses = [belief.pose_map_robot, *belief.mates.values()]
        lengths_m = np.array([self._lengths_m(terrain, pose) for pose in poses])
        is_mine = np.ones(count, bool)
        is_mine[1:] = self.shared_out(lengths_m[:, 1:])
        return np.where(is_mine, 0.0, self.explorer.claim_penalty_m)

    @abstractmethod
    def shared_out(self, lengths_m: Array) -> Array:
        """(frontiers,) bool: which belong to the first robot, from path lengths (robots, frontiers)."""

    def _lengths_m(self, terrain: Terrain, pose: Array) -> Array:
        count = len(terrain.frontier_sizes)
        if not self._ways.spread(terrain, np.asarray(pose, float)[:2]):
            return np.full(count, UNREACHABLE_M)
        lengths_m, _ = self._ways.nearest_of_labels(terrain, terrain.labels, count - 1)
        return np.minimum(lengths_m, UNREACHABLE_M)


class Assignment(_SharedOut):
    """One frontier each, so that all ways together are shortest (the Hungarian method, Kuhn 1955)."""

    def shared_out(self, lengths_m: Array) -> Array:
        """The first robot's one frontier; all of them where there are fewer frontiers than robots and it got none."""
        robots, frontiers = linear_sum_assignment(lengths_m)
        mine = frontiers[robots == 0]
        return np.isin(np.arange(lengths_m.shape[1]), mine) if len(mine) else np.ones(lengths_m.shape[1], bool)


class Voronoi(_SharedOut):
    """Every robot keeps to the frontiers that it is nearer to than any mate is."""

    def shared_out(self, lengths_m: Array) -> Array:
        """Those to which no mate has a shorter way."""
        return lengths_m[0] <= lengths_m.min(axis=0)
