"""Walk where the radio will tell most: the shortest walk whose rays to the transmitters clear what is doubtful.

The active walk that inverse k-visibility leaves to future work. Needs `slam.k_visibility.enabled`. The walk is planned
whole, over all floor that the robot has seen, and anew after every straight stretch of it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray as Array

from agents.ray_gain import RayGain
from twc_env.config import EnvConfig
from twc_env.geometry import travelled_m
from twc_env.messages import Belief
from twc_env.planning import Driver, PathFinder, Terrain, WalkGraph, as_action, covering_walk, walk_graph

SPACING_M = 0.25
"""Between places that the walk may visit."""
PRICES_M = (0.02, 0.05, 0.15)
"""A cell is worth so much way, at first and when nothing is worth that much any more."""
TRIES = 20_000
STRIDE_M, STRAY_M = 2.5, 0.14
"""So much of the walk is walked before it is planned anew, while a straight line strays no further from it."""
PACE_M_S = 0.45
"""Walked no faster, so that rays stand close."""
FRONTIER_CELLS, FRONTIER_M = 8, 0.6
"""Being so near to the edge of what is known is worth so many cells for each cell of that edge."""
GAIN_MIN_CELLS = 8
"""Where a walk promises less, it is over."""
HUG = 0.8
"""Places are taken as if robots were so many times as wide; scans keep them from touching what is nearer."""
HELD_UP_TICKS, HELD_UP_M = 5, 0.5
"""A robot that came no nearer to its goal in this time, so near to it, goes elsewhere."""
IDLE_TICKS = 30
ARRIVAL_M = 0.08
"""Corners of rooms are walked into: a ray clears floor no further than the robot goes."""


class RadioWalk:
    """Every robot for itself: nearest frontiers until a transmitter is found, then the walk that tells most."""

    def __init__(self, config: EnvConfig):
        self._dynamics = config.dynamics
        self._finder = PathFinder()
        self.reset(0, ())

    def reset(self, seed: int, agents: Sequence[str]) -> None:
        """Forget everything."""
        self._drivers = {agent: Driver(self._dynamics, self._finder) for agent in agents}
        self._random = {agent: np.random.default_rng([seed, n]) for n, agent in enumerate(agents)}
        self._goals_m: dict[str, Array] = {}
        self._turns_m: dict[str, Array] = {agent: np.zeros((0, 2)) for agent in agents}
        self._given_up_m: dict[str, list[Array]] = {agent: [] for agent in agents}
        self._walked_m: dict[str, list[Array]] = {agent: [] for agent in agents}
        self._stretch_m: dict[str, Array] = {agent: np.zeros((0, 2)) for agent in agents}
        self._nearest: dict[str, tuple[float, int]] = {}
        self._idle = dict.fromkeys(agents, 0)

    def act(self, beliefs: dict[str, Belief]) -> dict[str, Array]:
        """On along the chosen path, or a new choice."""
        return {agent: self._drive(agent, belief) for agent, belief in beliefs.items()}

    def finished(self, beliefs: dict[str, Belief]) -> bool:
        """Whether no robot has found anything worth walking for a while."""
        return bool(beliefs) and all(self._idle[agent] >= IDLE_TICKS for agent in beliefs)

    def _drive(self, agent: str, belief: Belief) -> Array:
        driver, here, walked = self._drivers[agent], belief.pose_map_robot[:2], self._walked_m[agent]
        if not walked or math.dist(walked[-1], here) >= SPACING_M / 2:
            walked.append(np.array(here, float))
        if driver.status == "failed" or (driver.status == "driving" and self._is_held_up(agent, here)):
            self._given_up_m[agent].append(self._goals_m[agent])
            driver.stop()
        if driver.status == "arrived":  # what is told no nearer than a robot gets to walls is not tried for again
            walked += list(self._stretch_m[agent])
        if driver.status != "driving":
            goal = self._choose(agent, belief)
            self._idle[agent] = 0 if goal is not None else self._idle[agent] + 1
            if goal is None:
                return as_action(0.0, 0.6 * self._dynamics.turn_rate_max_rad_s, self._dynamics)
            self._goals_m[agent], self._nearest[agent] = goal, (math.inf, 0)
            driver.start(goal, belief, arrival_m=ARRIVAL_M)
        speed, turn_rate = driver.command(belief, self._terrain_of)
        return as_action(min(speed, PACE_M_S), turn_rate, self._dynamics)

    def _is_held_up(self, agent: str, here: Array) -> bool:
        """Whether the robot, near its goal, comes no nearer: the wall is nearer than the map has it."""
        away, (nearest, ticks) = math.dist(here, self._goals_m[agent]), self._nearest[agent]
        self._nearest[agent] = (away, 0) if away < nearest - 0.02 else (nearest, ticks + 1)
        return ticks >= HELD_UP_TICKS and away < HELD_UP_M

    def _terrain_of(self, belief: Belief, squeeze: float) -> Terrain:
        """Floor near walls costs no more: rays to there cross most floor."""
        terrain = Terrain.of(belief, squeeze * HUG * self._dynamics.robot_radius_m)
        terrain.cost = np.where(terrain.cost > 0, 2, 0).astype(terrain.cost.dtype)
        return terrain

    def _choose(self, agent: str, belief: Belief) -> Array | None:
        """(2,) where to go next; None when nothing promises enough."""
        terrain, here = self._terrain_of(belief, 1.0), belief.pose_map_robot[:2]
        if belief.radio_map is None or len(belief.transmitter_m) == 0:
            plan = self._finder.cheapest(terrain, here, terrain.labels, np.zeros(len(terrain.frontier_sizes)))
            return None if plan is None else plan.path_m[-1]
        graph = walk_graph(terrain, here, SPACING_M)
        given_up = np.array(self._given_up_m[agent]).reshape(-1, 2)
        is_barred = (np.linalg.norm(graph.places_m[:, None] - given_up, axis=2) < SPACING_M / 2).any(axis=1)
        held = np.array(self._walked_m[agent])
        told = np.hstack([
            RayGain(belief.radio_map, belief.grid, belief.transmitter_m, SPACING_M).told(graph.places_m, held),
            _frontiers_met(terrain, graph.places_m, held),
        ])  # fmt: skip
        told[is_barred] = False
        told[:, told[np.linalg.norm(graph.places_m - here, axis=1) <= ARRIVAL_M].any(axis=0)] = False
        begin = [0, *(int(np.argmin(np.linalg.norm(graph.places_m - at, axis=1))) for at in self._turns_m[agent])]
        for price_m in PRICES_M:
            draws = self._random[agent].random((TRIES, 4))
            turns, cells = covering_walk(graph, told, price_m, np.array(begin), draws)
            if len(turns) > 1 and cells >= GAIN_MIN_CELLS:
                return self._first_stretch(agent, graph, turns)
        return None

    def _first_stretch(self, agent: str, graph: WalkGraph, turns: Array) -> Array:
        """(2,) the end of the walk's first straight stretch; what comes after it is kept for the next plan."""
        way_m = graph.places_m[graph.way(turns)]
        along_m = travelled_m(way_m)
        last = int(np.argmax(np.linalg.norm(way_m - way_m[0], axis=1) > ARRIVAL_M))
        while last + 1 < len(way_m) and along_m[last + 1] <= STRIDE_M and _strays_m(way_m[: last + 2]) <= STRAY_M:
            last += 1
        lengths_m = graph.lengths_m[turns[:-1], turns[1:]]
        self._turns_m[agent] = graph.places_m[turns[1:][np.cumsum(lengths_m) > along_m[last] + 1e-6]]
        self._stretch_m[agent] = way_m[: last + 1]
        return way_m[last]


def _frontiers_met(terrain: Terrain, places_m: Array, walked_m: Array) -> Array:
    """(places, k) whether each place is near each piece of the edge of what is known that was not near before."""
    rows, columns = np.nonzero(terrain.labels > 0)
    edge_m = terrain.to_metres(np.column_stack([rows, columns]) + 0.5)
    edge_m = edge_m[(np.linalg.norm(edge_m[:, None] - walked_m, axis=2) >= FRONTIER_M + 2 * ARRIVAL_M).all(axis=1)]
    met = np.linalg.norm(places_m[:, None] - edge_m, axis=2) < FRONTIER_M
    return np.repeat(met, FRONTIER_CELLS, axis=1)


def _strays_m(way_m: Array) -> float:
    """How far the points between (k, 2) lie from the straight line between the first and the last."""
    along = way_m[-1] - way_m[0]
    length = float(np.hypot(*along))
    if length < 1e-9:
        return math.inf
    apart = way_m[1:-1] - way_m[0]
    return float(np.abs(apart[:, 0] * along[1] - apart[:, 1] * along[0]).max(initial=0.0)) / length
