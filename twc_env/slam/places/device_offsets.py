"""RSSI offsets between the receivers of the robots, estimated where two robots read the same sign.

A more sensitive receiver reports all transmitters a few dB stronger and lists faint ones that another misses, so
fingerprints of one place differ. If two robots read the same text and their RSSI differs by about the same amount for
all common transmitters, that is the receivers' offset. At different places it would vary between transmitters.
"""

from __future__ import annotations

import math
from bisect import insort
from collections.abc import Collection, Sequence

import numpy as np

from twc_env.kernels.compiled import kernel
from twc_env.records.messages import Fingerprint

OFFSET_MIN_DB, TRANSMITTERS_MIN, PLACES_MIN, LETTERS_MIN = 6.0, 3, 3, 3
"""An offset must exceed the first value and be measured with this many common transmitters at this many places, with
texts of this many letters. The middle half of the places must agree on its sign."""
SCATTER_MAX_DB = 5.0
"""Differences that scatter by more (rms) come from two different places."""


class DeviceOffsets:
    """Offsets between all pairs of robots; `note` adds measurements. Arrays are indexed by robot."""

    def __init__(self) -> None:
        self.offset_db = np.zeros((0, 0))
        """[a, b]: RSSI of b minus RSSI of a at the same place; 0 while unknown or small."""
        self.faintest_dbm = np.zeros(0)
        """RSSI of each robot's faintest transmitter, averaged over places where another robot read the same text."""
        self._listened_count: list[int] = []
        """Number of places in that average."""
        self._heard: list[dict[str, Fingerprint]] = []
        """Of each robot: text -> fingerprint where the robot first read it; without empty fingerprints."""
        self._places: list[list[list[float]]] = []
        """[a][b]: differences (b minus a) [dB] at places that both visited, ascending."""

    def note(self, robot: int, text: str, heard: Fingerprint) -> list[int]:
        """Add the fingerprint of a robot where it reads a text; returns the robots to which its offset is now known."""
        if len(text) < LETTERS_MIN or text in self._heard[robot] or not len(heard.macs):
            return []
        self._heard[robot][text] = heard
        is_new = False
        for other, known in enumerate(self._heard):
            theirs = known.get(text)
            if theirs is not None and other != robot:
                self._average_faintest(robot, heard)
                self._average_faintest(other, theirs)
                count, mean_db, scatter_db = _shared_difference(
                    theirs.macs, theirs.rssi_dbm, heard.macs, heard.rssi_dbm
                )
                if count >= TRANSMITTERS_MIN and scatter_db <= SCATTER_MAX_DB:
                    insort(self._places[other][robot], mean_db)
                    insort(self._places[robot][other], -mean_db)
                    is_new = True
        return [other for other in range(len(self._heard)) if is_new and other != robot and self._update(other, robot)]

    def _average_faintest(self, robot: int, heard: Fingerprint) -> None:
        self._listened_count[robot] += 1
        self.faintest_dbm[robot] += (heard.rssi_dbm.min() - self.faintest_dbm[robot]) / self._listened_count[robot]

    def between(self, a: int, b: int) -> list[float]:
        """Differences b minus a at all common places [dB], ascending; if too few, also via third robots (their median
        offset to a plus their differences to b)."""
        found = self._places[a][b]
        if len(found) >= PLACES_MIN:
            return found
        found = found.copy()
        for third in range(len(self._heard)):
            by_a = self._places[a][third]
            if third not in (a, b) and len(by_a) >= PLACES_MIN:
                found += [by_a[len(by_a) // 2] + difference for difference in self._places[third][b]]
        return sorted(found)

    def _update(self, a: int, b: int) -> bool:
        """Update the offset of two robots; whether it was 0 and no longer is."""
        before, offset_db = float(self.offset_db[a, b]), offset_of(self.between(a, b))
        self.offset_db[a, b], self.offset_db[b, a] = offset_db, -offset_db
        return before == 0.0 and offset_db != 0.0

    def keep(self, texts: Collection[str]) -> None:
        """Drop the fingerprints of all texts but these."""
        kept = set(texts)
        self._heard = [{text: heard for text, heard in known.items() if text in kept} for known in self._heard]

    def make_room(self, robots: int) -> None:
        """Enlarge all arrays to this number of robots."""
        more = robots - len(self._heard)
        self.offset_db, self.faintest_dbm = np.pad(self.offset_db, (0, more)), np.pad(self.faintest_dbm, (0, more))
        self._heard += [{} for _ in range(more)]
        self._listened_count += [0] * more
        self._places += [[] for _ in range(more)]
        for row in self._places:
            row += [[] for _ in range(robots - len(row))]


def offset_of(differences_db: Sequence[float]) -> float:
    """Median of the differences (ascending); 0 if they are too few, too small or their quartiles differ in sign."""
    count = len(differences_db)
    if count < PLACES_MIN:
        return 0.0
    low, middle, high = (differences_db[k] for k in (count // 4, count // 2, count - 1 - count // 4))
    return middle if abs(middle) > OFFSET_MIN_DB and low * high > 0 else 0.0


@kernel
def _shared_difference(macs_a, levels_a, macs_b, levels_b):
    """Number of common transmitters of two fingerprints, mean RSSI difference b minus a, and the rms scatter [dB]."""
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
