"""How much more one robot's receiver hears than another's, learned where both read the same sign.

Receivers differ: a stronger one hears all transmitters a few dB louder and lists faint ones that the other misses, so
that places look unlike which are one. Where two robots read the same text and all that both hear differs by about the
same, that much is the receivers' difference: at two places it would differ from transmitter to transmitter.
"""

from __future__ import annotations

import math
from bisect import insort
from collections.abc import Collection, Sequence

import numpy as np

from twc_env.kernels import kernel
from twc_env.messages import Fingerprint

OFFSET_MIN_DB, TRANSMITTERS_MIN, PLACES_MIN, LETTERS_MIN = 6.0, 3, 3, 3
"""Receivers that differ by more, over so many transmitters at so many places with a name this long, are told apart, if
half of these places agree which one hears more."""
SCATTER_MAX_DB = 5.0
"""Transmitters whose differences scatter by more (rms) are heard at two places."""


class DeviceOffsets:
    """`note` tells what each robot hears where it reads which text. Arrays are over robots."""

    def __init__(self) -> None:
        self.offset_db = np.zeros((0, 0))
        """[a, b]: how much more b hears than a; 0 while unknown or small."""
        self.faintest_dbm = np.zeros(0)
        """The faintest transmitter, in the mean over places where each robot read what another did."""
        self._met: list[int] = []
        """How many these are."""
        self._heard: list[dict[str, Fingerprint]] = []
        """Of each robot and text what was heard where it was first read, where anything was."""
        self._places: list[list[list[float]]] = []
        """[a][b]: the differences at places that both noted, ascending."""

    def note(self, robot: int, text: str, heard: Fingerprint) -> list[int]:
        """Take in what a robot, one there is room for, hears where it reads a text.

        Gives the robots from which its receiver is told apart from now on.
        """
        if len(text) < LETTERS_MIN or text in self._heard[robot] or not len(heard.macs):
            return []
        self._heard[robot][text] = heard
        is_new = False
        for other, known in enumerate(self._heard):
            there = known.get(text)
            if there is not None and other != robot:
                self._listen(robot, heard)
                self._listen(other, there)
                count, mean_db, scatter_db = _shared_difference(there.macs, there.rssi_dbm, heard.macs, heard.rssi_dbm)
                if count >= TRANSMITTERS_MIN and scatter_db <= SCATTER_MAX_DB:
                    insort(self._places[other][robot], mean_db)
                    insort(self._places[robot][other], -mean_db)
                    is_new = True
        return [other for other in range(len(self._heard)) if is_new and other != robot and self._learn(other, robot)]

    def _listen(self, robot: int, heard: Fingerprint) -> None:
        self._met[robot] += 1
        self.faintest_dbm[robot] += (heard.rssi_dbm.min() - self.faintest_dbm[robot]) / self._met[robot]

    def between(self, a: int, b: int) -> list[float]:
        """How much more b hears than a, at every place that tells [dB], ascending.

        Where too few places do, those at which either met a third count too, by the middle of how it differs from a.
        """
        found = self._places[a][b]
        if len(found) >= PLACES_MIN:
            return found
        found = found.copy()
        for third in range(len(self._heard)):
            by_a = self._places[a][third]
            if third not in (a, b) and len(by_a) >= PLACES_MIN:
                found += [by_a[len(by_a) // 2] + difference for difference in self._places[third][b]]
        return sorted(found)

    def _learn(self, a: int, b: int) -> bool:
        """Take up what is known of two; whether they were not told apart before and are now."""
        held, offset_db = float(self.offset_db[a, b]), offset_of(self.between(a, b))
        self.offset_db[a, b], self.offset_db[b, a] = offset_db, -offset_db
        return held == 0.0 and offset_db != 0.0

    def forget(self, texts: Collection[str]) -> None:
        """Let go of where all but these texts were first read."""
        kept = set(texts)
        self._heard = [{text: heard for text, heard in known.items() if text in kept} for known in self._heard]

    def make_room(self, robots: int) -> None:
        """New arrays for so many robots that know what the old ones did."""
        more = robots - len(self._heard)
        self.offset_db, self.faintest_dbm = np.pad(self.offset_db, (0, more)), np.pad(self.faintest_dbm, (0, more))
        self._heard += [{} for _ in range(more)]
        self._met += [0] * more
        self._places += [[] for _ in range(more)]
        for row in self._places:
            row += [[] for _ in range(robots - len(row))]


def offset_of(differences_db: Sequence[float]) -> float:
    """By how much two receivers differ, from what places say, ascending; 0 where these are few or say little."""
    count = len(differences_db)
    if count < PLACES_MIN:
        return 0.0
    low, middle, high = (differences_db[k] for k in (count // 4, count // 2, count - 1 - count // 4))
    return middle if abs(middle) > OFFSET_MIN_DB and low * high > 0 else 0.0


@kernel
def _shared_difference(macs_a, levels_a, macs_b, levels_b):
    """How many transmitters two fingerprints share, by how much the second hears them stronger in the mean, and the
    rms scatter about that [dB]."""
    i = j = count = 0
    total = squares = 0.0
    while i < macs_a.shape[0] and j < macs_b.shape[0]:
        if macs_a[i] < macs_b[j]:
            i += 1
        elif macs_a[i] > macs_b[j]:
            j += 1
        else:
            difference = levels_b[j] - levels_a[i]
            total += difference
            squares += difference * difference
            count += 1
            i += 1
            j += 1
    if count == 0:
        return 0, 0.0, 0.0
    mean = total / count
    return count, mean, math.sqrt(max(squares / count - mean * mean, 0.0))
