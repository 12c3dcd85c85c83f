"""Random numbers drawn for many steps at once: one call of a generator costs more than a hundred numbers."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

Array = NDArray

_STEPS = 64


class StepNoise:
    """Numbers for each step from one stream per robot; the same numbers as if drawn step by step."""

    def __init__(self, streams: Sequence[np.random.Generator], count: int, kind: str = "standard_normal"):
        """`count` numbers per robot and step; kind names the generator's method, "standard_normal" or "random"."""
        self._draws = [getattr(stream, kind) for stream in streams]
        self._numbers = np.empty((_STEPS, len(streams), count))
        self._used = _STEPS

    def next(self) -> Array:
        """(robots, count) numbers of the next step; valid until the call after."""
        if self._used == _STEPS:
            for robot, draw in enumerate(self._draws):
                self._numbers[:, robot] = draw(self._numbers.shape[::2])
            self._used = 0
        self._used += 1
        return self._numbers[self._used - 1]
