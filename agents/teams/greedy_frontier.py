"""Frontier-based exploration without coordination (Yamauchi 1998).

"Frontier-based exploration using multiple robots", Agents 1998: robots share what they map, and each one drives to the
nearest accessible frontier. A frontier that it cannot reach is put on a list of its own. Two robots may drive to the
same frontier.
"""

from __future__ import annotations

from ..shared.frontier_team import FrontierTeam


class GreedyFrontier(FrontierTeam):
    """Each robot drives to its nearest frontier and decides anew when that is mapped."""
