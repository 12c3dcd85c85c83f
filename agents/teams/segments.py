"""One room per robot: segmentation of the environment (Wurm, Stachniss and Burgard, IROS 2008).

The known floor is cut at the critical points of its Voronoi graph: where the clearance has a local minimum, as in doors
(Thrun 1998). Robots are assigned to segments that still have frontiers by the Hungarian method, so that they do not
crowd one room; within its segment, a robot takes the nearest frontier. A robot prefers the segment in which it is.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray as Array
from scipy.ndimage import distance_transform_edt, label, minimum_filter
from scipy.optimize import linear_sum_assignment

from twc_env.planning import FREE, WALL, Terrain
from twc_env.records.messages import Belief

from ..shared.frontier_team import Frontiers, FrontierTeam

DOOR_MIN_M, DOOR_MAX_M = 0.75, 1.6
"""Width of a passage that separates two segments; narrower ones are corners, too coarse in cells to tell apart."""
APART_MIN_M = 0.6
"""Cells belong to the Voronoi graph where neighbours have nearest walls at least this far apart ..."""
OPPOSITE = 1.75
"""... and this many times the clearance: on opposite sides, unlike in the corner of a room, where it is 1.4."""
WINDOW_M = 1.2
"""A critical point is the narrowest place of the graph in a square of this side."""
STAY_M = 5.0
"""What a robot's own segment is worth, so that it finishes a room before it leaves."""


class Segments(FrontierTeam):
    """Segments are computed and assigned anew whenever a robot decides."""

    def reset(self, seed: int, agents: Sequence[str]) -> None:
        """Discard all state."""
        super().reset(seed, agents)
        self._segmented: tuple[Terrain, Array] | None = None
        """The latest terrain and its segments: robots of a group that decide together have the same."""

    def choose(self, agent: str, beliefs: dict[str, Belief], frontiers: Frontiers) -> int | None:
        """The nearest frontier of the segment assigned to this robot."""
        belief, terrain = beliefs[agent], frontiers.terrain
        if self._segmented is None or self._segmented[0] is not terrain:
            self._segmented = terrain, segmented(terrain)
        segments = self._segmented[1]
        segment = _at(terrain, segments, frontiers.places_m)
        lengths_m = frontiers.all_lengths_m
        names = np.unique(segment)
        costs_m = np.array([lengths_m[:, segment == name].min(axis=1) for name in names]).T  # (robots, segments)
        poses = np.array([belief.pose_map_robot, *belief.teammates.values()])
        costs_m -= STAY_M * (_at(terrain, segments, poses[:, :2])[:, None] == names)
        offered = np.tile(costs_m, (1, -(-len(costs_m) // len(names))))
        _, columns = linear_sum_assignment(offered)
        mine = names[int(columns[0]) % len(names)]
        return int(np.argmin(np.where(segment == mine, frontiers.lengths_m, np.inf)))


def segmented(terrain: Terrain) -> Array:
    """(h, w) int: the segment of each free cell of the terrain, 0 for all others."""
    cell_m, is_free = terrain.resolution_m, terrain.kind == FREE
    is_wall = terrain.kind == WALL
    if not is_wall.any():
        return label(is_free)[0]
    clearance, nearest = distance_transform_edt(~is_wall, return_indices=True)
    is_graph = np.zeros(is_free.shape, bool)
    for axis in (0, 1):
        apart = np.diff(nearest, axis=1 + axis)
        near_walls = np.minimum(_but_first(clearance, axis), _but_last(clearance, axis))
        is_far = np.hypot(*apart) >= np.maximum(APART_MIN_M / cell_m, OPPOSITE * near_walls)
        is_graph |= np.pad(is_far, [(0, 1) if k == axis else (0, 0) for k in (0, 1)])
    is_graph &= is_free & (clearance * cell_m <= DOOR_MAX_M / 2) & (clearance * cell_m >= DOOR_MIN_M / 2)
    narrow = np.where(is_graph, clearance, np.inf)
    is_critical = is_graph & (narrow <= minimum_filter(narrow, max(3, round(WINDOW_M / cell_m))))
    is_cut = is_free.copy()
    for row, column in np.argwhere(is_critical):
        walls = {tuple(nearest[:, r, c]) for r in (row, row + 1) for c in (column, column + 1)}
        for r, c in walls:  # a line from the critical point to each of its nearest walls
            steps = 2 * int(max(abs(r - row), abs(c - column))) + 2
            part = np.linspace(0.0, 1.0, steps)
            rows, columns = (
                np.rint(row + part * (r - row)).astype(int),
                np.rint(column + part * (c - column)).astype(int),
            )
            is_cut[rows, columns] = False
            is_cut[rows, np.minimum(columns + 1, is_cut.shape[1] - 1)] = False
    parts, _ = label(is_cut)
    _, (rows, columns) = distance_transform_edt(parts == 0, return_indices=True)
    return np.where(is_free, parts[rows, columns], 0)


def _but_first(values: Array, axis: int) -> Array:
    return np.take(values, range(1, values.shape[axis]), axis)


def _but_last(values: Array, axis: int) -> Array:
    return np.take(values, range(values.shape[axis] - 1), axis)


def _at(terrain: Terrain, segments: Array, places_m: Array) -> Array:
    """(k,) the segment at each of places_m (k, 2)."""
    cells = np.floor(terrain.to_cells(places_m)).astype(int)
    rows, columns = np.clip(cells, 0, np.array(segments.shape) - 1).T
    return segments[rows, columns]
