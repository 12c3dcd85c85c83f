"""Closure seeker: drives back to known floor when its own uncertainty says so, to close a loop.

As in Stachniss, Haehnel and Burgard ("Exploration with active loop-closing for FastSLAM", IROS 2004): a loop may be
closed where the robot is near a place that it visited, but far from it along its path; it enters the loop while it is
uncertain, and goes on exploring once it is certain again. Uncertainty is the D-optimal one (Placed and Castellanos,
"A general relationship between optimality criteria and connectivity indices for active graph-SLAM", RA-L 2021): the
geometric mean of the standard deviations of its position since its last closure, as the engine estimates them. All else
is MinPos.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.planning import Disc, Plan, Terrain
from twc_env.records.messages import Belief

from ..teams.minpos import MinPos

STD_MAX_M = 0.045
"""A robot with a greater standard deviation seeks a closure."""
LOOP_M = 15.0
"""A place is worth returning to if the path since the visit is at least this long ..."""
DETOUR_MAX_M = 12.0
"""... and the way to it at most this."""
REST_M = 20.0
"""After a return, with a closure or without, the robot explores for at least this length of path."""


class ClosureSeeker(MinPos):
    """Without returns it is MinPos, its blind twin."""

    def reset(self, seed: int, agents: Sequence[str]) -> None:
        """Discard all state."""
        super().reset(seed, agents)
        self._may_return_m: dict[str, float] = dict.fromkeys(agents, 0.0)
        self._travel_m: dict[str, float] = dict.fromkeys(agents, 0.0)
        self._last: dict[str, Array] = {}

    def act(self, beliefs: dict[str, Belief]) -> dict[str, Array]:
        """One command per robot; replans where necessary. Raises TwcError as `Beginning.check`."""
        self.beginning.check(beliefs)
        for agent, belief in beliefs.items():
            last = self._last.get(agent)
            self._travel_m[agent] += 0.0 if last is None else math.dist(last, belief.pose_odom[:2])
            self._last[agent] = np.array(belief.pose_odom[:2])
        return super().act(beliefs)

    def best_plan(
        self, agent: str, beliefs: dict[str, Belief], terrain: Terrain, discs: list[Disc]
    ) -> tuple[Plan | None, str]:
        """The plan back to a known place while the robot is uncertain, else to a frontier."""
        plan = self._return(agent, beliefs[agent], terrain, discs)
        if plan is not None:
            return plan, "place"
        return super().best_plan(agent, beliefs, terrain, discs)

    def _return(self, agent: str, belief: Belief, terrain: Terrain, discs: list[Disc]) -> Plan | None:
        """The plan of a return, begun now or earlier; None if the robot explores."""
        robot, travel_m = self.robots[agent], self._travel_m[agent]
        if uncertainty_m(belief) <= STD_MAX_M or travel_m < self._may_return_m[agent]:
            return None
        track_m = np.array(robot.track_m).reshape(-1, 2)
        steps_m = np.hypot(*np.diff(track_m, axis=0, prepend=track_m[:1]).T)
        ago_m = steps_m[::-1].cumsum()[::-1]  # (k,) path length since each position
        old = np.flatnonzero(ago_m >= LOOP_M)
        if not len(old):
            return None
        away_m = np.hypot(*(track_m[old] - robot.pose[:2]).T)
        place = track_m[old[int(np.argmin(away_m))]]
        plan = self.plan_to_place(terrain, agent, place, discs)
        if plan is None or plan.length_m > DETOUR_MAX_M:
            return None
        if away_m.min() <= self.explorer.tour_arrival_m:  # it is there: whether or not a loop was closed, it goes on
            self._may_return_m[agent] = travel_m + REST_M
            return None
        return plan


def uncertainty_m(belief: Belief) -> float:
    """D-optimal uncertainty of the position: the square root of the product of its standard deviations [m]."""
    return math.sqrt(float(belief.pose_std[0] * belief.pose_std[1]))
