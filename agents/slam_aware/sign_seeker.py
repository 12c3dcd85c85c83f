"""Sign seeker: goes where signs that two maps have floor in common can be confirmed, if that is worth the way.

A view is worth the floor that it shows, and that of the maps which it is expected to merge.

Robots that share no map decide as in Fox, Ko, Konolige, Limketkai, Schulz and Stewart ("Distributed multirobot
exploration and mapping", Proc. IEEE 94(7), 2006): the value of confirming a hypothesis about where another robot is, is
weighed against that of exploring on, in the same unit, as floor. A hypothesis is what pending loop closures say
(`Belief.hypotheses`). Going from a to b is expected to add p A (exp(-mu d_b) - exp(-mu d_a)): A is the floor of the
other group's map, d the distance to that part of it to which the robot has not been, and p = n / (n + 1) with n
closures that agree (Laplace's rule of succession). What robots in contact tell each other of their maps suffices.

All else is the team `information-gain`, its blind twin. Choosing views by what signs say was tried and left out: to
know from room numbers how far the rooms are that another robot has read did not bring the maps together sooner.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.config import EnvConfig
from twc_env.planning import ViewGain
from twc_env.records.geometry import transform_points
from twc_env.records.messages import Belief

from ..teams.information_gain import InformationGain

DECAY_PER_M = 0.1
"""mu."""
LISTEN_S = 1.0
"""Period of asking those in contact."""
SAMPLE_M = 1.0
"""Spacing of points that stand for another map's floor."""
PASSED_M = 2.0
"""Floor within this distance of the robot's path has been tried."""


@dataclass(frozen=True, slots=True, eq=False)
class Told:
    """What a robot told of its group's map when last in contact."""

    area_m2: float
    floor_m: Array
    """(k, 2) points on it, in its own frame."""


class SignSeeker(InformationGain):
    """Decides anew as soon as it has a new hypothesis."""

    def __init__(self, config: EnvConfig):
        super().__init__(config)
        self._period_steps = max(1, round(LISTEN_S / config.dynamics.time_step_s))

    def reset(self, seed: int, agents: Sequence[str]) -> None:
        """Discard all state."""
        super().reset(seed, agents)
        self._others: dict[str, dict[int, Told]] = {agent: {} for agent in agents}
        self._supports: dict[str, dict[tuple[int, ...], int]] = {agent: {} for agent in agents}

    def act(self, beliefs: dict[str, Belief]) -> dict[str, Array]:
        """One command per robot; replans where necessary."""
        if next(iter(beliefs.values())).step % self._period_steps == 0:
            maps: dict[tuple[int, ...], Told] = {}
            for agent, belief in beliefs.items():
                for theirs in beliefs.values():
                    is_heard = belief.contact_steps.get(theirs.robot, -1) == belief.step
                    if is_heard and theirs.robot not in belief.teammates:
                        group = (min([theirs.robot, *theirs.teammates]), id(theirs.grid))
                        maps[group] = maps[group] if group in maps else _told(theirs)
                        self._others[agent][theirs.robot] = maps[group]
                supports = {each.robots: each.support for each in belief.hypotheses}
                if supports != self._supports[agent]:
                    self._supports[agent] = supports
                    self.robots[agent].drop_goal()
        return super().act(beliefs)

    def gains_m2(self, agent: str, beliefs: dict[str, Belief], views: ViewGain) -> Callable[[Array], Array]:
        """What a view shows, and what it brings of the map of the group that promises most there."""
        belief, here_m = beliefs[agent], self.robots[agent].pose[None, :2].copy()
        others = []
        for hypothesis in belief.hypotheses:
            told = [self._others[agent][number] for number in hypothesis.robots if number in self._others[agent]]
            if told:
                floor_m = self._untried(agent, transform_points(hypothesis.pose_map_other, told[0].floor_m))
                others.append((hypothesis.support / (hypothesis.support + 1.0) * told[0].area_m2, floor_m))

        def expected_m2(places_m: Array) -> Array:
            brought_m2 = np.zeros(len(places_m))
            for area_m2, floor_m in others:
                near = _nearness(np.vstack([here_m, places_m]), floor_m)
                brought_m2 = np.maximum(brought_m2, area_m2 * (near[1:] - near[0]))
            return views.area_m2(places_m) + brought_m2

        return expected_m2

    def _untried(self, agent: str, points_m: Array) -> Array:
        """Those of points (k, 2) to which the robot has not been."""
        track_m = np.array(self.robots[agent].track_m).reshape(-1, 2)
        near_m = np.hypot(*(points_m[:, None] - track_m[None]).T).min(axis=0, initial=np.inf)
        return points_m[near_m > PASSED_M]


def _nearness(places_m: Array, points_m: Array) -> Array:
    """(places,) exp(-mu d), where d is the distance to the nearest of the points."""
    apart_m = np.hypot(*(places_m[:, None] - points_m[None]).T)  # (points, places)
    near: Array = np.exp(-DECAY_PER_M * apart_m.min(axis=0, initial=np.inf))
    return near


def _told(belief: Belief) -> Told:
    """What a robot tells of its map."""
    grid = belief.grid
    is_free = grid.log_odds < 0
    stride = max(1, round(SAMPLE_M / grid.resolution_m))
    cells = np.argwhere(is_free[stride // 2 :: stride, stride // 2 :: stride]) * stride + stride // 2
    return Told(float(is_free.sum()) * grid.resolution_m**2, grid.centre_of(cells))
