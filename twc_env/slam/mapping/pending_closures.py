"""Pending closures between two maps, which wait for others that agree."""

from __future__ import annotations

from collections.abc import Iterable
from operator import attrgetter

from twc_env.records.messages import LoopClosure


class WaitingClosures:
    """Pending closures, indexed by pairs of robots, since few of all are requested between two maps."""

    def __init__(self, closures: Iterable[LoopClosure] = ()):
        self._between: dict[tuple[int, int], dict[int, LoopClosure]] = {}
        """Pair of robots, the lower first -> number -> closure; some may no longer be pending."""
        self.add(closures)

    def add(self, closures: Iterable[LoopClosure]) -> None:
        """Add closures, whose numbers must be set."""
        for closure in closures:
            first, second = closure.candidate.target[0], closure.candidate.source[0]
            self._between.setdefault((min(first, second), max(first, second)), {})[closure.number] = closure

    def between(self, a: Iterable[int], b: Iterable[int]) -> list[LoopClosure]:
        """Those between robots `a` and robots `b`, ordered by number."""
        robots = tuple(b)
        found = [c for i in a for j in robots for c in self._still_waiting((min(i, j), max(i, j)))]
        return sorted(found, key=attrgetter("number"))

    def pairs(self) -> list[tuple[int, int]]:
        """The pairs of robots with pending closures."""
        return [pair for pair in self._between if self._still_waiting(pair)]

    def _still_waiting(self, pair: tuple[int, int]) -> Iterable[LoopClosure]:
        held = self._between.get(pair)
        if not held:
            return ()
        settled = [number for number, closure in held.items() if closure.status != "pending"]
        for number in settled:
            del held[number]
        return held.values()
