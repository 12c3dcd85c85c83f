"""The latest sign readings of each robot, and from how many other places each text is known."""

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
    """The latest sign readings of all robots, and the signs in each robot's map."""

    def __init__(self, robots: int, slots: int):
        self.readings = np.zeros((robots, slots, 4))
        """(robots, slots, 4), newest first: time [s], x and y [m] in the odom frame, number of other places of the
        text."""
        self.readings[:, :, 0] = -math.inf
        self.places = [_NO_PLACES] * robots
        """Per robot (2, k) positions of its known signs in the map frame; a new list whenever one of them changes."""
        self._texts: list[list[str]] = [[] for _ in range(robots)]
        self._known: Sequence[Sequence[KnownSign]] = ()
        self._known_of: list[Sequence[KnownSign]] = [()] * robots
        self._text_counts: list[Counter[str]] = [Counter()] * robots
        self._run: Callable[..., None] | None = None
        """`_note_reading` bound to `readings`."""

    def remember(self, poses: Array, time_s: float, signs: Sequence[tuple[SignReading, ...]]) -> None:
        """Add each robot's readings of one step; poses: `TeamBeliefs.poses`."""
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
        """Update the known signs of each robot; an object that is the same as before is taken as unchanged."""
        if signs is self._known:
            return
        self._known = signs
        latest: Sequence[KnownSign] | None = None
        for robot, own in enumerate(signs):
            if own is self._known_of[robot]:
                continue
            if own is not latest:  # robots of one group share the object
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
    """Positions (2, k), and number of places per text; cached: equal signs give identical objects."""
    return np.frombuffer(places_m).reshape(-1, 2).T.copy(), Counter(texts)


@borrowing_kernel
def _note_reading(readings, poses, robot, time_s, bearing, away, elsewhere):
    """Insert a sign as the newest reading of a robot; bearing [rad] and distance `away` [m] in the robot frame."""
    rows, angle = readings[robot], poses[robot, 2, 2] + bearing
    for k in range(rows.shape[0] - 1, 0, -1):
        for j in range(rows.shape[1]):
            rows[k, j] = rows[k - 1, j]
    rows[0, 0], rows[0, 3] = time_s, elsewhere
    rows[0, 1], rows[0, 2] = poses[robot, 2, 0] + away * math.cos(angle), poses[robot, 2, 1] + away * math.sin(angle)
