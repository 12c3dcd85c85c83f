"""Whether two maps have the same signs where they would share a place.

Where rooms look alike the names on their doors are nearly alike, too, and every corridor has an exit: closures by such
signs agree a room or a wing aside. What hangs there then reads otherwise, time and again, on most of the doors.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.kernels import kernel
from twc_env.messages import Keyframe
from twc_env.slam.text_similarity import normalise

SAME_PLACE_M, SAME_FACING_RAD = 0.6, 0.8
"""Signs nearer to each other than this, on walls that face the same way, hang in one place."""
APART_M = 1.5
"""Readings of one text that lie this far from each other in one map are of two signs."""


class SignsRead:
    """What was read at the keyframes of each robot, as far as anybody asked."""

    def __init__(self) -> None:
        self._number_of: dict[str, int] = {}
        self._readings: dict[int, list[tuple[int, int, float, float, float]]] = {}
        """Of each robot: place of the keyframe on its path, number of the text, where it hangs and faces there."""
        self._looked_at: dict[int, int] = {}
        """How many of its keyframes are among these."""

    def by(self, robot: int, path: Sequence[Keyframe]) -> tuple[Array, Array, Array]:
        """Of all readings of a robot with these keyframes whose walls are known: (n,) place on the path, (n,) number of
        the text, (n, 3) where it hangs and faces in the frame of that keyframe."""
        found, first = self._readings.setdefault(robot, []), self._looked_at.get(robot, 0)
        for place in range(first, len(path)):
            for sign in path[place].signs:
                if not math.isnan(sign.facing_rad):
                    text = normalise(sign.text).replace(" ", "")  # the space between two words is what OCR loses most
                    number = self._number_of.setdefault(text, len(self._number_of))
                    found.append((place, number, *sign.position_m.tolist(), sign.facing_rad))
        self._looked_at[robot] = len(path)
        rows = np.array(found).reshape(-1, 5)
        return rows[:, 0].astype(np.int64), rows[:, 1].astype(np.int64), rows[:, 2:]

    def clear(self) -> None:
        """Paths have been thinned: look at all of them anew."""
        self._readings.clear()
        self._looked_at.clear()


@kernel
def _hang_together(a, b):
    turn = (a[2] - b[2] + math.pi) % (2 * math.pi) - math.pi
    return math.hypot(a[0] - b[0], a[1] - b[1]) < SAME_PLACE_M and abs(turn) < SAME_FACING_RAD


@kernel
def _places(poses, is_b):
    """Of each reading its place, of each place its first reading, and (places, places) which of two maps are one."""
    count, places = poses.shape[0], 0
    place_of, first = np.empty(count, np.int64), np.empty(count, np.int64)
    for k in range(count):
        place_of[k] = places
        for p in range(places):
            if is_b[first[p]] == is_b[k] and _hang_together(poses[first[p]], poses[k]):
                place_of[k] = p
                break
        if place_of[k] == places:
            first[places] = k
            places += 1
    is_one = np.zeros((places, places), np.bool_)
    for p in range(places):
        for q in range(places):
            is_one[p, q] = is_b[first[p]] < is_b[first[q]] and _hang_together(poses[first[p]], poses[first[q]])
    return place_of, first[:places], is_one


def hang_apart(texts: Array, positions_m: Array, maps: Array) -> Array:
    """(texts,) bool, by their numbers: which hang at two places or more of any one map, as exits do in every corridor.

    texts (n,) numbers of readings, positions_m (n, 2) of each in the map (n,) that it is of, numbers as well.
    """
    count = int(texts.max(initial=-1)) + 1
    low = np.full((int(maps.max(initial=-1)) + 1, count, 2), np.inf)
    high = -low
    np.minimum.at(low, (maps, texts), positions_m)
    np.maximum.at(high, (maps, texts), positions_m)
    return ((high - low).max(axis=-1) > APART_M).any(axis=0)


def count_shared(texts: Array, poses: Array, is_b: Array) -> tuple[int, int]:
    """In how many places of one map the other reads a sign, too, and the same; and in how many another one.

    texts (n,) numbers of readings, poses (n, 3) where each hangs and faces, is_b (n,) whose it is. The same: to the
    letter at least once. Another: never, although both have read something there twice to the letter.
    """
    place_of, first, is_one = _places(poses, is_b)
    names, name_of = np.unique(texts, return_inverse=True)
    read = np.zeros((len(first), len(names)))
    np.add.at(read, (place_of, name_of), 1)
    is_sure = (read > 1).any(axis=1)
    is_same = (is_one & (read @ read.T > 0)).any(axis=1)
    return int(is_same.sum()), int((is_sure & ~is_same & (is_one & is_sure).any(axis=1)).sum())
