"""How far places are from what robots of other maps have seen, as far as radio and pending closures tell.

Robots that share no map know of each other what their mapper was sent: which access points the others heard
(`Belief.radio_trails`), and pending loop closures (`Belief.hypotheses`). Both say where the others' paths are likely to
be in one's own map. With n closures that agree, their hypothesis has the probability n / (n + 1) (Laplace's rule of
succession).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.planning.radio_whereabouts import Whereabouts, whereabouts
from twc_env.records.geometry import transform_points
from twc_env.records.messages import Belief, RadioTrail

PERIOD_S = 3.0
"""Period of locating the others."""
PASSED_M = 2.0
"""Places within this distance of the robot's path have been tried."""


class OtherMaps:
    """Of two groups, the one whose lowest number is greater goes to the other: if both went, all would explore on from
    one place."""

    def __init__(self, time_step_s: float):
        self._time_step_s = time_step_s
        self._located: dict[int, tuple[float, tuple[int, int], list[Whereabouts | None]]] = {}

    def away_m(self, belief: Belief, places_m: Array, track_m: Array) -> Array:
        """(k,) expected distance from places_m (k, 2) to the path of the group that is nearest by this measure; 0 where
        no other group is sought. track_m (n, 2): where the robot has been."""
        others = _sought(belief)
        if not others:
            return np.zeros(len(places_m))
        hypotheses = {each.robots: each for each in belief.hypotheses}
        distances_m = []
        for other, where in zip(others, self._locate(belief, others), strict=True):
            away_m = np.zeros(len(places_m)) if where is None else where.distance_m(places_m)
            if other.robots in hypotheses:
                said = hypotheses[other.robots]
                there = _untried(transform_points(said.pose_map_other, other.places_m), track_m)
                if len(there):
                    nearest_m = np.hypot(*(places_m[:, None] - there[None]).T).min(axis=0)
                    away_m += said.support / (said.support + 1.0) * (nearest_m - away_m)
            distances_m.append(away_m)
        least_m: Array = np.min(distances_m, axis=0)
        return least_m

    def _locate(self, belief: Belief, others: list[RadioTrail]) -> list[Whereabouts | None]:
        """Where each of the others is, as of some seconds ago."""
        state = belief.map_version, len(others)
        step, known, found = self._located.get(belief.robot, (-np.inf, state, []))
        if known != state or (belief.step - step) * self._time_step_s >= PERIOD_S:
            found = [whereabouts(belief.radio_trails[0], other) for other in others]
            self._located[belief.robot] = belief.step, state, found
        return found


def _sought(belief: Belief) -> list[RadioTrail]:
    """The trails of groups with a lower number, and of the map of an earlier session."""
    first = min([belief.robot, *belief.teammates])
    return [other for other in belief.radio_trails[1:] if min(other.robots, default=-1) < first]


def _untried(points_m: Array, track_m: Array) -> Array:
    """Those of points (k, 2) that are not near the track."""
    near_m = np.hypot(*(points_m[:, None] - track_m[None]).T).min(axis=0, initial=np.inf)
    return points_m[near_m > PASSED_M]
