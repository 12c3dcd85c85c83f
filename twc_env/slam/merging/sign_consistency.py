"""Test whether two maps have the same signs at the places that they share.

In buildings with repeated rooms the names on doors are similar, and every corridor has an exit sign. Closures by such
signs can agree on a transform that is one room or one wing off. Then most doors have a different text in the two maps.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.kernels.compiled import kernel
from twc_env.records.messages import Keyframe
from twc_env.slam.places.text_similarity import normalise

SAME_PLACE_M, SAME_FACING_RAD = 0.6, 0.8
"""Signs within this distance, on walls with the same facing, are at one place."""
APART_M = 1.5
"""Readings of one text further apart than this in one map are of two signs."""


class SignsRead:
    """Sign readings at the keyframes of each robot, collected on demand."""

    def __init__(self) -> None:
        self._number_of: dict[str, int] = {}
        self._readings: dict[int, list[tuple[int, int, float, float, float]]] = {}
        """Per robot: index of the keyframe on its path, text number, position and facing in its frame."""
        self._looked_at: dict[int, int] = {}
        """Number of keyframes already processed."""

    def by(self, robot: int, path: Sequence[Keyframe]) -> tuple[Array, Array, Array]:
        """All readings of a robot with these keyframes that have a text and whose walls are known: index on the path
        (n,), text number (n,), pose of the sign in the frame of that keyframe (n, 3)."""
        found, first = self._readings.setdefault(robot, []), self._looked_at.get(robot, 0)
        for place in range(first, len(path)):
            for sign in path[place].signs:
                text = normalise(sign.text).replace(" ", "")  # OCR loses spaces most often
                if text and not math.isnan(sign.facing_rad):
                    number = self._number_of.setdefault(text, len(self._number_of))
                    found.append((place, number, *sign.position_m.tolist(), sign.facing_rad))
        self._looked_at[robot] = len(path)
        rows = np.array(found).reshape(-1, 5)
        return rows[:, 0].astype(np.int64), rows[:, 1].astype(np.int64), rows[:, 2:]

    def clear(self) -> None:
        """Drop all data, after keyframes were removed."""
        self._readings.clear()
        self._looked_at.clear()


@kernel
def _hang_together(a, b):
    turn = (a[2] - b[2] + math.pi) % (2 * math.pi) - math.pi
    return math.hypot(a[0] - b[0], a[1] - b[1]) < SAME_PLACE_M and abs(turn) < SAME_FACING_RAD


@kernel
def _places(poses, is_b):
    """Place of each reading, first reading of each place, and (places, places) which of two maps coincide."""
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


def found_apart(texts: Array, positions_m: Array, maps: Array) -> Array:
    """(texts,) bool, by number: texts at two or more places of one map, such as exit signs.

    texts (n,) numbers of readings, positions_m (n, 2) of each in its map, maps (n,) numbers of the maps.
    """
    count = int(texts.max(initial=-1)) + 1
    low = np.full((int(maps.max(initial=-1)) + 1, count, 2), np.inf)
    high = -low
    np.minimum.at(low, (maps, texts), positions_m)
    np.maximum.at(high, (maps, texts), positions_m)
    return ((high - low).max(axis=-1) > APART_M).any(axis=0)


def count_shared(texts: Array, poses: Array, is_b: Array) -> tuple[int, int]:
    """Number of places of one map where the other map has the same text, and where it has only different ones.

    texts (n,) numbers of readings, poses (n, 3) of their signs, is_b (n,) which map. Same: one identical text.
    Different: none, although both maps have some identical text twice there.
    """
    place_of, first, is_one = _places(poses, is_b)
    names, name_of = np.unique(texts, return_inverse=True)
    read = np.zeros((len(first), len(names)))
    np.add.at(read, (place_of, name_of), 1)
    is_sure = (read > 1).any(axis=1)
    is_same = (is_one & (read @ read.T > 0)).any(axis=1)
    return int(is_same.sum()), int((is_sure & ~is_same & (is_one & is_sure).any(axis=1)).sum())
