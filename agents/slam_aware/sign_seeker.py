"""Sign seeker: drives where it can be settled how its map and that of another robot fit together.

Robots that share no map verify where they are to each other as in Fox, Ko, Konolige, Limketkai, Schulz and Stewart
("Distributed multirobot exploration and mapping", Proc. IEEE 94(7), 2006): a hypothesis about the relative pose is
tested by going where it predicts something. Here a hypothesis is what pending loop closures say
(`Belief.hypotheses`), and what it predicts are the signs that only the other group has read. All else is MinPos.

Choosing frontiers by WiFi was tried and left out: preferring those where access points are heard as the other group
heard them brought the last merge forward, but cost more floor than that was worth.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.config import EnvConfig
from twc_env.planning import Disc, Plan, Terrain
from twc_env.records.messages import Belief

from ..shared.frontier_team import Frontiers
from ..teams.minpos import MinPos

SAME_SIGN_M = 2.0
"""A predicted sign within this distance of one that the robot's group has read tells nothing new."""
SEEN_M = 2.5
"""A predicted sign that a robot came this near to, and did not read, is given up."""
WAY_MAX_M = 25.0
"""Hypotheses about signs further away than this wait."""


class SignSeeker(MinPos):
    """With `is_aware=False`, the same without hypotheses: MinPos."""

    def __init__(self, config: EnvConfig, is_aware: bool = True):
        self._is_aware = is_aware
        super().__init__(config)

    def reset(self, seed: int, agents: Sequence[str]) -> None:
        """Discard all state."""
        super().reset(seed, agents)
        self._in_vain: dict[str, list[tuple[tuple[int, int], Array]]] = {agent: [] for agent in agents}

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
        """The frontier on the way to a predicted sign, else that of MinPos."""
        if not self._is_aware:
            return super().choose(agent, beliefs, frontiers)
        for place in self._predicted_m(agent, beliefs):
            ways_m = frontiers.lengths_m + np.hypot(*(frontiers.places_m - place).T)
            if ways_m.min() <= WAY_MAX_M:
                return int(np.argmin(ways_m))
        return super().choose(agent, beliefs, frontiers)

    def _predicted_m(self, agent: str, beliefs: dict[str, Belief]) -> list[Array]:
        """Positions (2,) of signs that only the other group has read, the nearest first."""
        belief, here = beliefs[agent], self.robots[agent].pose[:2]
        vain = self._in_vain[agent]
        map_id = belief.map_version, len(belief.teammates)
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
