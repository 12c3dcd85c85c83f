"""Place recognition without signs, at regular path intervals: by WiFi alone, for robots that read none, or by scans."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.config import PlaceRecognitionConfig
from twc_env.records.messages import Keyframe, LoopCandidate
from twc_env.slam.places.place_cues import rssi_cue, similarities
from twc_env.slam.places.scan_descriptor import compare, compare_many, describe, ring_key
from twc_env.slam.places.sign_table import MISSING_AFTER_S, RadioRule, SignTable

STEP_M = 1.0
"""Path interval of stored places and queries."""
RING_KEY_NEIGHBOURS = 10
"""Number of places with the most similar ring keys that are compared at all rotations."""
CANDIDATES_MAX = 5
"""Maximum number of candidates per keyframe."""
TIE_DIGITS = 9
"""Decimals to which two places are told apart by their similarity; the rest is rounding, as between headings."""


def least(values: Array, robots: Array, count: int) -> Array:
    """Indices of the `count` least values (n,), ascending; all if there are fewer.

    Of values equal to TIE_DIGITS, in the order of robots (n,) and then of the values given, as many as have room are
    taken at even intervals up to the last: places that look the same are then of all robots, and from all along their
    paths.
    """
    values = np.round(values, TIE_DIGITS)
    order = np.lexsort((robots, values))
    if len(order) <= count:
        return order
    ascending = values[order]
    first, end = (int(np.searchsorted(ascending, ascending[count - 1], side)) for side in ("left", "right"))
    room = count - first
    return np.concatenate([order[:first], order[first + np.arange(1, room + 1) * (end - first) // room - 1]])


class PathPlaces:
    """Keyframes about STEP_M apart along each robot's path."""

    def __init__(self) -> None:
        self.keyframes: list[Keyframe] = []
        self._last_m: dict[int, float] = {}

    def sparsify(self, is_held: Callable[[Keyframe], bool]) -> Array:
        """See `Recogniser`; returns which places are kept (places,) bool."""
        is_kept = np.array([is_held(keyframe) for keyframe in self.keyframes], bool)
        self.keyframes = [self.keyframes[k] for k in np.flatnonzero(is_kept).tolist()]
        return is_kept

    def is_due(self, keyframe: Keyframe) -> bool:
        """Whether the robot has moved STEP_M since its last stored place."""
        return keyframe.travel_m - self._last_m.get(keyframe.robot, -math.inf) >= STEP_M

    def add(self, keyframe: Keyframe) -> None:
        """Store a place."""
        self._last_m[keyframe.robot] = keyframe.travel_m
        self.keyframes.append(keyframe)

    def others(self, keyframe: Keyframe, skipped_robots: Sequence[int], revisit_travel_m: float) -> Array:
        """Indices of the places that a keyframe may be compared with."""
        return np.array(
            [
                k
                for k, place in enumerate(self.keyframes)
                if place.robot not in skipped_robots
                and (place.robot != keyframe.robot or keyframe.travel_m - place.travel_m >= revisit_travel_m)
            ],
            int,
        )


class DescribedPlaces(PathPlaces):
    """The same, with the descriptors of their scans."""

    def __init__(self) -> None:
        super().__init__()
        self._descriptors: list[Array] = []
        self._keys: list[Array] = []

    def sparsify(self, is_held: Callable[[Keyframe], bool]) -> Array:
        """See `PathPlaces`."""
        is_kept = super().sparsify(is_held)
        kept = np.flatnonzero(is_kept).tolist()
        self._descriptors, self._keys = [self._descriptors[k] for k in kept], [self._keys[k] for k in kept]
        return is_kept

    def describe_last(self, descriptor: Array) -> None:
        """Give the place that was added last its descriptor."""
        self._descriptors.append(descriptor)
        self._keys.append(ring_key(descriptor))

    def most_similar(self, numbers: Array, descriptor: Array) -> tuple[Array, Array, Array]:
        """At most CANDIDATES_MAX of these places, those with the most similar scans of those with similar ring keys:
        indices, similarities and rotations, best first."""
        robots = np.array([self.keyframes[k].robot for k in numbers])
        keys = np.array([self._keys[k] for k in numbers])
        apart = ((keys - ring_key(descriptor)) ** 2).sum(axis=1)
        kept = least(apart, robots, RING_KEY_NEIGHBOURS)
        near, robots = numbers[kept], robots[kept]
        similarity, turn = compare_many(np.array([self._descriptors[k] for k in near]), descriptor)
        best = least(-similarity, robots, CANDIDATES_MAX)
        return near[best], similarity[best], turn[best]


class WifiRecogniser:
    """Shared transmitters and similar strengths alone; scans only give the rotation guess."""

    name = "wifi"

    def __init__(self, config: PlaceRecognitionConfig, range_max_m: float):
        self._config, self._range_max_m = config, range_max_m
        self._places = PathPlaces()
        self._table = SignTable()
        """The same places, as if one sign was read at all of them."""
        self._radio = RadioRule.of(config)

    def propose(self, keyframe: Keyframe, skipped_robots: Sequence[int] = ()) -> list[LoopCandidate]:
        """See `Recogniser`; returns the most similar places."""
        if not self._places.is_due(keyframe):
            return []
        rule, found = self._config, []
        rows = self._table.like([(0, 1.0)], keyframe, skipped_robots, rule.revisit_travel_m, self._radio)
        for row, _, macs, _, distance_db, shared in rows:
            k = int(row)
            prints = self._places.keyframes[k].fingerprint, keyframe.fingerprint
            rssi, is_alike = rssi_cue(distance_db, int(shared), rule, prints)
            if is_alike:
                found.append((min(macs, rssi), k, macs, rssi))
        found.sort(key=lambda entry: (-entry[0], entry[1]))
        candidates = []
        for _, k, macs, rssi in found[:CANDIDATES_MAX]:
            place = self._places.keyframes[k]
            turn = compare(*(describe(scan, self._range_max_m) for scan in (place.ranges_m, keyframe.ranges_m)))[1]
            ends, guess = (place.key, keyframe.key), np.array([0.0, 0.0, turn])
            candidates.append(LoopCandidate(*ends, guess, self.name, mac_similarity=macs, rssi_similarity=rssi))
        self._places.add(keyframe)
        self._table.append(keyframe, "", 0)
        return candidates

    def sparsify(self, is_held: Callable[[Keyframe], bool]) -> None:
        """See `Recogniser`."""
        self._table.keep(self._places.sparsify(is_held), np.zeros(1, np.int64), ())

    def score(self, target: Keyframe, source: Keyframe) -> float:
        """The smaller of the two similarities."""
        cues = similarities(target, source, self._config)
        return min(cues.macs, cues.rssi)


class SignlessRecogniser:
    """Compares robots that have read no sign for long with all others by WiFi, until each has read one, and robots
    that were carried, until each has found its place again.

    A missing cue is no evidence against a place. Algorithm 1 of TWC-SLAM would never compare such robots, since it
    requires similar texts first.
    """

    def __init__(self, config: PlaceRecognitionConfig, range_max_m: float, robot_count: int):
        self._wifi = WifiRecogniser(config, range_max_m)
        self._unread, self._readers = set(range(robot_count)), list[int]()
        self._robot_count = robot_count
        self._kept: list[Keyframe] = []
        """Keyframes stored until a robot lacks signs."""
        self._is_needed = False

    def add_robot(self) -> None:
        """One more robot, which has read no sign."""
        self._unread.add(self._robot_count)
        self._robot_count += 1

    def propose(
        self, keyframe: Keyframe, skipped_robots: Sequence[int] = (), is_lost: bool = False
    ) -> list[LoopCandidate]:
        """Candidates between this keyframe and earlier ones of robots that are not skipped, of which one has read no
        sign, or was carried and has a map of its own (`is_lost`): its signs do not count.

        When the first robot is found to read none, also those between all earlier keyframes.
        """
        if is_lost and not len(keyframe.fingerprint.macs):
            return []  # the first since it was put down: the next one, at the same place, has heard something
        if keyframe.signs and keyframe.robot in self._unread and not is_lost:
            self._unread.remove(keyframe.robot)
            self._readers.append(keyframe.robot)
        self._kept.append(keyframe)
        if not self._unread:
            return []
        self._is_needed |= keyframe.robot in self._unread and keyframe.time_s >= MISSING_AFTER_S
        if not self._is_needed:
            return []
        candidates = []
        for kept in self._kept:
            others = () if kept.robot in self._unread else self._readers
            candidates += self._wifi.propose(kept, [*skipped_robots, *others])
        self._kept.clear()
        return candidates

    def sparsify(self, is_held: Callable[[Keyframe], bool]) -> None:
        """See `Recogniser`."""
        self._wifi.sparsify(is_held)
        self._kept = [keyframe for keyframe in self._kept if is_held(keyframe)]


class ScanRecogniser:
    """Scan Context: similar scans at some rotation."""

    name = "lidar"

    def __init__(self, config: PlaceRecognitionConfig, range_max_m: float):
        self._config, self._range_max_m = config, range_max_m
        self._places = DescribedPlaces()

    def propose(self, keyframe: Keyframe, skipped_robots: Sequence[int] = ()) -> list[LoopCandidate]:
        """See `Recogniser`; returns the most similar places. Of many that look the same, as in rows of rooms, some of
        each robot and from all along its path."""
        if not self._places.is_due(keyframe):
            return []
        descriptor = describe(keyframe.ranges_m, self._range_max_m)
        numbers = self._places.others(keyframe, skipped_robots, self._config.revisit_travel_m)
        alike = zip(*self._places.most_similar(numbers, descriptor), strict=True) if len(numbers) else ()
        candidates = [
            LoopCandidate(self._places.keyframes[k].key, keyframe.key, np.array([0.0, 0.0, turn]), self.name)
            for k, similarity, turn in alike
            if similarity >= self._config.scan_similarity_min
        ]
        self._places.add(keyframe)
        self._places.describe_last(descriptor)
        return candidates

    def sparsify(self, is_held: Callable[[Keyframe], bool]) -> None:
        """See `Recogniser`."""
        self._places.sparsify(is_held)

    def score(self, target: Keyframe, source: Keyframe) -> float:
        """Similarity of the two scans at the best rotation."""
        scans = (describe(keyframe.ranges_m, self._range_max_m) for keyframe in (target, source))
        return compare(*scans)[0]
