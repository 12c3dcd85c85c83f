"""Baseline policy: smooth random velocities, independent of all observations."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from twc_env.config import EnvConfig
from twc_env.records.messages import Belief


class RandomWalk:
    """Forward speed and turn rate vary around fixed means (an Ornstein-Uhlenbeck process per robot)."""

    MEAN = np.array([0.5, 0.0])
    SPREAD = np.array([0.4, 0.6])
    """Stationary standard deviation, as shares of the maxima."""
    MEMORY_S = 2.0
    """Correlation time."""

    def __init__(self, config: EnvConfig):
        self._keep = math.exp(-config.dynamics.time_step_s / self.MEMORY_S)
        self.reset(0, ())

    def reset(self, seed: int, agents: Sequence[str]) -> None:
        """Restart; the same seed gives the same velocities."""
        self._rng = np.random.default_rng(seed)
        self._agents = tuple(agents)
        self._wander = self._rng.normal(size=(len(self._agents), 2))

    def act(self, beliefs: dict[str, Belief]) -> dict[str, NDArray]:
        """The next velocities, independent of the beliefs."""
        fresh = self._rng.normal(size=self._wander.shape)
        self._wander = self._keep * self._wander + math.sqrt(1 - self._keep**2) * fresh
        actions = np.clip(self.MEAN + self.SPREAD * self._wander, -1.0, 1.0).astype(np.float32)
        return {agent: actions[i] for i, agent in enumerate(self._agents) if agent in beliefs}

    def finished(self, beliefs: dict[str, Belief]) -> bool:
        """Always False: there is no goal."""
        return False
