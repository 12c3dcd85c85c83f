"""Walks for structure-from-WiFi tables: a route along all walls, and the readings on it (papers.md K21)."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray as Array
from scipy.ndimage import binary_dilation, label, uniform_filter1d

from twc_env.config import RadioConfig
from twc_env.datasets.buildings.raster import largest_part
from twc_env.errors import MapError
from twc_env.records.geometry import points_along, travelled_m
from twc_env.reproduce.routes import RoutePlanner
from twc_env.world.building.floorplan import Floorplan
from twc_env.world.sensors.radio import RadioModel
from twc_env.world.sensors.reception import WifiReceiver

STANDOFF_M = 0.3
"""Distance of the sensor from the wall that it follows."""
_FINE_M = 0.05
_SMOOTH_M = 0.2
_AROUND = np.array([(0, 1), (1, 1), (1, 0), (1, -1), (0, -1), (-1, -1), (-1, 0), (-1, 1)])


@dataclass(frozen=True, slots=True, eq=False)
class WalkReadings:
    """Readings of one walk, with the ground truth for scoring."""

    position_m: Array
    """(readings, 2) building frame."""
    rssi_dbm: Array
    """(readings, routers), NaN where not heard."""
    router_m: Array
    """(routers, 2)."""
    walls: Array
    """(readings, routers) true number of walls crossed."""


def wall_following_route(plan: Floorplan, standoff_m: float = STANDOFF_M) -> Array:
    """(points, 2) a path along every wall of the open floor at a distance of `standoff_m` (Fig. 7).

    One round per contour: first the outer one, then each free-standing block. Raises MapError if there is no floor at
    that distance from walls.
    """
    cells = plan.cells(_FINE_M)
    centres = cells.centre_of(np.argwhere(cells.free))
    clear = np.zeros(cells.free.shape, bool)
    clear[cells.free] = plan.wall_index.distance_m(centres, 2 * standoff_m) >= standoff_m
    clear = largest_part(clear)
    if not clear.any():
        raise MapError(f"map {plan.name!r} has no floor {standoff_m} m clear of walls; use a smaller standoff")
    loops = [cells.centre_of(loop) for loop in _contours(clear)]
    loops = [loop for loop in loops if len(loop) * _FINE_M > 1.0]
    way, planner = loops[0], RoutePlanner(plan)
    for loop in loops[1:]:
        start = int(np.argmin(((loop - way[-1]) ** 2).sum(axis=1)))
        way = np.concatenate([way, planner.route([way[-1], loop[start]]), np.roll(loop, -start, axis=0)])
    return uniform_filter1d(way, round(_SMOOTH_M / _FINE_M), axis=0, mode="nearest")


def _contours(inside: Array) -> list[Array]:
    """Contours (cells, 2) of a region as rows and columns: the outer one, then each hole."""
    holes, count = label(~np.pad(inside, 1), structure=np.ones((3, 3)))
    loops = []
    for hole in range(1, count + 1):
        rim = binary_dilation(holes == hole)[1:-1, 1:-1] & inside
        if rim.any():
            loops.append(_trace(inside, (holes == hole)[1:-1, 1:-1], np.argwhere(rim)[0]))
    return sorted(loops, key=len, reverse=True)


def _trace(inside: Array, hole: Array, start: Array) -> Array:
    """Moore neighbour tracing of one hole, until a cell is reached in the same direction again."""
    padded_inside, padded_hole = np.pad(inside, 1), np.pad(hole, 1, constant_values=bool(hole[0, 0]))
    at = start + 1
    looks = next(k for k in range(0, 8, 2) if padded_hole[tuple(at + _AROUND[k])])
    path: list[tuple[int, int]] = []
    seen: set[tuple[int, int, int]] = set()
    while True:
        for turn in range(1, 9):
            k = (looks + turn) % 8
            if padded_inside[tuple(at + _AROUND[k])]:
                break
        else:
            return np.array([at - 1])
        state = (int(at[0]), int(at[1]), k)
        if state in seen:
            return np.array(path) - 1
        seen.add(state)
        path.append((int(at[0]), int(at[1])))
        at = at + _AROUND[k]
        looks = (k + 5) % 8 if k % 2 == 0 else (k + 4) % 8
        while padded_inside[tuple(at + _AROUND[looks])]:
            looks = (looks - 1) % 8


def resampled(way_m: Array, count: int) -> Array:
    """(count, 2) points evenly spaced along a path."""
    return points_along(way_m, np.linspace(0.0, travelled_m(way_m)[-1], count))


def read_walk(
    plan: Floorplan, config: RadioConfig, position_m: Array, seed: int, faces_per_wall: int = 1
) -> WalkReadings:
    """Readings of one receiver of each router (the first address of each access point) at every position."""
    points = tuple(dataclasses.replace(p, macs=p.macs[:1]) for p in plan.access_points)
    plan = dataclasses.replace(plan, access_points=points)
    config = dataclasses.replace(config, bssids_per_access_point=0)
    model = RadioModel(config, plan)
    receiver = WifiReceiver(config, model, 0, seed)
    column_of = np.argsort([p.macs[0] for p in points])
    rssi = np.full((len(position_m), len(points)), np.nan)
    for k, place in enumerate(position_m):
        scan = receiver.scan(place)
        rssi[k, column_of[np.searchsorted(model.macs, scan.macs)]] = scan.rssi_dbm
    router_m = np.array([p.position_m for p in points])
    crossed = np.column_stack([plan.wall_index.crossing(router, position_m)[0] for router in router_m])
    return WalkReadings(position_m, rssi, router_m, (crossed + faces_per_wall - 1) // faces_per_wall)
