"""Sign seeker: explores towards where another map begins, so that signs and scans can settle who is where.

A frontier costs its way and a share of the expected distance from there to the other map's path, as in Fox, Ko,
Konolige, Limketkai, Schulz and Stewart ("Distributed multirobot exploration and mapping", Proc. IEEE 94(7), 2006) the
value of meeting is weighed against that of exploring on; that radio tells the way (`twc_env.planning.OtherMaps`) is our
own. Old paths are as good to reach as robots: maps merge where paths overlap. All else is MinPos, its blind twin.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from twc_env.planning import OtherMaps
from twc_env.records.messages import Belief

from ..shared.frontier_team import Frontiers
from ..teams.minpos import MinPos

WEIGHT = 0.5
"""A frontier may be this much further for each metre that it is nearer to the other path."""


class SignSeeker(MinPos):
    """Without what is known of other maps it is MinPos, its blind twin."""

    def reset(self, seed: int, agents: Sequence[str]) -> None:
        """Discard all state."""
        super().reset(seed, agents)
        self._others = OtherMaps(self.dynamics.time_step_s)

    def choose(self, agent: str, beliefs: dict[str, Belief], frontiers: Frontiers) -> int | None:
        """The frontier of the lowest rank; of those, the one of the least way and distance to another path."""
        track_m = np.array(self.robots[agent].track_m).reshape(-1, 2)
        away_m = self._others.away_m(beliefs[agent], frontiers.places_m, track_m)
        rank = (frontiers.teammate_lengths_m < frontiers.lengths_m).sum(axis=0)
        return int(np.lexsort((frontiers.lengths_m + WEIGHT * away_m, rank))[0])
