"""Active mapping from radio: the shortest walk whose rays to the transmitters clear uncertain cells.

This is the active walk that inverse k-visibility leaves to future work. Needs `slam.k_visibility.enabled`. The whole
walk is planned over all floor that the robot has seen, and replanned after every straight part of it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.config import EnvConfig, robot_configs
from twc_env.planning import Drivers, PathFinder, Terrain, WalkGraph, as_action, covering_walk, walk_graph
from twc_env.records.geometry import travelled_m
from twc_env.records.messages import Belief

from ..shared.beginning import Beginning
from .ray_gain import RayGain, strays_m

SPACING_M = 0.25
"""Spacing of positions that the walk may visit."""
PRICES_M = (0.02, 0.05, 0.15)
"""Path length per cell that a detour may cost, in increasing order: the next is used if no walk is left."""
TRIES = 20_000
STRIDE_M, STRAY_M = 2.5, 0.14
"""Maximum length of the walk between two plans, and its maximum deviation from a straight line."""
PACE_M_S = 0.45
"""Maximum speed, so that rays are close to each other."""
FRONTIER_CELLS, FRONTIER_M = 8, 0.6
"""Value [cells] of each frontier cell, and the distance within which it counts as visited."""
GAIN_MIN_CELLS = 8
"""The survey ends if a walk would clear fewer cells."""
HUG = 0.8
"""Factor on the robot radius in planning; collisions are avoided by scans."""
HELD_UP_TICKS, HELD_UP_M = 5, 0.5
"""A robot within this distance of its goal that makes no progress for this many steps chooses another goal."""
IDLE_TICKS = 30
ARRIVAL_M = 0.08
"""Distance at which a goal is reached; small, because rays only clear floor up to the robot."""


class RadioWalk:
    """Each robot on its own: nearest frontiers until a transmitter is found, then the most informative walk."""

    def __init__(self, config: EnvConfig):
        self._own = [own.dynamics for own in robot_configs(config)]
        self._finder = PathFinder()
        self.reset(0, ())

    def reset(self, seed: int, agents: Sequence[str]) -> None:
        """Discard all state."""
        self._beginning = Beginning(agents)
        self._drivers = {agent: Drivers([own], self._finder) for agent, own in zip(agents, self._own, strict=False)}
        self._random = {agent: np.random.default_rng([seed, n]) for n, agent in enumerate(agents)}
        self._goals_m: dict[str, Array] = {}
        self._turns_m: dict[str, Array] = {agent: np.zeros((0, 2)) for agent in agents}
        self._given_up_m: dict[str, list[Array]] = {agent: [] for agent in agents}
        self._walked_m: dict[str, list[Array]] = {agent: [] for agent in agents}
        self._stretch_m: dict[str, Array] = {agent: np.zeros((0, 2)) for agent in agents}
        self._nearest: dict[str, tuple[float, int]] = {}
        self._idle = dict.fromkeys(agents, 0)

    def act(self, beliefs: dict[str, Belief]) -> dict[str, Array]:
        """Follow the chosen path, or choose a new one. Raises TwcError as `Beginning.check`."""
        self._beginning.check(beliefs)
        return {agent: self._drive(agent, belief) for agent, belief in beliefs.items()}

    def finished(self, beliefs: dict[str, Belief]) -> bool:
        """Whether no robot has found a worthwhile walk for a while."""
        return bool(beliefs) and all(self._idle[agent] >= IDLE_TICKS for agent in beliefs)

    def _drive(self, agent: str, belief: Belief) -> Array:
        own = self._own[belief.robot]
        driver, here, walked = self._drivers[agent], belief.pose_map_robot[:2], self._walked_m[agent]
        if not walked or math.dist(walked[-1], here) >= SPACING_M / 2:
            walked.append(np.array(here, float))
        status = driver.status(0)
        if status == "failed" or (status == "driving" and self._is_held_up(agent, here)):
            self._given_up_m[agent].append(self._goals_m[agent])
            driver.stop(0)
        if driver.status(0) == "arrived":  # cells that cannot be cleared from here are not tried again
            walked += list(self._stretch_m[agent])
        if driver.status(0) != "driving":
            goal = self._choose(agent, belief)
            self._idle[agent] = 0 if goal is not None else self._idle[agent] + 1
            if goal is None:
                return as_action(0.0, 0.6 * own.turn_rate_max_rad_s, own)
            self._goals_m[agent], self._nearest[agent] = goal, (math.inf, 0)
            driver.start(0, goal, belief, arrival_m=ARRIVAL_M)
        speed, turn_rate = driver.commands([belief], self._terrain_of)[0].tolist()
        return as_action(min(speed, PACE_M_S), turn_rate, own)

    def _is_held_up(self, agent: str, here: Array) -> bool:
        """Whether the robot, near its goal, makes no progress, as when the wall is closer than in the map."""
        away, (nearest, ticks) = math.dist(here, self._goals_m[agent]), self._nearest[agent]
        self._nearest[agent] = (away, 0) if away < nearest - 0.02 else (nearest, ticks + 1)
        return ticks >= HELD_UP_TICKS and away < HELD_UP_M

    def _terrain_of(self, belief: Belief, squeeze: float) -> Terrain:
        """Terrain without extra cost near walls, where rays cross most floor."""
        terrain = Terrain.of(belief, squeeze * HUG * self._own[belief.robot].robot_radius_m)
        terrain.cost = np.where(terrain.cost > 0, 2, 0).astype(terrain.cost.dtype)
        return terrain

    def _choose(self, agent: str, belief: Belief) -> Array | None:
        """(2,) the next goal; None if no walk is worthwhile."""
        terrain, here = self._terrain_of(belief, 1.0), belief.pose_map_robot[:2]
        if belief.radio_map is None or len(belief.transmitter_m) == 0:
            plan = self._finder.cheapest(terrain, here, terrain.labels, np.zeros(len(terrain.frontier_sizes)))
            return None if plan is None else plan.path_m[-1]
        graph = walk_graph(terrain, here, SPACING_M)
        given_up = np.array(self._given_up_m[agent]).reshape(-1, 2)
        is_barred = (np.linalg.norm(graph.places_m[:, None] - given_up, axis=2) < SPACING_M / 2).any(axis=1)
        held = np.array(self._walked_m[agent])
        cleared = np.hstack([
            RayGain(belief.radio_map, belief.grid, belief.transmitter_m, SPACING_M).cells_cleared(graph.places_m, held),
            _frontiers_met(terrain, graph.places_m, held),
        ])  # fmt: skip
        cleared[is_barred] = False
        cleared[:, cleared[np.linalg.norm(graph.places_m - here, axis=1) <= ARRIVAL_M].any(axis=0)] = False
        begin = [0, *(int(np.argmin(np.linalg.norm(graph.places_m - at, axis=1))) for at in self._turns_m[agent])]
        for price_m in PRICES_M:
            draws = self._random[agent].random((TRIES, 4))
            turns, cells = covering_walk(graph, cleared, price_m, np.array(begin), draws)
            if len(turns) > 1 and cells >= GAIN_MIN_CELLS:
                return self._first_stretch(agent, graph, turns)
        return None

    def _first_stretch(self, agent: str, graph: WalkGraph, turns: Array) -> Array:
        """(2,) the end of the first straight part of the walk; the rest is kept for the next plan."""
        way_m = graph.places_m[graph.way(turns)]
        along_m = travelled_m(way_m)
        last = int(np.argmax(np.linalg.norm(way_m - way_m[0], axis=1) > ARRIVAL_M))
        while last + 1 < len(way_m) and along_m[last + 1] <= STRIDE_M and strays_m(way_m[: last + 2]) <= STRAY_M:
            last += 1
        lengths_m = graph.lengths_m[turns[:-1], turns[1:]]
        self._turns_m[agent] = graph.places_m[turns[1:][np.cumsum(lengths_m) > along_m[last] + 1e-6]]
        self._stretch_m[agent] = way_m[: last + 1]
        return way_m[last]


def _frontiers_met(terrain: Terrain, places_m: Array, walked_m: Array) -> Array:
    """(places, k) bool: whether a position is near a frontier cell that was not near the walk so far."""
    edge_m = terrain.to_metres(np.argwhere(terrain.labels > 0) + 0.5)
    edge_m = edge_m[(np.linalg.norm(edge_m[:, None] - walked_m, axis=2) >= FRONTIER_M + 2 * ARRIVAL_M).all(axis=1)]
    met = np.linalg.norm(places_m[:, None] - edge_m, axis=2) < FRONTIER_M
    return np.repeat(met, FRONTIER_CELLS, axis=1)
