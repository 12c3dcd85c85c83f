"""What teams of frontier explorers share: the list of frontiers, what teammates said, and patrols when nothing is left.

Each robot decides by itself, from its own belief and from what teammates told it. Two robots tell each other their
goals while they are in contact and use maps that begin in the same frame (that of the lowest-numbered robot of the
group).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.config import EnvConfig
from twc_env.planning import Disc, PathFinder, Plan, Terrain, can_tell_places
from twc_env.records.messages import Belief

from .explorer import Explorer
from .explorer_state import ExplorerConfig
from .tours import Tours

UNREACHABLE_M = 1e4
"""Path length to what cannot be reached."""
MEMORY_S = 30.0
"""How long a goal that a teammate told is remembered after the last contact."""


@dataclass(eq=False)
class Frontiers:
    """The frontiers of one robot's map that it may choose from; arrays have one entry per frontier."""

    belief: Belief
    terrain: Terrain
    labels: Array
    """(k,) labels in the terrain."""
    lengths_m: Array
    """(k,) path length from this robot."""
    places_m: Array
    """(k, 2) the nearest cell of each."""
    finder: PathFinder

    @property
    def centres_m(self) -> Array:
        """(k, 2) mean position of each."""
        return self.terrain.frontier_centres_m[self.labels]

    @property
    def sizes_m(self) -> Array:
        """(k,) number of cells times their size."""
        return self.terrain.frontier_sizes[self.labels] * self.terrain.resolution_m

    @cached_property
    def teammate_lengths_m(self) -> Array:
        """(teammates, k) path length from each teammate, in the order of `Belief.teammates`."""
        lengths_m = np.full((len(self.belief.teammates), len(self.labels)), UNREACHABLE_M)
        for row, pose in zip(lengths_m, self.belief.teammates.values(), strict=True):
            found = self.finder.lengths_to_frontiers_m(self.terrain, np.asarray(pose, float)[:2])
            if found is not None:
                row[:] = np.minimum(found[self.labels], UNREACHABLE_M)
        return lengths_m

    @property
    def all_lengths_m(self) -> Array:
        """(1 + teammates, k) path length from this robot, then from each teammate."""
        return np.vstack([self.lengths_m, self.teammate_lengths_m])


class FrontierTeam(Explorer):
    """Each robot goes to the frontier that `choose` of a subclass picks; without one, it patrols."""

    keeps_goal = True
    """Whether a robot decides anew only when its frontier is mapped or given up, rather than at each replanning."""

    told_kinds: tuple[str, ...] = ("frontier",)
    """Kinds of goals that robots tell each other."""

    def __init__(self, config: EnvConfig):
        super().__init__(config, ExplorerConfig(tour_sign_bonus_m=0.0))
        self.config = config
        self.ways = PathFinder()
        self._tours = Tours(self.finder, self.explorer, config.dynamics.time_step_s)

    def reset(self, seed: int, agents: Sequence[str]) -> None:
        """Discard all state."""
        super().reset(seed, agents)
        self._told: dict[str, dict[int, tuple[int, Array]]] = {agent: {} for agent in agents}

    def act(self, beliefs: dict[str, Belief]) -> dict[str, Array]:
        """One command per robot; replans where necessary. Raises TwcError as `Beginning.check`."""
        self.beginning.check(beliefs)
        for agent in beliefs:
            self._listen(agent, beliefs)
        return super().act(beliefs)

    def best_plan(
        self, agent: str, beliefs: dict[str, Belief], terrain: Terrain, discs: list[Disc]
    ) -> tuple[Plan | None, str]:
        """The plan to the chosen frontier, else of a patrol to the place not visited for longest."""
        frontiers = self.frontiers(agent, beliefs, terrain, discs)
        if len(frontiers.labels):
            chosen = self.current(agent, frontiers) if self.keeps_goal else None
            chosen = self.choose(agent, beliefs, frontiers) if chosen is None else chosen
            plan = None if chosen is None else self.plan_to(terrain, agent, frontiers.labels[[chosen]], discs)
            if plan is not None:
                return plan, "frontier"
        return self.patrol(agent, beliefs, terrain, discs)

    def choose(self, agent: str, beliefs: dict[str, Belief], frontiers: Frontiers) -> int | None:
        """Index of the frontier to go to; None for none of them. The nearest one here."""
        return int(np.argmin(frontiers.lengths_m))

    def patrol(
        self, agent: str, beliefs: dict[str, Belief], terrain: Terrain, discs: list[Disc]
    ) -> tuple[Plan | None, str]:
        """The plan to the place not visited for longest (idleness: Machado, Ramalho, Zucker and Drogoul 2002)."""
        robot, belief = self.robots[agent], beliefs[agent]
        plan = self._tours.plan(robot, belief, terrain, discs, self.banned(robot, belief, {}), self.random)
        return plan, "tour" if plan is not None else ""

    def frontiers(self, agent: str, beliefs: dict[str, Belief], terrain: Terrain, discs: list[Disc]) -> Frontiers:
        """The reachable frontiers that have not failed recently; small ones only if there are no others."""
        robot, belief, explorer = self.robots[agent], beliefs[agent], self.explorer
        sizes = terrain.frontier_sizes
        none = Frontiers(belief, terrain, np.zeros(0, int), np.zeros(0), np.zeros((0, 2)), self.ways)
        if len(sizes) < 2:
            return none
        self.finder.spread(terrain, robot.pose[:2], discs)
        lengths_m, places_m = self.finder.nearest_of_labels(terrain, terrain.labels, len(sizes) - 1)
        is_usable = np.isfinite(lengths_m) & (sizes >= explorer.frontier_cells_last)
        is_usable[0] = False
        for place in self.banned(robot, belief, {}):
            is_usable[np.hypot(*(places_m - place).T) < explorer.failed_radius_m] = False
        is_large = is_usable & (sizes >= explorer.frontier_cells_min)
        labels = np.flatnonzero(is_large if is_large.any() else is_usable)
        return Frontiers(belief, terrain, labels, lengths_m[labels], places_m[labels], self.ways)

    def plan_to(self, terrain: Terrain, agent: str, labels: Array, discs: list[Disc]) -> Plan | None:
        """The path to the nearest of these labels of the terrain."""
        penalty = np.full(len(terrain.frontier_sizes), np.inf)
        penalty[labels] = 0.0
        return self.finder.cheapest(terrain, self.robots[agent].pose[:2], terrain.labels, penalty, discs)

    def plan_to_place(self, terrain: Terrain, agent: str, place_m: Array, discs: list[Disc], reach_m: float = 0.5):
        """The path to the open floor within `reach_m` of a place; None if there is none."""
        labels = terrain.no_labels()
        part = terrain.patch(place_m, reach_m)
        labels[part][terrain.cost[part] > 0] = 1
        return self.finder.cheapest(terrain, self.robots[agent].pose[:2], labels, np.zeros(2), discs)

    def heard_goals_m(self, agent: str, beliefs: dict[str, Belief]) -> dict[int, Array]:
        """Teammate -> frontier goal (2,), as it last told."""
        oldest = beliefs[agent].step - MEMORY_S / self.dynamics.time_step_s
        return {teammate: goal for teammate, (step, goal) in self._told[agent].items() if step >= oldest}

    def teammates_in_contact(self, agent: str, beliefs: dict[str, Belief]) -> list[str]:
        """Teammates that can be talked to now about places: in contact, and with a map that begins in the same
        frame."""
        mine = beliefs[agent]
        if not mine.teammates:
            return []
        return [other for other, theirs in beliefs.items() if can_tell_places(theirs, mine)]

    def current(self, agent: str, frontiers: Frontiers) -> int | None:
        """Index of the frontier to which the robot drives; None if it is gone, or there is none."""
        robot = self.robots[agent]
        if robot.goal_kind != "frontier":
            return None
        label = frontiers.terrain.label_near(robot.goal_m, 0.4)
        found = np.flatnonzero(frontiers.labels == label)
        return int(found[0]) if label and len(found) else None

    def _listen(self, agent: str, beliefs: dict[str, Belief]) -> None:
        """Note the goals of teammates in contact; those told before the map jumped are forgotten."""
        told, belief = self._told[agent], beliefs[agent]
        if (belief.map_version, len(belief.teammates)) != self.robots[agent].map_id:
            told.clear()
        for other in self.teammates_in_contact(agent, beliefs):
            number, robot = beliefs[other].robot, self.robots[other]
            told.pop(number, None)
            if robot.goal_kind in self.told_kinds:
                told[number] = belief.step, robot.goal_m.copy()
