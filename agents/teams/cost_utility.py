"""Coordinated multi-robot exploration (Burgard, Moors, Stachniss and Schneider 2005, Algorithm 1).

The robots of a group are assigned one after the other: of all robots and frontiers, the pair with the greatest utility
minus weighted cost; then the frontiers that will be seen from there lose utility. Every robot computes the assignment
of the whole group from the poses that it knows, and takes its own part.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.config import EnvConfig, shared_config
from twc_env.records.messages import Belief

from ..shared.frontier_team import Frontiers, FrontierTeam

WORTH_M = 10.0
"""Way that a frontier is worth if no other robot will see it: 1 / beta of the paper."""


class CostUtility(FrontierTeam):
    """Utility minus cost, recomputed at each replanning."""

    keeps_goal = False

    def __init__(self, config: EnvConfig):
        super().__init__(config)
        self._sight_m = shared_config(config).lidar.range_max_m

    def choose(self, agent: str, beliefs: dict[str, Belief], frontiers: Frontiers) -> int | None:
        """The frontier assigned to this robot."""
        return assigned(frontiers.all_lengths_m, frontiers.centres_m, self._sight_m)


def assigned(lengths_m: Array, centres_m: Array, sight_m: float) -> int:
    """Index of the frontier of the first robot.

    lengths_m (robots, frontiers): path lengths; centres_m (frontiers, 2). The probability that a frontier is seen from
    another one falls linearly to 0 at the range of the scanner (Eq. 6 of the paper).
    """
    utility = np.ones(len(centres_m))
    unassigned = np.ones(len(lengths_m), bool)
    while True:
        values = np.where(unassigned[:, None], utility - lengths_m / WORTH_M, -np.inf)
        robot, frontier = np.unravel_index(int(np.argmax(values)), values.shape)
        if robot == 0:
            return int(frontier)
        unassigned[robot] = False
        away_m = np.hypot(*(centres_m - centres_m[frontier]).T)
        utility -= np.clip(1.0 - away_m / sight_m, 0.0, None)
