"""Arrays in shared memory, through which the processes of `VectorTeams` exchange observations and actions."""

from __future__ import annotations

import math
import multiprocessing
from collections.abc import Mapping
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray as Array

from twc_env.exploration.assessment import rewards

FLAT = ""
"""Name of the only block of flat observations."""


class SharedArrays:
    """What `count` environments receive and return, one row per environment, in memory that all processes share."""

    def __init__(self, count: int, robots: int, observation: spaces.Space, action: spaces.Space, state: spaces.Space):
        boxes = observation.spaces if isinstance(observation, spaces.Dict) else {FLAT: observation}
        of_blocks: dict[str, tuple[tuple[int, ...], Any]] = {
            name: ((robots, *(box.shape or ())), box.dtype) for name, box in boxes.items()
        }
        self._blocks = tuple(of_blocks)
        rows = [
            *of_blocks.values(),
            *of_blocks.values(),
            ((robots, *(action.shape or ())), action.dtype),
            ((robots,), np.float32),
            ((robots, len(rewards.TERMS)), np.float64),
            (state.shape or (), state.dtype),
            (state.shape or (), state.dtype),
            ((), bool),
        ]
        self._shapes = [((count, *shape), np.dtype(dtype)) for shape, dtype in rows]
        context = multiprocessing.get_context("spawn")
        self._raw = [context.RawArray("B", max(1, math.prod(shape) * dtype.itemsize)) for shape, dtype in self._shapes]
        self._view()

    def _view(self) -> None:
        views: list[Array] = [
            np.frombuffer(raw, dtype, math.prod(shape)).reshape(shape)
            for raw, (shape, dtype) in zip(self._raw, self._shapes, strict=True)
        ]
        blocks = len(self._blocks)
        self.observations = dict(zip(self._blocks, views[:blocks], strict=True))
        self.final_observations = dict(zip(self._blocks, views[blocks : 2 * blocks], strict=True))
        """Last observations of the episode that ended last."""
        self.actions, self.rewards, self.reward_terms, self.states, self.final_states, self.ended = views[2 * blocks :]

    def __getstate__(self) -> dict:
        return {"_blocks": self._blocks, "_shapes": self._shapes, "_raw": self._raw}

    def __setstate__(self, state: dict) -> None:
        self.__dict__.update(state)
        self._view()


def write_observations(blocks: Mapping[str, Array], k: int, observations: Mapping[str, Any]) -> None:
    """Store the observations of environment k, one per robot in order, in row k of each block."""
    for robot, observation in enumerate(observations.values()):
        for name, block in blocks.items():
            block[k, robot] = observation if name == FLAT else observation[name]
