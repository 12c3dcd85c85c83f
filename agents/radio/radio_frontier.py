"""The nearest-frontier team with a radio prior: it prefers frontiers beyond which floor is predicted from WiFi."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.planning import Terrain
from twc_env.records.messages import Belief

from ..teams.nearest_frontier import NearestFrontier

REACH_M = 4.0
"""Unseen floor within this distance of a frontier counts."""
METRES_PER_M2 = 0.3
"""Detour that one square metre of predicted floor is worth."""
BONUS_MAX_M = 6.0


class RadioFrontier(NearestFrontier):
    """Needs `slam.k_visibility.enabled`; without a radio map it equals the nearest-frontier team."""

    def extra_penalty_m(self, agent: str, beliefs: dict[str, Belief], terrain: Terrain) -> Array:
        """(frontiers,) smaller penalty for frontiers next to unseen floor predicted from radio."""
        return radio_penalty_m(beliefs[agent], terrain.frontier_centres_m)


def radio_penalty_m(belief: Belief, centres_m: Array) -> Array:
    """(frontiers,) penalty [m] of frontiers at centres (frontiers, 2) relative to the best one."""
    radio, grid = belief.radio_map, belief.grid
    if radio is None or grid.log_odds.size == 0:
        return np.zeros(len(centres_m))
    places = radio.centre_of(np.argwhere(radio.log_odds < 0))
    unseen = places[grid.level_at(places) == 0]
    area_m2 = np.array([np.sum(np.hypot(*(unseen - centre).T) < REACH_M) for centre in centres_m])
    bonus = np.minimum(area_m2 * radio.resolution_m**2 * METRES_PER_M2, BONUS_MAX_M)
    return bonus.max(initial=0.0) - bonus
