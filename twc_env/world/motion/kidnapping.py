"""Robots that are lifted and put down elsewhere: when, and where. Their odometry does not see it."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.config import FailureConfig
from twc_env.records.random_streams import random_stream
from twc_env.world.building.floorplan import Floorplan
from twc_env.world.motion.failures import Failures
from twc_env.world.motion.starts import start_places

_AWAY_M = 3.0
"""Least distance of the new place to the old one, if the building has such a place ..."""
_APART_M = 1.0
"""... and to other robots and people."""


class Kidnapping:
    """The kidnappings of one episode, at most one of each robot per step; nobody lifts a robot that is off."""

    def __init__(
        self, config: FailureConfig, home: Floorplan, starts_s: Sequence[float], time_step_s: float, seed: int
    ):
        """starts_s: when each robot is switched on."""
        self._step, self._last_robot = config.kidnap_step, len(starts_s) - 1
        self._chance = config.kidnaps_per_min * time_step_s / 60.0
        self._failures = Failures(config, starts_s, time_step_s)
        self.is_nothing = not self._step and not self._chance
        """Whether no robot is ever carried."""
        self._random = random_stream(seed, "kidnap")
        self._places = np.zeros((0, 2)) if self.is_nothing else start_places(home)

    def avoid(self, is_clear: Callable[[Array], Array]) -> None:
        """Put robots down only where something is clear: points (k, 2) -> (k,) bool."""
        if len(self._places):
            self._places = self._places[is_clear(self._places)]

    def carried(self, step: int, poses: Array, people_m: Array) -> list[tuple[int, Array]]:
        """Robots carried before this step, and their new poses (3,); poses (n, 3) of all robots, people_m (k, 2).

        Once per step.
        """
        drawn = self._random.random(len(poses)) < self._chance if self._chance else np.zeros(len(poses), bool)
        if step == self._step > 0:
            drawn[self._last_robot] = True
        drawn &= self._failures.is_alive(step)
        if not drawn.any() or not len(self._places):
            return []
        now, moved = poses.copy(), []
        for robot in np.flatnonzero(drawn).tolist():
            own_m = np.hypot(*(self._places - now[robot, :2]).T)
            others = np.concatenate([np.delete(now, robot, axis=0)[:, :2], people_m])
            others_m = [np.hypot(*(self._places - place).T) for place in others]
            is_free = np.min([np.full(len(own_m), np.inf), *others_m], axis=0) >= _APART_M
            chosen = np.flatnonzero(is_free & (own_m >= min(_AWAY_M, own_m[is_free].max(initial=0.0))))
            if len(chosen):
                place = self._places[chosen[self._random.integers(len(chosen))]]
                now[robot] = *place, self._random.uniform(-math.pi, math.pi)
                moved.append((robot, now[robot].copy()))
        return moved
