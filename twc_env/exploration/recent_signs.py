"""The signs that each robot read of late, and how many other places each text is known from."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Sequence
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.kernels import BindsAnew, borrowing_kernel, bound
from twc_env.messages import KnownSign, SignReading
from twc_env.team_messages import KnownSigns

_NO_PLACES = np.zeros((2, 0))


class RecentSigns(BindsAnew):
    """The latest readings of all robots, and where each robot knows signs to be."""

    def __init__(self, robots: int, slots: int):
        self.readings = np.zeros((robots, slots, 4))
        """Newest first: time, x and y in the odom frame, and in how many other places the text is known."""
        self.readings[:, :, 0] = -math.inf
        self.places = [_NO_PLACES] * robots
        """Of each robot (2, k): the signs that it knows, in the map frame; another list when one of them changes."""
        self._texts: list[list[str]] = [[] for _ in range(robots)]
        self._known: Sequence[Sequence[KnownSign]] = ()
        self._known_of: list[Sequence[KnownSign]] = [()] * robots
        self._text_counts: list[Counter[str]] = [Counter()] * robots
        self._run: Callable[..., None] | None = None
        """`_note_reading` with the readings."""

    def remember(self, poses: Array, time_s: float, signs: Sequence[tuple[SignReading, ...]]) -> None:
        """Take in what each robot read in a step; poses as `TeamBeliefs` has them."""
        slots = self.readings.shape[1]
        for robot, own in enumerate(signs):
            if not own:
                continue
            texts, counts = self._texts[robot], self._text_counts[robot]
            for sign in own:
                elsewhere = float(max(counts[sign.text] - 1, 0))
                reading = poses, robot, time_s, sign.bearing_rad, sign.range_m, elsewhere
                if self._run is None:
                    self._run = bound(_note_reading, self.readings, *reading)
                self._run(*reading)
                texts = [sign.text, *texts[: slots - 1]]
            self._texts[robot] = texts

    def know(self, signs: Sequence[Sequence[KnownSign]]) -> None:
        """Take over the signs that each robot knows now; the same objects as before have not changed."""
        if signs is self._known:
            return
        self._known = signs
        latest: Sequence[KnownSign] | None = None
        for robot, own in enumerate(signs):
            if own is self._known_of[robot]:
                continue
            if own is not latest:  # mates of one group know the same
                latest, known = own, KnownSigns.of(own)
                places, counts = _index_of(tuple(known.texts), np.asarray(known.places_m, float).tobytes())
            self._known_of[robot] = own
            if places is not self.places[robot]:
                self.places = self.places.copy()
                self.places[robot], self._text_counts[robot] = places, counts
                for row, text in enumerate(self._texts[robot]):
                    self.readings[robot, row, 3] = max(counts[text] - 1, 0)


@lru_cache(maxsize=16)
def _index_of(texts: tuple[str, ...], places_m: bytes) -> tuple[Array, Counter[str]]:
    """Places (2, k) and how often each text is known; the same objects for the same signs, read again or by a mate."""
    return np.frombuffer(places_m).reshape(-1, 2).T.copy(), Counter(texts)


@borrowing_kernel
def _note_reading(readings, poses, robot, time_s, bearing, away, elsewhere):
    """Put a sign before the other readings of a robot."""
    rows, angle = readings[robot], poses[robot, 2, 2] + bearing
    for k in range(rows.shape[0] - 1, 0, -1):
        for j in range(rows.shape[1]):
            rows[k, j] = rows[k - 1, j]
    rows[0, 0], rows[0, 3] = time_s, elsewhere
    rows[0, 1], rows[0, 2] = poses[robot, 2, 0] + away * math.cos(angle), poses[robot, 2, 1] + away * math.sin(angle)
