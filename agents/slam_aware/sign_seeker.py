"""Sign seeker: explores towards where another map begins, so that signs and scans can settle who is where.

Robots that share no map know of each other what their mapper was sent: which access points the others heard
(`Belief.radio_trails`), and pending loop closures (`Belief.hypotheses`). Both say where the others' paths are likely to
be in one's own map. A frontier costs its way and a share of the expected distance from there to the other path, as in
Fox, Ko, Konolige, Limketkai, Schulz and Stewart ("Distributed multirobot exploration and mapping", Proc. IEEE 94(7),
2006) the value of meeting is weighed against that of exploring on; that radio tells the way is our own. Old paths are
as good to reach as robots: maps merge where paths overlap. Of two groups, the one whose lowest number is greater goes
to the other: if both went, all would explore on from one place.

With n closures that agree, their hypothesis has the probability n / (n + 1) (Laplace's rule of succession). All else is
MinPos, its blind twin.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.planning import Whereabouts, whereabouts
from twc_env.records.geometry import transform_points
from twc_env.records.messages import Belief, RadioTrail

from ..shared.frontier_team import Frontiers
from ..teams.minpos import MinPos

WEIGHT = 0.5
"""A frontier may be this much further for each metre that it is nearer to the other path."""
PERIOD_S = 3.0
"""Period of locating the others."""
PASSED_M = 2.0
"""Places within this distance of the robot's path have been tried."""


class SignSeeker(MinPos):
    """Without what is known of other maps it is MinPos, its blind twin."""

    def reset(self, seed: int, agents: Sequence[str]) -> None:
        """Discard all state."""
        super().reset(seed, agents)
        self._located: dict[str, tuple[float, tuple[int, int], list[Whereabouts | None]]] = {}

    def choose(self, agent: str, beliefs: dict[str, Belief], frontiers: Frontiers) -> int | None:
        """The frontier of the lowest rank; of those, the one of the least way and distance to another path."""
        away_m = self._away_m(agent, beliefs[agent], frontiers.places_m)
        rank = (frontiers.teammate_lengths_m < frontiers.lengths_m).sum(axis=0)
        return int(np.lexsort((frontiers.lengths_m + WEIGHT * away_m, rank))[0])

    def _away_m(self, agent: str, belief: Belief, places_m: Array) -> Array:
        """(k,) expected distance from places (k, 2) to the path of the group that is nearest by this measure."""
        others = _sought(belief)
        if not others:
            return np.zeros(len(places_m))
        hypotheses = {each.robots: each for each in belief.hypotheses}
        distances_m = []
        for other, where in zip(others, self._locate(agent, belief, others), strict=True):
            away_m = np.zeros(len(places_m)) if where is None else where.distance_m(places_m)
            if other.robots in hypotheses:
                said = hypotheses[other.robots]
                there = self._untried(agent, transform_points(said.pose_map_other, other.places_m))
                if len(there):
                    nearest_m = np.hypot(*(places_m[:, None] - there[None]).T).min(axis=0)
                    away_m += said.support / (said.support + 1.0) * (nearest_m - away_m)
            distances_m.append(away_m)
        least_m: Array = np.min(distances_m, axis=0)
        return least_m

    def _locate(self, agent: str, belief: Belief, others: list[RadioTrail]) -> list[Whereabouts | None]:
        """Where each of the others is, as of some seconds ago."""
        state = belief.map_version, len(others)
        step, known, found = self._located.get(agent, (-np.inf, state, []))
        if known != state or (belief.step - step) * self.dynamics.time_step_s >= PERIOD_S:
            found = [whereabouts(belief.radio_trails[0], other) for other in others]
            self._located[agent] = belief.step, state, found
        return found

    def _untried(self, agent: str, points_m: Array) -> Array:
        """Those of points (k, 2) to which the robot has not been."""
        track_m = np.array(self.robots[agent].track_m).reshape(-1, 2)
        near_m = np.hypot(*(points_m[:, None] - track_m[None]).T).min(axis=0, initial=np.inf)
        return points_m[near_m > PASSED_M]


def _sought(belief: Belief) -> list[RadioTrail]:
    """The trails of groups with a lower number, and of the map of an earlier session."""
    first = min([belief.robot, *belief.teammates])
    return [other for other in belief.radio_trails[1:] if min(other.robots, default=-1) < first]
