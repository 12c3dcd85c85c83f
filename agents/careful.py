"""Lets a team stop for people: a robot waits while something moves close to it, whatever its team wants."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.config import EnvConfig, robot_configs
from twc_env.planning import MovingObstacles
from twc_env.records.messages import Belief

from .policy import Policy


class CarefulTeam(Policy):
    """Another policy whose robots wait for moving obstacles other than teammates."""

    def __init__(self, team: Policy, config: EnvConfig):
        self._team, self._own = team, [own.dynamics for own in robot_configs(config)]
        self._obstacles: dict[str, MovingObstacles] = {}

    def reset(self, seed: int, agents: Sequence[str]) -> None:
        """Prepare for a new episode."""
        self._team.reset(seed, agents)
        self._obstacles = {agent: MovingObstacles(own) for agent, own in zip(agents, self._own, strict=True)}

    def give_truth(self, *truth: Any) -> None:
        """Pass on what an oracle is given."""
        team: Any = self._team
        team.give_truth(*truth)

    def act(self, beliefs: dict[str, Belief]) -> dict[str, Array]:
        """The team's actions, without speed where something moves."""
        actions = self._team.act(beliefs)
        for agent, belief in beliefs.items():
            if self._obstacles[agent].stop(belief, float(actions[agent][0])):
                actions[agent] = np.array([0.0, actions[agent][1]], np.float32)
        return actions

    def finished(self, beliefs: dict[str, Belief]) -> bool:
        """Whether the team has nothing left to do."""
        return self._team.finished(beliefs)
