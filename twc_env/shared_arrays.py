"""Arrays in shared memory, through which the processes of `VectorTeams` exchange observations and actions."""

from __future__ import annotations

import math
import multiprocessing
from collections.abc import Mapping
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray as Array

FLAT = ""
"""Name of the only block of flat observations."""


class SharedArrays:
    """Observations, rewards, ends of episodes and actions of all environments, in memory that all processes share."""

    def __init__(self, count: int, robots: int, observation: spaces.Space, action: spaces.Space):
        boxes = observation.spaces if isinstance(observation, spaces.Dict) else {FLAT: observation}
        self._shapes: dict[str, tuple[tuple[int, ...], np.dtype]] = {
            name: ((count, robots, *(box.shape or ())), np.dtype(box.dtype)) for name, box in boxes.items()
        }
        self._shapes |= {
            " rewards": ((count, robots), np.dtype(np.float32)),
            " ended": ((count,), np.dtype(bool)),
            " actions": ((count, robots, *(action.shape or ())), np.dtype(action.dtype)),
        }
        self._raw = {
            name: multiprocessing.get_context("spawn").RawArray("B", max(1, math.prod(shape) * dtype.itemsize))
            for name, (shape, dtype) in self._shapes.items()
        }
        self._view()

    def _view(self) -> None:
        views: dict[str, Array] = {
            name: np.frombuffer(self._raw[name], dtype, math.prod(shape)).reshape(shape)
            for name, (shape, dtype) in self._shapes.items()
        }
        self.rewards, self.ended, self.actions = (views.pop(f" {name}") for name in ("rewards", "ended", "actions"))
        self.blocks = views

    def __getstate__(self) -> dict:
        return {"_shapes": self._shapes, "_raw": self._raw}

    def __setstate__(self, state: dict) -> None:
        self._shapes, self._raw = state["_shapes"], state["_raw"]
        self._view()

    def observations(self) -> dict[str, Array]:
        """Copies of the observations, which the next step does not change."""
        return {name: block.copy() for name, block in self.blocks.items()}

    def write(self, k: int, observations: Mapping[str, Any]) -> None:
        """Store the observations of environment k, one per robot in order."""
        for robot, observation in enumerate(observations.values()):
            for name, block in self.blocks.items():
                block[k, robot] = observation if name == FLAT else observation[name]
