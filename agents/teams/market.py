"""A market for goals (Zlot, Stentz, Dias and Thayer 2002).

"Multi-robot exploration controlled by a market economy", ICRA 2002.
The frontiers are auctioned among the robots of a group that hear each other. In each round every robot bids for the
goal that it can add to its tour at the least price, and the cheapest bid wins, until all are sold: sequential single-
item auctions (Lagoudakis et al., "Auction-based multi-robot routing", RSS 2005), whose bidding rule for the least
time of the team is the length of the whole tour. A robot drives to the first goal of its tour. What a teammate out of
contact said it drives to is not auctioned. There is no auctioneer: whoever is out of contact explores on its own.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.records.messages import Belief

from ..shared.frontier_team import Frontiers, FrontierTeam

SAME_M = 1.5
"""A frontier within this distance of what a teammate drives to is that teammate's."""
GOALS_MAX = 30
"""Only so many of the nearest frontiers are auctioned."""


class Market(FrontierTeam):
    """The auction is held anew at each replanning, as the map grows."""

    keeps_goal = False

    def choose(self, agent: str, beliefs: dict[str, Belief], frontiers: Frontiers) -> int | None:
        """The first goal of the robot's tour; the nearest frontier if it won nothing."""
        belief = beliefs[agent]
        hearing = [beliefs[teammate].robot for teammate in self.teammates_in_contact(agent, beliefs)]
        is_open = np.ones(len(frontiers.labels), bool)
        for teammate, goal_m in self.heard_goals_m(agent, beliefs).items():
            if teammate not in hearing:
                is_open &= np.hypot(*(frontiers.centres_m - goal_m).T) >= SAME_M
        rows = [0, *(1 + k for k, teammate in enumerate(belief.teammates) if teammate in hearing)]
        lengths_m = (frontiers.all_lengths_m if len(rows) > 1 else frontiers.lengths_m[None])[rows]
        goals = np.flatnonzero(is_open)
        goals = goals[np.argsort(lengths_m[:, goals].min(axis=0), kind="stable")][:GOALS_MAX]
        if not len(goals):
            return int(np.argmin(frontiers.lengths_m))
        current = self.current(agent, frontiers)
        if current is not None:
            lengths_m[0, current] = max(lengths_m[0, current] - self.explorer.change_penalty_m, 0.0)
        tour = auctioned(lengths_m[:, goals], frontiers.centres_m[goals])[0]
        return int(goals[tour[0]]) if tour else int(np.argmin(frontiers.lengths_m))


def auctioned(lengths_m: Array, places_m: Array) -> list[list[int]]:
    """The tour of each robot: indices of goals in the order of visits.

    lengths_m (robots, goals): path lengths to the goals; places_m (goals, 2): straight lines are taken between goals.
    """
    apart_m = np.hypot(*(places_m[:, None] - places_m).T)
    tours: list[list[int]] = [[] for _ in lengths_m]
    unsold = list(range(len(places_m)))
    bids = [_cheapest(tour, own_m, apart_m, unsold) for tour, own_m in zip(tours, lengths_m, strict=True)]
    while unsold:
        winner = min(range(len(bids)), key=lambda robot: bids[robot][0])
        _, tours[winner], sold = bids[winner]
        unsold.remove(sold)
        for robot, (_, _, goal) in enumerate(bids):  # others bid again what they did
            if unsold and (robot == winner or goal == sold):
                bids[robot] = _cheapest(tours[robot], lengths_m[robot], apart_m, unsold)
    return tours


def _cheapest(tour: list[int], lengths_m: Array, apart_m: Array, unsold: list[int]) -> tuple[float, list[int], int]:
    """A robot's bid: length of its tour [m] with the goal that lengthens it least, that tour, and the goal."""
    ways_m = apart_m[np.ix_(tour, unsold)]
    behind_m = np.vstack([lengths_m[unsold], ways_m])  # (places in the tour, goals)
    ahead_m = np.vstack([ways_m, np.zeros(len(unsold))])
    skipped_m = np.array([*lengths_m[tour[:1]], *apart_m[tour[:-1], tour[1:]], 0.0])
    prices_m = (_length_m(tour, lengths_m, apart_m) + behind_m + ahead_m - skipped_m[:, None]).T
    number, k = divmod(int(np.argmin(prices_m)), len(tour) + 1)
    goal = unsold[number]
    return float(prices_m[number, k]), [*tour[:k], goal, *tour[k:]], goal


def _length_m(tour: list[int], lengths_m: Array, apart_m: Array) -> float:
    return float(lengths_m[tour[0]] + apart_m[tour[:-1], tour[1:]].sum()) if tour else 0.0
