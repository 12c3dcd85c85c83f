"""Walk where the radio will tell most: the path whose rays to the transmitters clear most doubtful cells per metre.

The active walk that inverse k-visibility leaves to future work. Needs `slam.k_visibility.enabled`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from twc_env.config import EnvConfig
from twc_env.messages import Belief, GridMap
from twc_env.planning import Driver, PathFinder, Terrain, as_action

Array = NDArray

SPACING_M = 0.5
"""Between places that are weighed against each other."""
PATH_STEP_M = 0.2
"""Readings are reckoned with every so far along a path."""
STRIDE_M = 2.5
"""A path is walked so far before the next choice."""
OVERHEAD_M = 0.6
"""Added to every path's length, or the nearest place would always win."""
WALL_DENSITY = 0.04
"""A ray with more walls than this per cell, as far as scans have shown walls, clears nothing."""
CLEAR_NATS = 2.0
"""A ray that says this much says all."""
SURE_LEVELS = 10.0
"""A cell that is this sure to be free, as the map holds log-odds, is not doubtful any more."""
GAIN_MIN_CELLS = 4.0
"""Where no path promises more, the walk is over."""
IDLE_TICKS = 30
ARRIVAL_M = 0.2
HUG_PRICES = (3, 12)
"""Terrain costs so much at 0.3 to 0.45 m from a wall."""
HUG_COST, APART_COST = 2, 6


class RadioWalk:
    """Every robot for itself: nearest frontiers until a transmitter is found, then the most telling path."""

    def __init__(self, config: EnvConfig):
        self._dynamics = config.dynamics
        self._finder = PathFinder()
        self.reset(0, ())

    def reset(self, seed: int, agents: Sequence[str]) -> None:
        """Forget everything."""
        self._drivers = {agent: Driver(self._dynamics, self._finder) for agent in agents}
        self._goals_m: dict[str, Array] = {}
        self._given_up_m: dict[str, list[Array]] = {agent: [] for agent in agents}
        self._walked_m: dict[str, list[Array]] = {agent: [] for agent in agents}
        self._idle = dict.fromkeys(agents, 0)
        self._read: dict[str, Callable[[Belief, float], Terrain]] = {}

    def act(self, beliefs: dict[str, Belief]) -> dict[str, NDArray]:
        """On along the chosen path, or a new choice."""
        return {agent: self._drive(agent, belief) for agent, belief in beliefs.items()}

    def finished(self, beliefs: dict[str, Belief]) -> bool:
        """Whether no robot has found anything worth walking for a while."""
        return bool(beliefs) and all(self._idle[agent] >= IDLE_TICKS for agent in beliefs)

    def _drive(self, agent: str, belief: Belief) -> Array:
        driver = self._drivers[agent]
        if driver.status == "failed":
            self._given_up_m[agent].append(self._goals_m[agent])
        if driver.status != "driving":
            goal = self._choose(agent, belief)
            self._idle[agent] = 0 if goal is not None else self._idle[agent] + 1
            if goal is None:
                return as_action(0.0, 0.6 * self._dynamics.turn_rate_max_rad_s, self._dynamics)
            self._goals_m[agent] = goal
            driver.start(goal, belief, arrival_m=ARRIVAL_M)
        speed, turn_rate = driver.command(belief, self._read.get(agent, self._terrain_of))
        return as_action(speed, turn_rate, self._dynamics)

    def _terrain_of(self, belief: Belief, squeeze: float) -> Terrain:
        poses = np.array([belief.pose_map_robot, *belief.mates.values()])
        return Terrain(belief.grid, squeeze * self._dynamics.robot_radius_m, poses[:, :2])

    def _along_walls(self, belief: Belief, squeeze: float) -> Terrain:
        """The terrain on which it is cheap to keep near a wall: rays to there cross most floor."""
        terrain = self._terrain_of(belief, squeeze)
        price = terrain.cost
        hugging = np.where((price >= HUG_PRICES[0]) & (price <= HUG_PRICES[1]), HUG_COST, APART_COST)
        terrain.cost = np.where(price > 0, hugging, 0).astype(price.dtype)
        return terrain

    def _choose(self, agent: str, belief: Belief) -> Array | None:
        """(2,) where to go next; None when nothing promises enough."""
        terrain, here = self._terrain_of(belief, 1.0), belief.pose_map_robot[:2]
        if belief.radio_map is None or len(belief.transmitter_m) == 0:
            plan = self._finder.cheapest(terrain, here, terrain.labels, np.zeros(len(terrain.frontier_sizes)))
            return None if plan is None else part_of_path(plan.path_m, STRIDE_M)[-1]
        gain = RayGain(belief.radio_map, belief.grid, belief.transmitter_m, terrain, self._walked_m[agent])
        best, chosen_m = 0.0, np.zeros((0, 2))
        for read in (self._terrain_of, self._along_walls):
            for path_m in self._paths(read(belief, 1.0), here, self._given_up_m[agent]):
                told = gain.of_path(part_of_path(path_m, math.inf))
                worth = told / (length_m(path_m) + OVERHEAD_M)
                if told >= GAIN_MIN_CELLS and worth > best:
                    best, chosen_m = worth, part_of_path(path_m, STRIDE_M)
                    self._read[agent] = read
        self._walked_m[agent] += list(chosen_m)
        return chosen_m[-1] if len(chosen_m) else None

    def _paths(self, terrain: Terrain, here_m: Array, given_up_m: list[Array]) -> list[Array]:
        """Cheapest paths (k, 2) to reachable places on a lattice."""
        stride = max(1, round(SPACING_M / terrain.resolution_m))
        labels = np.zeros_like(terrain.labels)
        part = (slice(stride // 2, None, stride), slice(stride // 2, None, stride))
        is_open = terrain.cost[part] > 0
        labels[part][is_open] = np.arange(1, is_open.sum() + 1)
        if not self._finder.spread(terrain, here_m):
            return []
        lengths_m, places_m = self._finder.nearest_of_labels(terrain, labels, int(is_open.sum()))
        paths = []
        for label in np.flatnonzero(np.isfinite(lengths_m[1:])) + 1:
            place = places_m[label]
            if math.dist(place, here_m) < SPACING_M or any(math.dist(place, p) < SPACING_M for p in given_up_m):
                continue
            plan = self._finder.cheapest(terrain, here_m, np.where(labels == label, 1, 0).astype(np.int32), np.zeros(2))
            if plan is not None:
                paths.append(np.vstack([here_m, plan.path_m]))
        return paths


class RayGain:
    """How much doubt the rays from transmitters to the points of a path would meet."""

    def __init__(
        self, radio: GridMap, seen: GridMap, transmitter_m: Array, terrain: Terrain, walked_m: Sequence[Array]
    ):
        """What has been walked already, points (2,), is not told again by rays no better than its own."""
        corners = np.vstack([terrain.origin_m, terrain.to_metres(np.array(terrain.cost.shape)), transmitter_m])
        self._transmitter_m, self._cell_m = transmitter_m, radio.resolution_m
        self._low = corners.min(axis=0) - self._cell_m
        columns, rows = np.ceil((corners.max(axis=0) + 2 * self._cell_m - self._low) / self._cell_m).astype(int)
        row, column = np.mgrid[:rows, :columns]
        centres = self._low + (np.stack([column, row], axis=-1) + 0.5) * self._cell_m
        self._doubt = np.clip(1.0 + _levels(radio, centres) / SURE_LEVELS, 0.0, 1.0)
        self._is_wall = _levels(seen, centres) > Terrain.WALL_ABOVE
        self._held = np.zeros(self._doubt.size)
        if len(walked_m):
            self._held = self._told(np.array(walked_m))

    def of_path(self, points_m: Array) -> float:
        """Doubtful cells told, each by its best ray, in cells."""
        return float(np.maximum(self._told(points_m) - self._held, 0.0) @ self._doubt.ravel())

    def _told(self, points_m: Array) -> Array:
        """(cells,) how much the best ray to any of the points says of each cell, 0 to 1."""
        starts = np.tile(self._transmitter_m, (len(points_m), 1))
        ends = np.repeat(points_m, len(self._transmitter_m), axis=0)
        longest = float(np.linalg.norm(ends - starts, axis=1).max())
        share = np.linspace(0.0, 1.0, max(int(longest / self._cell_m), 1) + 1)
        on_ray = starts[:, None] + share[:, None] * (ends - starts)[:, None]  # (rays, samples, 2)
        cells = np.floor((on_ray - self._low) / self._cell_m).astype(int)
        rows = np.clip(cells[..., 1], 0, self._doubt.shape[0] - 1)
        columns = np.clip(cells[..., 0], 0, self._doubt.shape[1] - 1)
        walls = self._is_wall[rows, columns]
        runs = walls[:, 0].astype(int) + (walls[:, 1:] & ~walls[:, :-1]).sum(axis=1)
        met = np.maximum(np.linalg.norm(ends - starts, axis=1) / self._cell_m, 1.0)
        told = np.log(WALL_DENSITY / np.maximum(runs / met, 0.002)) / CLEAR_NATS
        best = np.zeros(self._doubt.size)
        flat = (rows * self._doubt.shape[1] + columns).ravel()
        np.maximum.at(best, flat, np.repeat(np.clip(told, 0.0, 1.0), len(share)))
        return best


def _levels(grid: GridMap, points_m: Array) -> Array:
    """Log-odds of a grid at points (..., 2); 0 outside."""
    cells = grid.cell_of(points_m)
    inside = np.all((cells >= 0) & (cells < grid.log_odds.shape), axis=-1)
    rows, columns = np.where(inside, cells[..., 0], 0), np.where(inside, cells[..., 1], 0)
    return np.where(inside, grid.log_odds[rows, columns], 0) if grid.log_odds.size else np.zeros(inside.shape)


def length_m(path_m: Array) -> float:
    """Length of a path (k, 2)."""
    return float(np.hypot(*np.diff(path_m, axis=0).T).sum())


def part_of_path(path_m: Array, limit_m: float) -> Array:
    """(k, 2) points every `PATH_STEP_M` from a path's start, at most so far; its last point is always there."""
    along = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(path_m, axis=0).T))])
    end = min(limit_m, along[-1])
    at = np.append(np.arange(0.0, end, PATH_STEP_M), end)
    return np.column_stack([np.interp(at, along, path_m[:, axis]) for axis in (0, 1)])
