"""Random numbers drawn for many steps per call of a generator, as a call costs more than a hundred numbers."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache, cached_property
from statistics import NormalDist

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.kernels.compiled import borrowing_kernel

STEPS = 16
"""Steps per call for many numbers per step ..."""
_STEPS_OF = (16, 256), (128, 64)
"""... and for at most so many."""
_POOL = 512
"""Numbers drawn per refill of a pool."""
_BITS, NORMALS_PER_WORD = 12, 5
"""Bits of a random word that select a quantile, and normal numbers from one 64-bit word."""


class StepNoise:
    """Numbers for each step from one stream per robot, equal to those drawn step by step."""

    def __init__(self, streams: Sequence[np.random.Generator], count: int, kind: str = "standard_normal"):
        """`count` numbers per robot and step; kind: "standard_normal", "random" (uniform in [0, 1)) or "bits" (random
        64-bit words)."""
        self._sources = [(streams, count, kind)]
        self._taken, self._block = 0, -1

    def beside(self, streams: Sequence[np.random.Generator], count: int, kind: str = "standard_normal") -> StepNoise:
        """Append numbers of other streams as further columns; returns self."""
        self._sources.append((streams, count, kind))
        return self

    @cached_property
    def numbers(self) -> Array:
        """(steps, robots, count); not allocated where none is used."""
        (streams, _, kind), count = self._sources[0], sum(count for _, count, _ in self._sources)
        return np.empty((_steps(count), len(streams), count), np.uint64 if kind == "bits" else np.float64)

    def next(self) -> Array:
        """(robots, count) numbers of the next step; valid until the next call."""
        self.hold(self._taken)
        self._taken += 1
        return self.numbers[(self._taken - 1) % len(self.numbers)]

    @property
    def taken(self) -> int:
        """Number of calls of `next`."""
        return self._taken

    def hold(self, step: int) -> None:
        """Draw the numbers of a step into row `step % len(numbers)`, for kernels.

        Must be called for steps in order, and once for all steps of equal `step // STEPS`.
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
    """Steps per call for `count` numbers per step."""
    return next((steps for most, steps in _STEPS_OF if count <= most), STEPS)


class NormalPools:
    """Standard normal numbers from one stream per robot for a kernel that uses varying counts of them.

    The numbers are those that separate draws would give.
    """

    def __init__(self, streams: Sequence[np.random.Generator], count_max: int):
        """count_max: greatest count of a refill."""
        self._streams = streams
        numbers = np.empty((len(streams), _POOL + count_max))
        self._numbers, self._used, self._end = numbers, *np.zeros((2, len(streams)), np.int64)
        self.arguments = self._numbers, self._used, self._end
        """numbers (robots, k), used (robots,), end (robots,): the unused are numbers[robot, used:end]; the kernel
        advances `used`."""

    def refill(self, count: int) -> None:
        """Provide at least `count` unused numbers for each robot."""
        for robot, stream in enumerate(self._streams):
            row, used, end = self._numbers[robot], int(self._used[robot]), int(self._end[robot])
            left = end - used
            if left < count:
                row[:left] = row[used:end].copy()
                self._used[robot], self._end[robot] = 0, left + max(_POOL, count - left)
                row[left : self._end[robot]] = stream.standard_normal(self._end[robot] - left)


class StepQueue:
    """Standard normal numbers from one stream per robot for a kernel that uses at most one row of them per step.

    numbers (steps, robots, count); used (robots,): count of rows used, advanced by the kernel.
    """

    def __init__(self, streams: Sequence[np.random.Generator], count: int):
        self._streams = streams
        self.numbers = np.empty((_steps(count), len(streams), count))
        self.used = np.full(len(streams), len(self.numbers))
        self._block = -1

    def hold(self, step: int) -> None:
        """Provide enough rows for all steps of equal `step // STEPS`."""
        steps = len(self.numbers)
        if step // steps == self._block:
            return
        self._block = step // steps
        for robot, (stream, used) in enumerate(zip(self._streams, self.used.tolist(), strict=True)):
            rows = self.numbers[:, robot]
            rows[: steps - used] = rows[used:].copy()
            rows[steps - used :] = stream.standard_normal((used, rows.shape[1]))
        self.used[:] = 0


@cache
def normal_quantiles(count: int = 1 << _BITS) -> Array:
    """(count,) standard normal quantiles at the centres of `count` equal probability intervals, scaled to variance 1.

    Normal noise by table lookup: 4096 quantiles (the largest is 3.7) take a tenth of the time of exact sampling.
    """
    inverse = NormalDist().inv_cdf
    upper = np.array([inverse((k + 0.5) / count) for k in range(count // 2, count)])
    quantiles = np.concatenate([-upper[::-1], upper])
    return quantiles / np.sqrt(np.mean(quantiles**2))


@borrowing_kernel
def look_up_normals(words, quantiles, deviates):
    """Fill deviates (>= 5 words,) from random words (k,): `NORMALS_PER_WORD` entries of the quantiles from each."""
    for k in range(words.shape[0]):
        word, first = words[k], NORMALS_PER_WORD * k
        for j in range(NORMALS_PER_WORD):
            deviates[first + j] = quantiles[word & np.uint64((1 << _BITS) - 1)]
            word >>= np.uint64(_BITS)
