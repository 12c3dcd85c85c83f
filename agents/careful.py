"""Lets a team stop for people, and remember what its robots bumped into, whatever the team itself knows of both."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.config import EnvConfig, robot_configs
from twc_env.planning import FeltObstacles, MovingObstacles, has_glass, shown
from twc_env.records.messages import Belief

from .policy import Policy


class CarefulTeam(Policy):
    """Another policy, whose robots wait for moving obstacles other than teammates if there are people; if there is
    furniture, the team's scans show what they bumped into."""

    def __init__(self, team: Policy, config: EnvConfig):
        self._team, self._own = team, [own.dynamics for own in robot_configs(config)]
        self._waits, self._feels = config.people.count > 0, config.clutter.furniture > 0
        self._has_glass = has_glass(config)
        self._obstacles: dict[str, MovingObstacles] = {}
        self._felt: dict[str, FeltObstacles] = {}
        self._speed_max_m_s: dict[str, float] = {}

    def reset(self, seed: int, agents: Sequence[str]) -> None:
        """Prepare for a new episode."""
        self._team.reset(seed, agents)
        own = dict(zip(agents, self._own, strict=True))
        self._speed_max_m_s = {agent: each.speed_max_m_s for agent, each in own.items()}
        self._obstacles = {agent: MovingObstacles(each, self._has_glass) for agent, each in own.items() if self._waits}
        self._felt = {agent: FeltObstacles(each) for agent, each in own.items() if self._feels}

    def give_truth(self, *truth: Any) -> None:
        """Pass on what an oracle is given."""
        team: Any = self._team
        team.give_truth(*truth)

    def act(self, beliefs: dict[str, Belief]) -> dict[str, Array]:
        """The team's actions, slower or without speed where something moves."""
        known = dict(beliefs)
        for agent, felt in self._felt.items():
            if agent in beliefs and len(points := felt.feel(beliefs[agent])):
                known[agent] = dataclasses.replace(beliefs[agent], ranges_m=shown(beliefs[agent].ranges_m, points))
        actions = self._team.act(known)
        for agent, belief in beliefs.items():
            speed_max_m_s = self._speed_max_m_s[agent]
            if self._feels and (back_m_s := self._felt[agent].retreat_m_s(belief)):
                actions[agent] = np.array([back_m_s / speed_max_m_s, 0.0], np.float32)
            wanted = float(actions[agent][0])
            if self._waits:
                allowed = self._obstacles[agent].limited(belief, wanted * speed_max_m_s) / speed_max_m_s
                if abs(allowed) < abs(wanted):
                    actions[agent] = np.array([allowed, actions[agent][1]], np.float32)
            if self._feels:
                self._felt[agent].tell(float(actions[agent][0]) * speed_max_m_s)
        return actions

    def finished(self, beliefs: dict[str, Belief]) -> bool:
        """Whether the team has nothing left to do."""
        return self._team.finished(beliefs)
