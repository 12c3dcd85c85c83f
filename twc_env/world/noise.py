"""Random numbers drawn for many steps at once: one call of a generator costs more than a hundred numbers."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from statistics import NormalDist

import numpy as np
from numpy.typing import NDArray as Array

STEPS, _STEPS_MAX = 64, 256
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
        self._taken, self._block = 0, -1

    def beside(self, streams: Sequence[np.random.Generator], count: int, kind: str = "standard_normal") -> StepNoise:
        """The same with further numbers of other streams in the columns behind."""
        self._sources.append((streams, count, kind))
        _, robots, columns = self.numbers.shape
        self.numbers = np.empty((_steps(columns + count), robots, columns + count))
        return self

    def next(self) -> Array:
        """(robots, count) numbers of step 0, then of step 1, ...; valid until the call after."""
        self.hold(self._taken)
        self._taken += 1
        return self.numbers[(self._taken - 1) % len(self.numbers)]

    def hold(self, step: int) -> None:
        """Have the numbers of a step in row `step % len(numbers)`, for kernels; blocks of steps follow each other.

        As long as `step // STEPS` stays the same it need not be called again.
        """
        block = step // len(self.numbers)
        if block != self._block:
            self._block, first, steps = block, 0, len(self.numbers)
            for streams, count, kind in self._sources:
                for robot, stream in enumerate(streams):
                    draw = stream.bit_generator.random_raw if kind == "bits" else getattr(stream, kind)
                    self.numbers[:, robot, first : first + count] = draw(steps * count).reshape(steps, count)
                first += count


def _steps(count: int) -> int:
    """For how many steps numbers are drawn at once, `count` of them for each."""
    return _STEPS_MAX if count <= _FEW else STEPS


class NormalPools:
    """Normal deviates from one stream per robot for a kernel, which takes what it needs from a row and counts that.

    The same numbers as if drawn when they are asked for.
    """

    def __init__(self, streams: Sequence[np.random.Generator], count_max: int):
        """`count_max`: the most that is ever asked for at once."""
        self._streams = streams
        numbers = np.empty((len(streams), _POOL + count_max))
        self._numbers, self._used, self._end = numbers, *np.zeros((2, len(streams)), np.int64)
        self.arguments = self._numbers, self._used, self._end
        """(robots, k) numbers, of which those from `used` (robots,) on and before `end` (robots,) are to be taken."""

    def refill(self, count: int) -> None:
        """Have at least `count` numbers for each robot."""
        for robot, stream in enumerate(self._streams):
            row, used, end = self._numbers[robot], int(self._used[robot]), int(self._end[robot])
            left = end - used
            if left < count:
                row[:left] = row[used:end].copy()
                self._used[robot], self._end[robot] = 0, left + max(_POOL, count - left)
                row[left : self._end[robot]] = stream.standard_normal(self._end[robot] - left)


class StepQueue:
    """Normal deviates from one stream per robot for a kernel that takes a row of them now and then, at most one a step.

    `numbers` (steps, robots, count); `used` (robots,): the rows that the kernel has taken, which it counts itself.
    """

    def __init__(self, streams: Sequence[np.random.Generator], count: int):
        self._streams = streams
        self.numbers = np.empty((STEPS, len(streams), count))
        self.used = np.full(len(streams), STEPS)
        self._block = -1

    def hold(self, step: int) -> None:
        """Have enough for a step and those after it with the same `step // STEPS`."""
        if step // STEPS == self._block:
            return
        self._block = step // STEPS
        for robot, (stream, used) in enumerate(zip(self._streams, self.used.tolist(), strict=True)):
            rows = self.numbers[:, robot]
            rows[: STEPS - used] = rows[used:].copy()
            rows[STEPS - used :] = stream.standard_normal((used, rows.shape[1]))
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
