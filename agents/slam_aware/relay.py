"""Relay: the robots of a group explore only where they stay in radio range of each other.

Rooker and Birk ("Multi-robot exploration under the constraints of wireless networking", Control Engineering Practice
15(4), 2007) choose moves that do not break the network. Here the links form a chain of robots by their numbers: a
robot takes the frontier of its lowest MinPos rank among those from which it would reach one of the robots that it
hears, as it estimates from range, walls of its map and what the robots said about their goals. If no frontier is in
range, it is a relay: it takes the frontier next to where that robot goes. With a central mapper, which is reached
from everywhere, this is MinPos.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.config import EnvConfig, LinkConfig
from twc_env.planning import WALL, Disc, Plan, Terrain
from twc_env.records.messages import Belief

from ..shared.frontier_team import Frontiers
from ..teams.minpos import MinPos

MARGIN = 0.85
"""Share of the range that is counted on."""
LOST_S = 3.0
"""After this time without contact, a robot drives back to the last known position of the robot that it follows."""
GIVE_UP_S = 6.0
"""After this time it explores on its own."""
THERE_M = 2.0
"""Within this way of that position, it goes on exploring."""


class Relay(MinPos):
    """Without the range it is MinPos, its blind twin."""

    def __init__(self, config: EnvConfig):
        self._link = config.link
        self._is_peer = config.link.topology == "peer"
        super().__init__(config)

    def best_plan(
        self, agent: str, beliefs: dict[str, Belief], terrain: Terrain, discs: list[Disc]
    ) -> tuple[Plan | None, str]:
        """The plan to a frontier; back to the robot that is followed while that is not heard."""
        leader = self._leader(agent, beliefs)
        if leader is None:
            return super().best_plan(agent, beliefs, terrain, discs)
        belief, tick_s = beliefs[agent], self.dynamics.time_step_s
        silent_s = (belief.step - belief.contact_steps.get(leader, -1)) * tick_s
        if silent_s > LOST_S:
            plan = self.plan_to_place(terrain, agent, np.asarray(belief.teammates[leader][:2], float), discs, 1.0)
            if plan is not None and plan.length_m > THERE_M:
                return plan, "place"
        return super().best_plan(agent, beliefs, terrain, discs)

    def choose(self, agent: str, beliefs: dict[str, Belief], frontiers: Frontiers) -> int | None:
        """The frontier of the lowest rank among those in range of a teammate, else the one nearest to the leader."""
        leader = self._leader(agent, beliefs)
        if leader is None:
            return super().choose(agent, beliefs, frontiers)
        goals_m = self.heard_goals_m(agent, beliefs)
        heard = [beliefs[teammate].robot for teammate in self.teammates_in_contact(agent, beliefs)]
        anchors_m = [goals_m.get(teammate, beliefs[agent].teammates[teammate][:2]) for teammate in {leader, *heard}]
        is_near = np.any([in_range(frontiers.terrain, frontiers.places_m, at, self._link) for at in anchors_m], axis=0)
        if not is_near.any():
            at = goals_m.get(leader, beliefs[agent].teammates[leader][:2])
            return int(np.argmin(np.hypot(*(frontiers.places_m - at).T)))
        rank = (frontiers.teammate_lengths_m < frontiers.lengths_m).sum(axis=0)
        among = np.flatnonzero(is_near)
        return int(among[np.lexsort((frontiers.lengths_m[among], rank[among]))[0]])

    def _leader(self, agent: str, beliefs: dict[str, Belief]) -> int | None:
        """The teammate with a lower number that was heard last; None if the robot is free to go anywhere."""
        belief = beliefs[agent]
        heard = [
            (belief.contact_steps.get(teammate, -1), -teammate)
            for teammate in belief.teammates
            if teammate < belief.robot
        ]
        if not self._is_peer or not heard:
            return None
        step, number = max(heard)
        return None if (belief.step - step) * self.dynamics.time_step_s > GIVE_UP_S else -number


def in_range(terrain: Terrain, places_m: Array, other_m: Array, link: LinkConfig) -> Array:
    """(k,) bool: whether a link from each of places_m (k, 2) to a point is likely, by the walls on the map between."""
    apart_m = np.hypot(*(places_m - other_m).T)
    samples = max(2, int(2 * apart_m.max(initial=0.0) / terrain.resolution_m))
    share = np.linspace(0.0, 1.0, samples)[:, None, None]
    cells = np.floor(terrain.to_cells(places_m + share * (other_m - places_m))).astype(int)  # (samples, k, 2)
    rows, columns = np.moveaxis(np.clip(cells, 0, np.array(terrain.kind.shape) - 1), -1, 0)
    is_wall = terrain.kind[rows, columns] == WALL
    walls = (is_wall[1:] & ~is_wall[:-1]).sum(axis=0)
    return apart_m + link.wall_range_m * walls <= MARGIN * link.range_max_m


def links_between(terrain: Terrain, places_m: Array, link: LinkConfig) -> Array:
    """(places, places) bool: `in_range` of each of places_m (k, 2) and each other, either way."""
    links = np.eye(len(places_m), dtype=bool)
    for place, here in enumerate(places_m):
        near = np.flatnonzero(np.hypot(*(places_m - here).T) <= link.range_max_m)
        links[place, near] = in_range(terrain, places_m[near], here, link)
    return links | links.T
