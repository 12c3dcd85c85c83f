"""Placement of routers in a floor plan for line of sight to most of the floor (papers.md K24f)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.errors import MapError
from twc_env.world.building.floorplan import Floorplan

CLEARANCE_M = 0.3
_CANDIDATES_MAX, _FLOOR_MAX = 400, 2000
"""Limits of candidate positions and floor samples."""
_OVERLAP = 0.1
"""Utility of a further router with line of sight to the same floor."""
_WALL_FACTOR = 0.3
"""Factor on the utility per wall."""


def place_routers(plan: Floorplan, count: int) -> Array:
    """(routers, 2) positions, the most useful first: each adds most to the summed utility of the floor.

    The utility of floor with k walls to the nearest router is 0.3^k. Raises MapError for a count below one or a plan
    without floor at `CLEARANCE_M` from walls.
    """
    if count < 1:
        raise MapError(f"place_routers needs at least one router; got {count}")
    floor = _floor(plan)
    places = floor[plan.wall_index.distance_m(floor, 2 * CLEARANCE_M) >= CLEARANCE_M]
    if len(places) == 0:
        raise MapError(f"map {plan.name!r} has no floor {CLEARANCE_M} m clear of walls to put a router on")
    places = places[:: max(len(places) // _CANDIDATES_MAX, 1)]
    walls = np.array([plan.wall_index.crossing(place, floor)[0] for place in places])  # (places, floor)
    utility = _WALL_FACTOR ** walls.astype(float)
    chosen: list[int] = []
    best = np.zeros(len(floor))
    for _ in range(min(count, len(places))):
        gain = np.maximum(utility - best, 0.0) + _OVERLAP * np.minimum(utility, best)
        chosen.append(int(np.argmax(gain.sum(axis=1))))
        best = np.maximum(best, utility[chosen[-1]])
    return places[chosen]


def share_in_sight(plan: Floorplan, position_m: Array) -> float:
    """Share of the floor with line of sight to one of the positions (n, 2)."""
    floor = _floor(plan)
    walls = np.array([plan.wall_index.crossing(place, floor)[0] for place in position_m])
    return float((walls.min(axis=0) == 0).mean())


def _floor(plan: Floorplan) -> Array:
    """(n, 2) at most about `_FLOOR_MAX` positions on the floor."""
    cells = plan.cells()
    floor = cells.centre_of(np.argwhere(cells.free))
    return floor[:: max(len(floor) // _FLOOR_MAX, 1)]
