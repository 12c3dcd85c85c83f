"""Rendezvous: robots explore, and meet at appointed times to merge and exchange their maps.

Robots that share no map go to landmarks at times fixed in advance (Roy and Dudek, "Collaborative robot exploration and
rendezvous: algorithms, performance bounds and observations", Autonomous Robots 11, 2001). All rank landmarks alike, so
two robots that know the same one meet there; here the landmark is the known sign that is first in the alphabet. Robots
with a common map, but without contact, meet at a place that they agreed on when they last were together (de Hoog,
Cameron and Visser, "Role-based autonomous multi-robot exploration", 2009): the robot of the lowest number chooses it,
near the frontiers of their map, and those who meet pass it on. With a central mapper, robots that share a map exchange
it anyway and need not meet. All else is MinPos.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.config import EnvConfig
from twc_env.planning import Disc, Plan, Terrain
from twc_env.records.geometry import compose, inverse, transform_points, travelled_m
from twc_env.records.messages import Belief

from ..shared.frontier_team import Frontiers
from ..teams.minpos import MinPos

PERIOD_S, ALONE = 100.0, 2
"""Time between two meetings; robots that share no map yet go to landmarks at every second one."""
WAIT_S, EARLY_S = 5.0, 20.0
"""A robot waits this long after the appointed time; who is together this long before it has met."""
PACE = 0.8
"""Share of the maximum speed at which it expects to travel."""
THERE_M = 1.5
"""It is at the meeting place within this way."""


@dataclass(frozen=True, slots=True, eq=False)
class Appointment:
    """Where a group meets."""

    owner: int
    """The robot that chose it."""
    step: int
    """When it did."""
    place_odom_m: Array
    """(2,) in the odom frame of the robot that holds this."""


class Rendezvous(MinPos):
    """Without meetings it is MinPos, its blind twin."""

    def __init__(self, config: EnvConfig):
        self._is_peer = config.link.topology == "peer"
        super().__init__(config)

    def reset(self, seed: int, agents: Sequence[str]) -> None:
        """Discard all state."""
        super().reset(seed, agents)
        self._met: dict[str, int] = dict.fromkeys(agents, 0)
        self._appointments: dict[str, Appointment] = {}

    def act(self, beliefs: dict[str, Belief]) -> dict[str, Array]:
        """One command per robot; replans where necessary."""
        if self._is_peer:
            for agent in beliefs:
                self._pass_on(agent, beliefs)
        return super().act(beliefs)

    def best_plan(
        self, agent: str, beliefs: dict[str, Belief], terrain: Terrain, discs: list[Disc]
    ) -> tuple[Plan | None, str]:
        """The plan to the next meeting when it is time to go there, else to a frontier."""
        belief, now_s = beliefs[agent], beliefs[agent].step * self.dynamics.time_step_s
        due_s = PERIOD_S * (self._met[agent] + 1)
        if self._has_to_meet(belief):
            if now_s > due_s + WAIT_S or (now_s > due_s - EARLY_S and self._is_complete(belief)):
                self._met[agent] = max(self._met[agent] + 1, int(now_s // PERIOD_S))
            elif (place := self._place_m(agent, beliefs)) is not None:
                plan = self.plan_to_place(terrain, agent, place, discs, 1.0)
                if plan is not None:
                    way_m = travelled_m(plan.path_m)[-1]
                    if now_s + way_m / (PACE * self.robots[agent].follower.dynamics.speed_max_m_s) >= due_s:
                        return (plan, "place") if way_m > THERE_M else (None, "wait")
        return super().best_plan(agent, beliefs, terrain, discs)

    def choose(self, agent: str, beliefs: dict[str, Belief], frontiers: Frontiers) -> int | None:
        """The frontier of MinPos; robots in contact agree on where to meet next."""
        self._appoint(agent, beliefs, frontiers)
        return super().choose(agent, beliefs, frontiers)

    def _has_to_meet(self, belief: Belief) -> bool:
        """Whether someone shares no map with it, or cannot always be heard."""
        return len(belief.teammates) + 1 < len(self.robots) or self._is_peer

    def _is_complete(self, belief: Belief) -> bool:
        """Whether all of its group are in contact, and there is a group."""
        is_heard = [belief.contact_steps.get(teammate, -1) == belief.step for teammate in belief.teammates]
        return self._is_peer and len(is_heard) > 0 and all(is_heard)

    def _place_m(self, agent: str, beliefs: dict[str, Belief]) -> Array | None:
        """(2,) the appointed place, or else the landmark; None if the robot knows neither."""
        belief, appointed = beliefs[agent], self._appointments.get(agent)
        if appointed is not None and appointed.owner in (belief.robot, *belief.teammates):
            return transform_points(_pose_map_odom(belief), appointed.place_odom_m[None])[0]
        first = min(belief.signs, key=lambda sign: sign.text, default=None)
        return None if first is None or (self._met[agent] + 1) % ALONE else np.asarray(first.position_m, float)

    def _appoint(self, agent: str, beliefs: dict[str, Belief], frontiers: Frontiers) -> None:
        """While all of a group are in contact, the robot of the lowest number chooses the next place: the middle one of
        the frontiers. Nobody is left behind with an appointment that the others have changed."""
        belief = beliefs[agent]
        contacts = {beliefs[other].robot for other in self.teammates_in_contact(agent, beliefs)}
        is_whole = len(contacts) > 0 and contacts == set(belief.teammates)
        if self._is_peer and is_whole and belief.robot < min(contacts) and len(frontiers.labels):
            middle = frontiers.places_m.mean(axis=0)
            place = frontiers.places_m[int(np.argmin(np.hypot(*(frontiers.places_m - middle).T)))]
            self._keep(agent, belief, belief.robot, belief.step, place)

    def _pass_on(self, agent: str, beliefs: dict[str, Belief]) -> None:
        """Take over the appointment of a teammate in contact: that of the lowest number, the newest of those."""
        belief, robot = beliefs[agent], self.robots[agent]
        mine = self._appointments.get(agent)
        if mine is not None and mine.owner not in (belief.robot, *belief.teammates):
            mine = None
        contacts = self.teammates_in_contact(agent, beliefs)
        if mine is None and contacts:  # at the first meeting: where the one of the lowest number is now
            first = min([belief.robot, *(beliefs[other].robot for other in contacts)])
            place = robot.pose[:2] if first == belief.robot else belief.teammates[first][:2]
            mine = self._keep(agent, belief, first, belief.step, np.asarray(place, float))
        for other in contacts:
            theirs = self._appointments.get(other)
            if theirs is not None and mine is not None and (-theirs.owner, theirs.step) > (-mine.owner, mine.step):
                place = transform_points(_pose_map_odom(beliefs[other]), theirs.place_odom_m[None])[0]
                mine = self._keep(agent, belief, theirs.owner, theirs.step, place)

    def _keep(self, agent: str, belief: Belief, owner: int, step: int, place_m: Array) -> Appointment:
        in_odom = transform_points(inverse(_pose_map_odom(belief)), place_m[None])[0]
        self._appointments[agent] = Appointment(owner, step, in_odom)
        return self._appointments[agent]


def _pose_map_odom(belief: Belief) -> Array:
    return compose(belief.pose_map_robot, inverse(belief.pose_odom))
