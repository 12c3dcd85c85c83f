"""Frontier-based exploration without coordination (Yamauchi 1998).

"Frontier-based exploration using multiple robots", Agents 1998: robots share what they map, and each one drives to the
nearest accessible frontier. A frontier that it cannot reach is put on a list of its own. Two robots may drive to the
same frontier.
"""

from __future__ import annotations

import numpy as np

from twc_env.records.messages import Belief

from ..shared.frontier_team import Frontiers, FrontierTeam


class GreedyFrontier(FrontierTeam):
    """Each robot drives to its nearest frontier and decides anew when that is mapped."""

    def choose(self, agent: str, beliefs: dict[str, Belief], frontiers: Frontiers) -> int | None:
        """The nearest frontier."""
        return int(np.argmin(frontiers.lengths_m))
