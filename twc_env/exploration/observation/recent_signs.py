"""The latest sign readings of each robot, and from how many other places each text is known."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.kernels.compiled import BindsAnew, borrowing_kernel, bound
from twc_env.records.geometry import between, compose
from twc_env.records.messages import KnownSign, SignReading
from twc_env.records.team_messages import KnownSigns, TeamBeliefs
from twc_env.slam.places.sign_readings import SAME_SIGN_M

_NO_PLACES = np.zeros((2, 0))


class RecentSigns(BindsAnew):
    """The latest sign readings of all robots, and the signs in each robot's map.

    The place of a reading is in the map once a known sign of its text lies within `SAME_SIGN_M` of it: from then on,
    that sign is not counted among the other places. Until its keyframe has been received, all of them are others.
    """

    def __init__(self, robots: int, slots: int):
        self.readings = np.zeros((robots, slots, 4))
        """(robots, slots, 4), newest first: time [s], x and y [m] in the odom frame, number of other places of the
        text."""
        self.readings[:, :, 0] = -math.inf
        self.places = [_NO_PLACES] * robots
        """Per robot (2, k) positions of its known signs in the map frame; a new list whenever one of them changes."""
        self._texts: list[list[str]] = [[] for _ in range(robots)]
        self._unmapped: list[list[bool]] = [[] for _ in range(robots)]
        """Per robot and reading, whether the place of the reading is not in the map yet."""
        self._waits = [False] * robots
        """Per robot, whether the counts of its readings may change although its known signs do not."""
        self._known: Sequence[Sequence[KnownSign]] = ()
        self._known_of: list[Sequence[KnownSign]] = [()] * robots
        self._places_of: list[dict[str, Array]] = [{} for _ in range(robots)]
        """Per robot, the positions (k, 2) of each text that it knows."""
        self._run: Callable[..., None] | None = None
        """`_note_reading` bound to `readings`."""

    def remember(self, poses: Array, time_s: float, signs: Sequence[tuple[SignReading, ...]]) -> None:
        """Add each robot's readings of one step; poses: `TeamBeliefs.poses`."""
        slots = self.readings.shape[1]
        for robot, own in enumerate(signs):
            for sign in own:
                reading = poses, robot, time_s, sign.bearing_rad, sign.range_m
                if self._run is None:
                    self._run = bound(_note_reading, self.readings, *reading)
                self._run(*reading)
                self._texts[robot] = [sign.text, *self._texts[robot][: slots - 1]]
                self._unmapped[robot] = [True, *self._unmapped[robot][: slots - 1]]
                self._waits[robot] = True

    def know(self, beliefs: TeamBeliefs) -> None:
        """Update the known signs of each robot, and count the other places of each reading's text.

        Signs in an object that is the same as before are taken as unchanged.
        """
        changed = () if beliefs.signs is self._known else self._take(beliefs.signs)
        for robot, waits in enumerate(self._waits):
            if waits or robot in changed:
                self._count(robot, beliefs.poses[robot])

    def _take(self, signs: Sequence[Sequence[KnownSign]]) -> list[int]:
        """Note the known signs of each robot; returns the robots whose signs have changed."""
        self._known = signs
        latest: Sequence[KnownSign] | None = None
        changed = []
        for robot, own in enumerate(signs):
            if own is self._known_of[robot]:
                continue
            if own is not latest:  # robots of one group share the object
                latest, known = own, KnownSigns.of(own)
                places, places_of = _index_of(tuple(known.texts), np.asarray(known.places_m, float).tobytes())
            self._known_of[robot] = own
            if places is not self.places[robot]:
                self.places = self.places.copy()
                self.places[robot], self._places_of[robot] = places, places_of
                changed.append(robot)
        return changed

    def _count(self, robot: int, poses: Array) -> None:
        """Count the other places of each reading of a robot; poses (3, 3): in the map, its spread, in odom."""
        rows, unmapped, self._waits[robot] = self.readings[robot], self._unmapped[robot], False
        for row, text in enumerate(self._texts[robot]):
            places = self._places_of[robot].get(text, ())
            if unmapped[row] and len(places):
                here = compose(poses[0], between(poses[2], [*rows[row, 1:3], 0.0]))[:2]
                unmapped[row] = bool(np.hypot(*(places - here).T).min() >= SAME_SIGN_M)
                self._waits[robot] |= unmapped[row]
            rows[row, 3] = len(places) if unmapped[row] else max(len(places) - 1, 0)


@lru_cache(maxsize=16)
def _index_of(texts: tuple[str, ...], places_m: bytes) -> tuple[Array, dict[str, Array]]:
    """Positions (2, k), and those (k, 2) of each text; cached: equal signs give identical objects."""
    places = np.frombuffer(places_m).reshape(-1, 2)
    rows: dict[str, list[int]] = {}
    for row, text in enumerate(texts):
        rows.setdefault(text, []).append(row)
    return places.T.copy(), {text: places[own] for text, own in rows.items()}


@borrowing_kernel
def _note_reading(readings, poses, robot, time_s, bearing, away):
    """Insert a sign as the newest reading of a robot; bearing [rad] and distance `away` [m] in the robot frame."""
    rows, angle = readings[robot], poses[robot, 2, 2] + bearing
    for k in range(rows.shape[0] - 1, 0, -1):
        for j in range(rows.shape[1]):
            rows[k, j] = rows[k - 1, j]
    rows[0, 0], rows[0, 3] = time_s, 0.0
    rows[0, 1], rows[0, 2] = poses[robot, 2, 0] + away * math.cos(angle), poses[robot, 2, 1] + away * math.sin(angle)
