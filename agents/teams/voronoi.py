"""Each robot takes the frontiers of its group's map to which no teammate has a shorter path, based on
nearest-frontier."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.config import EnvConfig
from twc_env.planning import PathFinder, Terrain
from twc_env.records.messages import Belief

from .nearest_frontier import NearestFrontier

UNREACHABLE_M = 1e4


class Voronoi(NearestFrontier):
    """The frontiers are partitioned among the robots of a group by path length; those of others are penalised."""

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
        is_mine[1:] = lengths_m[0, 1:] <= lengths_m[:, 1:].min(axis=0)
        return np.where(is_mine, 0.0, self.explorer.claim_penalty_m)

    def _lengths_m(self, terrain: Terrain, pose: Array) -> Array:
        lengths_m = self._ways.lengths_to_frontiers_m(terrain, np.asarray(pose, float)[:2])
        return (
            np.full(len(terrain.clusters), UNREACHABLE_M) if lengths_m is None else np.minimum(lengths_m, UNREACHABLE_M)
        )
