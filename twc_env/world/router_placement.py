"""Where routers should stand in a floor plan to see the most of it (papers.md K24f)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.errors import MapError
from twc_env.world.floorplan import Floorplan

_CANDIDATES_MAX, _FLOOR_MAX = 400, 2000
_OVERLAP = 0.1
"""Worth of one more line of sight to floor that already has one."""
_BEHIND = 0.3
"""Worth of floor behind each further wall."""


@dataclass(frozen=True, slots=True, eq=False)
class Placement:
    """Advice for one plan."""

    position_m: Array
    """(routers, 2) in order of worth."""
    line_of_sight_share: Array
    """(routers,) share of the floor that sees at least one of the first routers."""
    dead_share: float
    """Share of the floor behind three walls or more of every router."""


def place_routers(plan: Floorplan, count: int, clearance_m: float = 0.3) -> Placement:
    """Greedy advice: each router takes the place that adds the most floor in line of sight, with little overlap.

    Floor behind one wall counts 0.3, behind two 0.09, and so on. Raises MapError for a count below one or a plan
    without floor that clear of walls.
    """
    if count < 1:
        raise MapError(f"place_routers needs at least one router; got {count}")
    cells = plan.cells()
    floor = cells.centre_of(np.argwhere(cells.free))
    floor = floor[:: max(len(floor) // _FLOOR_MAX, 1)]
    places = floor[plan.wall_index.distance_m(floor, 2 * clearance_m) >= clearance_m]
    if len(places) == 0:
        raise MapError(f"map {plan.name!r} has no floor {clearance_m} m clear of walls; use a smaller clearance")
    places = places[:: max(len(places) // _CANDIDATES_MAX, 1)]
    walls = np.array([plan.wall_index.crossing(place, floor)[0] for place in places])  # (places, floor)
    worth = _BEHIND ** walls.astype(float)
    chosen: list[int] = []
    best = np.zeros(len(floor))
    shares = []
    for _ in range(min(count, len(places))):
        gain = np.maximum(worth - best, 0.0) + _OVERLAP * np.minimum(worth, best)
        chosen.append(int(np.argmax(gain.sum(axis=1))))
        best = np.maximum(best, worth[chosen[-1]])
        shares.append(float((walls[chosen].min(axis=0) == 0).mean()))
    dead = float((walls[chosen].min(axis=0) >= 3).mean())
    return Placement(places[chosen], np.array(shares), dead)
