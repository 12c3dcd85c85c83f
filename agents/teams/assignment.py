"""One frontier per robot, with minimum total path length: the Hungarian method (Kuhn 1955).

Its use for frontiers is that of Ko, Stewart, Fox, Konolige and Limketkai (IROS 2003). Every robot solves the assignment
of its whole group. With fewer frontiers than robots, frontiers are offered again.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray as Array
from scipy.optimize import linear_sum_assignment

from twc_env.records.messages import Belief

from ..shared.frontier_team import Frontiers, FrontierTeam


class Assignment(FrontierTeam):
    """The assignment is recomputed at each replanning."""

    keeps_goal = False

    def choose(self, agent: str, beliefs: dict[str, Belief], frontiers: Frontiers) -> int | None:
        """The frontier assigned to this robot."""
        return assigned(frontiers.all_lengths_m)


def assigned(lengths_m: Array) -> int:
    """Index of the frontier of the first robot, from path lengths (robots, frontiers)."""
    robots, count = lengths_m.shape
    offered = np.tile(lengths_m, (1, -(-robots // count)))
    _, columns = linear_sum_assignment(offered)
    return int(columns[0]) % count
