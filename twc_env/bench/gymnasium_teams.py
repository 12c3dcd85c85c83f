"""Teams as environments of gymnasium, so that `gymnasium.vector` can be compared with `VectorTeams`."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray as Array

from twc_env.config import EnvConfig
from twc_env.vector.shared_arrays import FLAT
from twc_env.vector.teams import VectorTeams


class GymnasiumTeams(gymnasium.Env):
    """`count` teams as one environment, whose blocks have axes of teams and robots.

    An episode that ends is followed by the next one in the same step, so this environment itself never ends: what
    `VectorTeams.step` returns beside the observations is in `info`, since gymnasium has one reward per environment.
    """

    def __init__(self, config: EnvConfig, count: int):
        self._teams = VectorTeams(count, config)
        self.observation_space = self._batched(self._teams.observation_space)
        self.action_space = self._batched(self._teams.action_space)

    def _batched(self, space: spaces.Space) -> spaces.Space:
        return batch_space(batch_space(space, self._teams.robots), self._teams.count)

    def reset(self, *, seed: int | None = None, options: dict | None = None):
        """Begin new episodes, of seeds from `seed` on."""
        return _seen(self._teams.reset(seed or 0)), {}

    def step(self, action: Array):
        """One step of each team; action: (count, robots, ...)."""
        observations, rewards, ended, infos = self._teams.step(action)
        terms = [[list(of_robot["reward_terms"].values()) for of_robot in team] for team in infos]
        info: dict[str, Any] = {"rewards": rewards, "ended": ended, "reward_terms": np.array(terms)}
        if ended.any():
            info["infos"] = infos
        return _seen(observations), float(rewards.sum()), False, False, info

    def close(self) -> None:
        """Close the teams."""
        self._teams.close()


def _seen(blocks: dict[str, Array]) -> Any:
    return blocks.get(FLAT, blocks)
