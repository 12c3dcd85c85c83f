"""Lets a team stop for people: a robot waits while something moves close to it, whatever its team wants."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.config import EnvConfig
from twc_env.planning import MovingObstacles
from twc_env.records.messages import Belief

from .policy import Policy


class CarefulTeam(Policy):
    """Another policy whose robots wait for moving obstacles other than teammates."""

    def __init__(self, team: Policy, config: EnvConfig):
        self._team, self._dynamics = team, config.dynamics
        self._obstacles: dict[str, MovingObstacles] = {}

    def reset(self, seed: int, agents: Sequence[str]) -> None:
        """Prepare for a new episode."""
        self._team.reset(seed, agents)
        self._obstacles = {agent: MovingObstacles(self._dynamics) for agent in agents}

    def act(self, beliefs: dict[str, Belief]) -> dict[str, Array]:
        """The team's actions, without speed where something moves."""
        actions = self._team.act(beliefs)
        for agent, belief in beliefs.items():
            if self._obstacles[agent].are_near(
                belief.pose_odom, belief.ranges_m, float(actions[agent][0]), _mates_of(belief)
            ):
                actions[agent] = np.array([0.0, actions[agent][1]], np.float32)
        return actions

    def finished(self, beliefs: dict[str, Belief]) -> bool:
        """Whether the team has nothing left to do."""
        return self._team.finished(beliefs)


def _mates_of(belief: Belief) -> Array:
    """(k, 2) believed positions of the mates in the robot frame."""
    if not belief.mates:
        return np.zeros((0, 2))
    offset = np.array([pose[:2] for pose in belief.mates.values()]) - belief.pose_map_robot[:2]
    c, s = math.cos(belief.pose_map_robot[2]), math.sin(belief.pose_map_robot[2])
    return np.stack([c * offset[:, 0] + s * offset[:, 1], c * offset[:, 1] - s * offset[:, 0]], axis=1)
