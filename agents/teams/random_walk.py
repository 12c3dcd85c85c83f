"""Baseline policy: smooth random velocities, independent of all observations but a wall right ahead."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from twc_env.config import EnvConfig, robot_configs
from twc_env.records.messages import UNSEEN_M, Belief

from ..shared.beginning import Beginning


class RandomWalk:
    """Forward speed and turn rate vary around fixed means (an Ornstein-Uhlenbeck process per robot)."""

    MEAN = np.array([0.5, 0.0])
    SPREAD = np.array([0.4, 0.6])
    """Stationary standard deviation, as shares of the maxima."""
    MEMORY_S = 2.0
    """Correlation time."""
    CLEARANCE_M = (0.1, 0.5)
    """A robot begins to turn away from what is this near to its rim, and turns until all is further away than that."""

    def __init__(self, config: EnvConfig):
        self._radii_m = [own.dynamics.robot_radius_m for own in robot_configs(config)]
        self._keep = math.exp(-config.dynamics.time_step_s / self.MEMORY_S)
        self.reset(0, ())

    def reset(self, seed: int, agents: Sequence[str]) -> None:
        """Restart; the same seed gives the same velocities."""
        self._rng = np.random.default_rng(seed)
        self._agents = tuple(agents)
        self._beginning = Beginning(agents)
        self._wander = self._rng.normal(size=(len(self._agents), 2))
        self._side = [0.0] * len(self._agents)

    def act(self, beliefs: dict[str, Belief]) -> dict[str, NDArray]:
        """The next velocities; a robot in front of an obstacle turns on the spot until it is free.

        Raises TwcError as `Beginning.check`.
        """
        self._beginning.check(beliefs)
        fresh = self._rng.normal(size=self._wander.shape)
        self._wander = self._keep * self._wander + math.sqrt(1 - self._keep**2) * fresh
        actions = np.clip(self.MEAN + self.SPREAD * self._wander, -1.0, 1.0).astype(np.float32)
        for i, agent in enumerate(self._agents):
            if agent in beliefs and self._is_blocked(i, beliefs[agent].ranges_m, self._side[i] != 0.0):
                self._side[i] = self._side[i] or math.copysign(1.0, actions[i, 1])
                actions[i] = 0.0, self._side[i]
            elif self._side[i]:  # free again: it drives away
                self._side[i], self._wander[i] = 0.0, (1.0, 0.0)
        return {agent: actions[i] for i, agent in enumerate(self._agents) if agent in beliefs}

    def _is_blocked(self, robot: int, ranges_m: NDArray | None, is_turning: bool) -> bool:
        """Whether a scan (beams,) shows an obstacle right ahead, or for a robot that turns away, further ahead."""
        if ranges_m is None or len(ranges_m) == 0:
            return False
        half = len(ranges_m) // (16 if is_turning else 8)
        ahead = np.concatenate([ranges_m[-half:], ranges_m[: half + 1]])
        return bool((np.abs(ahead[ahead != UNSEEN_M]) < self._radii_m[robot] + self.CLEARANCE_M[is_turning]).any())

    def finished(self, beliefs: dict[str, Belief]) -> bool:
        """Always False: there is no goal."""
        return False
