"""The nearest-frontier team with a prior from radio: frontiers beyond which signal strength tells floor come first."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray as Array

from agents.nearest_frontier import NearestFrontier
from twc_env.messages import Belief
from twc_env.planning import Terrain

REACH_M = 4.0
"""How far beyond a frontier unseen floor counts."""
METRES_PER_M2 = 0.3
"""Detour that one square metre of floor told by radio is worth."""
BONUS_MAX_M = 6.0


class RadioFrontier(NearestFrontier):
    """Needs `slam.k_visibility.enabled`; without a radio map it is the nearest-frontier team."""

    def extra_penalty_m(self, agent: str, beliefs: dict[str, Belief], terrain: Terrain) -> Array:
        """(frontiers,) less for those beyond which radio tells free floor that no scan has seen."""
        return told_by_radio_m(beliefs[agent], terrain.frontier_centres_m)


def told_by_radio_m(belief: Belief, centres_m: Array) -> Array:
    """(frontiers,) metres of detour by which frontiers at centres (frontiers, 2) are less wanted than the best."""
    radio, grid = belief.radio_map, belief.grid
    if radio is None or grid.log_odds.size == 0:
        return np.zeros(len(centres_m))
    places = radio.centre_of(np.argwhere(radio.log_odds < 0))
    unseen = places[grid.level_at(places) == 0]
    area_m2 = np.array([np.sum(np.hypot(*(unseen - centre).T) < REACH_M) for centre in centres_m])
    bonus = np.minimum(area_m2 * radio.resolution_m**2 * METRES_PER_M2, BONUS_MAX_M)
    return bonus.max(initial=0.0) - bonus
