"""Sign seeker: drives where it can be settled how its map and that of another robot fit together.

Robots that share no map verify where they are to each other as in Fox, Ko, Konolige, Limketkai, Schulz and Stewart
("Distributed multirobot exploration and mapping", Proc. IEEE 94(7), 2006): a hypothesis about the relative pose is
tested by going where it predicts something. Here a hypothesis is what pending loop closures say
(`Belief.hypotheses`), and what it predicts are the signs that the other group has read. While there is none, the robot
prefers frontiers where the access points are heard as the other group heard them: its floor is near there. All else is
MinPos.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.config import EnvConfig
from twc_env.planning import Disc, Plan, Terrain
from twc_env.records.messages import Belief

from ..shared.frontier_team import Frontiers
from ..shared.radio_memory import RadioMemory, apart_db
from ..teams.minpos import MinPos

SAME_SIGN_M = 2.0
"""A predicted sign within this distance of one that the robot's group has read tells nothing new."""
SEEN_M = 2.5
"""A predicted sign that a robot came this near to, and did not read, is given up."""
WAY_MAX_M = 25.0
"""Hypotheses about signs further away than this wait."""
METRES_PER_DB = 4.0
"""Way to the floor of the other group per dB by which fingerprints differ."""
AREA_MIN_M2 = 150.0
"""A merge is worth the smaller map: a robot with a smaller one only explores."""
DETOUR_MAX_M = 3.0
"""Only frontiers that are this much further away than the nearest are chosen by radio: the robot explores on."""
STAY_M = 2.0
"""What the frontier to which the robot drives is worth, so that it does not turn back and forth."""


class SignSeeker(MinPos):
    """With `is_aware=False`, the same without hypotheses and fingerprints: MinPos."""

    def __init__(self, config: EnvConfig, is_aware: bool = True):
        self._is_aware = is_aware
        super().__init__(config)

    def reset(self, seed: int, agents: Sequence[str]) -> None:
        """Discard all state."""
        super().reset(seed, agents)
        self._memory = RadioMemory(agents)
        self._in_vain: dict[str, list[tuple[tuple[int, int], Array]]] = {agent: [] for agent in agents}

    def act(self, beliefs: dict[str, Belief]) -> dict[str, Array]:
        """One command per robot; replans where necessary."""
        if self._is_aware and any(len(b.mates) + 1 < len(self.robots) for b in beliefs.values()):
            self._memory.note(beliefs)
        return super().act(beliefs)

    def best_plan(
        self, agent: str, beliefs: dict[str, Belief], terrain: Terrain, discs: list[Disc]
    ) -> tuple[Plan | None, str]:
        """The plan to a predicted sign on known floor, else to a frontier."""
        for place in self._predicted_m(agent, beliefs) if self._is_aware else ():
            plan = self.plan_to_place(terrain, agent, place, discs, 1.0)
            if plan is not None and plan.length_m <= WAY_MAX_M:
                return plan, "place"
        return super().best_plan(agent, beliefs, terrain, discs)

    def choose(self, agent: str, beliefs: dict[str, Belief], frontiers: Frontiers) -> int | None:
        """The frontier on the way to a predicted sign, or to where the other group's access points are heard."""
        if not self._is_aware:
            return super().choose(agent, beliefs, frontiers)
        for place in self._predicted_m(agent, beliefs):
            ways_m = frontiers.lengths_m + np.hypot(*(frontiers.places_m - place).T)
            if ways_m.min() <= WAY_MAX_M:
                return int(np.argmin(ways_m))
        others = [a for a, b in beliefs.items() if b.robot not in (beliefs[agent].robot, *beliefs[agent].mates)]
        theirs_dbm = self._memory.rssi_of_others_dbm(agent, others)
        grid = beliefs[agent].grid
        if len(theirs_dbm) and (grid.log_odds < 0).sum() * grid.resolution_m**2 >= AREA_MIN_M2:
            apart = apart_db(self._memory.rssi_dbm(agent), theirs_dbm)
            heard_m = self._memory.places_m(agent, beliefs)
            near = np.hypot(*np.moveaxis(frontiers.places_m[:, None] - heard_m, -1, 0)).argmin(axis=1)
            ways_m = frontiers.lengths_m + METRES_PER_DB * apart[near]
            current = self.current(agent, frontiers)
            if current is not None:
                ways_m[current] -= STAY_M
            ways_m[frontiers.lengths_m > frontiers.lengths_m.min() + DETOUR_MAX_M] = np.inf
            return int(np.argmin(ways_m))
        return super().choose(agent, beliefs, frontiers)

    def _predicted_m(self, agent: str, beliefs: dict[str, Belief]) -> list[Array]:
        """Positions (2,) of signs that only the other group has read, the nearest first."""
        belief, here = beliefs[agent], self.robots[agent].pose[:2]
        vain = self._in_vain[agent]
        map_id = belief.map_version, len(belief.mates)
        mine_m = np.array([sign.position_m for sign in belief.signs]).reshape(-1, 2)
        found = []
        for hypothesis in belief.hypotheses:
            for sign in hypothesis.signs:
                place = np.asarray(sign.position_m, float)
                if np.hypot(*(mine_m - place).T).min(initial=np.inf) < SAME_SIGN_M:
                    continue
                if np.hypot(*(here - place)) < SEEN_M:
                    vain.append((map_id, place))
                if all(known != map_id or np.hypot(*(place - tried)) >= SEEN_M for known, tried in vain):
                    found.append(place)
        return sorted(found, key=lambda place: float(np.hypot(*(place - here))))
