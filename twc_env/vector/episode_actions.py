"""From what the present episodes of `VectorTeams` are played again: their seeds and the actions since they began."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray as Array


class EpisodeActions:
    """Per environment the seed of its episode, and the actions so far; with them it does the same in any process."""

    def __init__(self, count: int, shape: tuple[int, ...], dtype: Any):
        """shape: of the actions of one environment in one step."""
        self._shape, self._dtype = shape, dtype
        self.seeds: list[int | None] = [None] * count
        """None: no episode has begun."""
        self._actions = [bytearray() for _ in range(count)]

    def begin(self, k: int, seed: int) -> None:
        """Environment k begins the episode of this seed."""
        self.seeds[k], self._actions[k] = seed, bytearray()

    def note(self, k: int, actions: Array, has_ended: bool) -> None:
        """Environment k gets these actions; has_ended: as the first of its next episode."""
        if has_ended and (seed := self.seeds[k]) is not None:
            self.begin(k, seed + len(self.seeds))
        self._actions[k] += actions.tobytes()

    def of(self, k: int) -> Array:
        """(steps, ...) actions of environment k since its episode began."""
        return np.frombuffer(bytes(self._actions[k]), self._dtype).reshape(-1, *self._shape)
