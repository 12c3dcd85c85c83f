"""Lower bound on the path length of an active walk: the shortest walk found with a known building.

Readings are noise-free and walls are known. The search is a heuristic, so a shorter walk may exist; a robot that has to
discover the walls is not expected to reach the bound.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.config import DynamicsConfig
from twc_env.datasets.buildings.map_export import grid_of
from twc_env.planning import Terrain, covering_walk, walk_graph
from twc_env.records.messages import GridMap

from .radio_walk import HUG, SPACING_M
from .ray_gain import RayGain

PRICES_M = tuple(np.geomspace(0.005, 0.3, 12))
TRIES = 40_000
RESOLUTION_M = 0.1


def shortest_known_walk_m(plan, start_m: Array, share: float) -> float:
    """Length of the shortest walk found from start_m (2,) whose rays clear this share of the floor; inf if none
    does."""
    seen = grid_of(plan, RESOLUTION_M)
    radio = GridMap(np.zeros_like(seen.log_odds), seen.origin_m, RESOLUTION_M)
    transmitter_m = np.array([point.position_m for point in plan.access_points])
    graph = walk_graph(Terrain(seen, HUG * DynamicsConfig().robot_radius_m), start_m, SPACING_M)
    cleared = RayGain(radio, seen, transmitter_m, SPACING_M).cells_cleared(graph.places_m, np.zeros((0, 2)))
    random, turns, best_m = np.random.default_rng(0), np.array([0]), math.inf
    for price_m in PRICES_M:
        turns, cells = covering_walk(graph, cleared, price_m, turns, random.random((TRIES, 4)))
        if cells >= share * cleared.shape[1]:
            best_m = min(best_m, float(graph.lengths_m[turns[:-1], turns[1:]].sum()))
    return best_m
