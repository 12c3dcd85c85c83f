"""One room per robot: segmentation of the environment (Wurm, Stachniss and Burgard, IROS 2008).

The known floor is cut at the critical points of its Voronoi graph: where the clearance has a local minimum, as in doors
(Thrun 1998). Robots are assigned to segments that still have frontiers by the Hungarian method, so that they do not
crowd one room; within its segment, a robot takes the nearest frontier. A robot prefers the segment in which it is.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray as Array
from scipy.optimize import linear_sum_assignment

from twc_env.planning import Terrain
from twc_env.planning.segmentation import segmented
from twc_env.records.messages import Belief

from ..shared.frontier_team import Frontiers, FrontierTeam

STAY_M = 5.0
"""What a robot's own segment is worth, so that it finishes a room before it leaves."""


class Segments(FrontierTeam):
    """Segments are computed and assigned anew whenever a robot decides."""

    def reset(self, seed: int, agents: Sequence[str]) -> None:
        """Discard all state."""
        super().reset(seed, agents)
        self._segmented: tuple[Terrain, Array] | None = None
        """The latest terrain and its segments: robots of a group that decide together have the same."""

    def choose(self, agent: str, beliefs: dict[str, Belief], frontiers: Frontiers) -> int | None:
        """The nearest frontier of the segment assigned to this robot."""
        belief, terrain = beliefs[agent], frontiers.terrain
        if self._segmented is None or self._segmented[0] is not terrain:
            self._segmented = terrain, segmented(terrain)
        segments = self._segmented[1]
        segment = _at(terrain, segments, frontiers.places_m)
        lengths_m = frontiers.all_lengths_m
        names = np.unique(segment)
        costs_m = np.array([lengths_m[:, segment == name].min(axis=1) for name in names]).T  # (robots, segments)
        poses = np.array([belief.pose_map_robot, *belief.teammates.values()])
        costs_m -= STAY_M * (_at(terrain, segments, poses[:, :2])[:, None] == names)
        offered = np.tile(costs_m, (1, -(-len(costs_m) // len(names))))
        _, columns = linear_sum_assignment(offered)
        mine = names[int(columns[0]) % len(names)]
        return int(np.argmin(np.where(segment == mine, frontiers.lengths_m, np.inf)))


def _at(terrain: Terrain, segments: Array, places_m: Array) -> Array:
    """(k,) the segment at each of places_m (k, 2)."""
    cells = np.floor(terrain.to_cells(places_m)).astype(int)
    rows, columns = np.clip(cells, 0, np.array(segments.shape) - 1).T
    return segments[rows, columns]
