"""MinPos: the frontier to which the fewest teammates are closer (Bautin, Simonin and Charpillet 2012).

"MinPos: a novel frontier allocation algorithm for multi-robot exploration", ICIRA 2012. The rank of a robot towards a
frontier is the number of robots with a shorter path to it. Each robot takes the frontier of its lowest rank; of
several, the nearest. This spreads robots over directions, even where all frontiers are nearest to the same robot.
"""

from __future__ import annotations

import numpy as np

from twc_env.records.messages import Belief

from ..shared.frontier_team import Frontiers, FrontierTeam


class MinPos(FrontierTeam):
    """Ranks are recomputed at each replanning."""

    keeps_goal = False

    def choose(self, agent: str, beliefs: dict[str, Belief], frontiers: Frontiers) -> int | None:
        """The frontier of the lowest rank, the nearest of those."""
        rank = (frontiers.teammate_lengths_m < frontiers.lengths_m).sum(axis=0)
        return int(np.lexsort((frontiers.lengths_m, rank))[0])
