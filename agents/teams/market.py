"""A market for goals (Zlot, Stentz, Dias and Thayer, "Multi-robot exploration controlled by a market economy", ICRA 2002).

Every robot holds a tour of goals, offers each of its goals to the mates that it hears, and sells it to the one whose
tour it lengthens least, if that is less than what it saves. Robots without contact keep their goals, so the team works
without a central auctioneer and whatever the state of the links. New goals are the centres of frontiers (greedy
exploration in the paper); a robot that finds one owns it unless a mate in contact does.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.planning import Disc, Plan, Terrain
from twc_env.records.messages import Belief

from ..shared.frontier_team import Frontiers, FrontierTeam

SAME_M = 1.5
"""Goals nearer to each other than this are the same."""


class Market(FrontierTeam):
    """Goals are traded at each replanning; a robot drives to the first goal of its tour."""

    keeps_goal = False

    def reset(self, seed: int, agents: Sequence[str]) -> None:
        """Discard all state."""
        super().reset(seed, agents)
        self._tour_m: dict[str, Array] = {agent: np.zeros((0, 2)) for agent in agents}

    def choose(self, agent: str, beliefs: dict[str, Belief], frontiers: Frontiers) -> int | None:
        """The frontier of the first goal of the robot's tour, after trading."""
        others = self.mates_in_contact(agent, beliefs)
        self._update_tour(agent, others, frontiers)
        for mate in others:
            self._sell(agent, mate, beliefs)
        tour_m = self._tour_m[agent]
        if not len(tour_m):  # it sold everything: it helps with what is nearest
            return int(np.argmin(frontiers.lengths_m))
        return int(np.argmin(np.hypot(*(frontiers.centres_m - tour_m[0]).T)))

    def best_plan(
        self, agent: str, beliefs: dict[str, Belief], terrain: Terrain, discs: list[Disc]
    ) -> tuple[Plan | None, str]:
        """The plan to the first goal; on a patrol the robot owns nothing."""
        plan, kind = super().best_plan(agent, beliefs, terrain, discs)
        if kind != "frontier":
            self._tour_m[agent] = np.zeros((0, 2))
        return plan, kind

    def _update_tour(self, agent: str, others: list[str], frontiers: Frontiers) -> None:
        """Drop goals whose frontier is gone, and insert frontiers that nobody in contact owns."""
        centres_m = frontiers.centres_m
        owned_m = np.vstack([np.zeros((0, 2)), *(self._tour_m[mate] for mate in others)])
        kept = [
            g for g in self._tour_m[agent] if _nearest_m(g, centres_m) < SAME_M and _nearest_m(g, owned_m) >= SAME_M
        ]
        tour_m, here = np.array(kept).reshape(-1, 2), self.robots[agent].pose[:2]
        for k in np.argsort(frontiers.lengths_m, kind="stable"):
            if _nearest_m(centres_m[k], tour_m) >= SAME_M and _nearest_m(centres_m[k], owned_m) >= SAME_M:
                tour_m = _inserted(here, tour_m, centres_m[k])[0]
        if len(tour_m):  # the nearest goal first: it is the one with the greatest profit
            goals = [int(np.argmin(np.hypot(*(centres_m - goal_m).T))) for goal_m in tour_m]
            ways_m = frontiers.lengths_m[goals]
            ways_m[np.array(goals) == self.current(agent, frontiers)] -= self.explorer.change_penalty_m
            first = int(np.argmin(ways_m))
            tour_m = np.vstack([tour_m[[first]], np.delete(tour_m, first, axis=0)])
        self._tour_m[agent] = tour_m

    def _sell(self, agent: str, mate: str, beliefs: dict[str, Belief]) -> None:
        """Auction each goal but the first, to which the robot drives, to one mate that would go less out of its way."""
        here, there = self.robots[agent].pose[:2], beliefs[mate].pose_map_robot[:2]
        for goal_m in self._tour_m[agent][1:]:
            mine_m, theirs_m = self._tour_m[agent], self._tour_m[mate]
            rest_m = mine_m[(mine_m != goal_m).any(axis=1)]
            tour_m, added_m = _inserted(there, theirs_m, goal_m)
            if added_m < _length_m(here, mine_m) - _length_m(here, rest_m):
                self._tour_m[agent], self._tour_m[mate] = rest_m, tour_m

    def _listen(self, agent: str, beliefs: dict[str, Belief]) -> None:
        belief = beliefs[agent]
        if (belief.map_version, len(belief.mates)) != self.robots[agent].map_id:  # goals are in the former frame
            self._tour_m[agent] = np.zeros((0, 2))
        super()._listen(agent, beliefs)


def _nearest_m(place_m: Array, others_m: Array) -> float:
    return float(np.hypot(*(others_m - place_m).T).min(initial=np.inf))


def _length_m(start_m: Array, tour_m: Array) -> float:
    return float(np.hypot(*np.diff(np.vstack([start_m, tour_m]), axis=0).T).sum())


def _inserted(start_m: Array, tour_m: Array, goal_m: Array) -> tuple[Array, float]:
    """The tour with a goal inserted after its first one, where it adds least, and what it adds [m]."""
    tours = [np.insert(tour_m, k, goal_m, axis=0) for k in range(min(1, len(tour_m)), len(tour_m) + 1)]
    lengths_m = [_length_m(start_m, tour) for tour in tours]
    best = int(np.argmin(lengths_m))
    return tours[best], lengths_m[best] - _length_m(start_m, tour_m)
