"""Random numbers drawn for many steps at once: one call of a generator costs more than a hundred numbers."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from statistics import NormalDist

import numpy as np
from numpy.typing import NDArray

Array = NDArray

_STEPS, _STEPS_MAX = 64, 256
_FEW = 16
"""Numbers per step that are so few that drawing them costs less than asking for them: they are drawn for more steps."""
_POOL = 512


class StepNoise:
    """Numbers for each step from one stream per robot; the same numbers as if drawn step by step."""

    def __init__(self, streams: Sequence[np.random.Generator], count: int, kind: str = "standard_normal"):
        """`count` numbers per robot and step; kind: "standard_normal", "random" (uniform in [0, 1)), or "bits" (random
        words of 64 bits, for noise that a kernel makes out of them)."""
        self._sources = [(streams, count, kind)]
        self.numbers = np.empty((_steps(count), len(streams), count), np.uint64 if kind == "bits" else np.float64)
        """(steps, robots, count)."""
        self._used = len(self.numbers)

    def beside(self, streams: Sequence[np.random.Generator], count: int, kind: str = "standard_normal") -> StepNoise:
        """The same with further numbers of other streams in the columns behind."""
        self._sources.append((streams, count, kind))
        _, robots, columns = self.numbers.shape
        self.numbers = np.empty((_steps(columns + count), robots, columns + count))
        self._used = len(self.numbers)
        return self

    def next(self) -> Array:
        """(robots, count) numbers of the next step; valid until the call after."""
        return self.numbers[self.next_row()]

    def next_row(self) -> int:
        """The row of `numbers` for the next step."""
        if self._used == len(self.numbers):
            self._draw()
        self._used += 1
        return self._used - 1

    def _draw(self) -> None:
        first, steps = 0, len(self.numbers)
        for streams, count, kind in self._sources:
            for robot, stream in enumerate(streams):
                draw = stream.bit_generator.random_raw if kind == "bits" else getattr(stream, kind)
                self.numbers[:, robot, first : first + count] = draw(steps * count).reshape(steps, count)
            first += count
        self._used = 0


def _steps(count: int) -> int:
    """For how many steps numbers are drawn at once, `count` of them for each."""
    return _STEPS_MAX if count <= _FEW else _STEPS


class NormalPool:
    """Normal deviates of one stream, drawn many at once; the same numbers as if drawn when they are asked for."""

    def __init__(self, stream: np.random.Generator):
        self._stream = stream
        self._numbers, self._used = np.empty(0), 0

    def take(self, count: int) -> Array:
        """The next (count,) numbers."""
        if self._used + count > len(self._numbers):
            fresh = self._stream.standard_normal(max(_POOL, count))
            self._numbers, self._used = np.concatenate([self._numbers[self._used :], fresh]), 0
        self._used += count
        return self._numbers[self._used - count : self._used]


class StepQueue:
    """Normal deviates from one stream per robot for a kernel that takes a row of them now and then, at most one a step.

    `numbers` (steps, robots, count); `used` (robots,): the rows that the kernel has taken, which it counts itself.
    """

    def __init__(self, streams: Sequence[np.random.Generator], count: int):
        self._streams = streams
        self.numbers = np.empty((_STEPS, len(streams), count))
        self.used = np.full(len(streams), _STEPS)

    def refill(self) -> None:
        """Draw anew what was taken; to be called before the first step and every 64 steps."""
        for robot, (stream, used) in enumerate(zip(self._streams, self.used.tolist(), strict=True)):
            rows = self.numbers[:, robot]
            rows[: _STEPS - used] = rows[used:].copy()
            rows[_STEPS - used :] = stream.standard_normal((used, rows.shape[1]))
        self.used[:] = 0


@cache
def normal_quantiles(count: int) -> Array:
    """(count,) normal deviates of unit variance, one in the middle of each of as many equally likely intervals.

    A random number below 4096 picks one of 4096: normal noise to three digits (largest deviate 3.7) for a tenth of the
    time that exact deviates take.
    """
    inverse = NormalDist().inv_cdf
    upper = np.array([inverse((k + 0.5) / count) for k in range(count // 2, count)])
    quantiles = np.concatenate([-upper[::-1], upper])
    return quantiles / np.sqrt(np.mean(quantiles**2))
