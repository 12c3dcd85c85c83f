"""Closures between two maps that wait for others that agree with them."""

from __future__ import annotations

from collections.abc import Iterable
from operator import attrgetter

from twc_env.messages import LoopClosure


class WaitingClosures:
    """Those that are pending, kept by the robots that they would tie: between two maps few of all are asked for."""

    def __init__(self, closures: Iterable[LoopClosure] = ()):
        self._between: dict[tuple[int, int], dict[int, LoopClosure]] = {}
        """By two robots, the lower first, and by numbers; some have been judged since."""
        self.add(closures)

    def add(self, closures: Iterable[LoopClosure]) -> None:
        """Have closures wait that have their numbers."""
        for closure in closures:
            first, second = closure.candidate.target[0], closure.candidate.source[0]
            self._between.setdefault((min(first, second), max(first, second)), {})[closure.number] = closure

    def between(self, a: Iterable[int], b: Iterable[int]) -> list[LoopClosure]:
        """Those between robots `a` and others `b`, in the order of their numbers."""
        robots = tuple(b)
        found = [c for i in a for j in robots for c in self._still_waiting((min(i, j), max(i, j)))]
        return sorted(found, key=attrgetter("number"))

    def pairs(self) -> list[tuple[int, int]]:
        """The pairs of robots between which any waits."""
        return [pair for pair in self._between if self._still_waiting(pair)]

    def _still_waiting(self, pair: tuple[int, int]) -> Iterable[LoopClosure]:
        held = self._between.get(pair)
        if not held:
            return ()
        judged = [number for number, closure in held.items() if closure.status != "pending"]
        for number in judged:
            del held[number]
        return held.values()
