"""Table of all places where a sign was read, with their fingerprints, to find those similar to a new keyframe."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.config import PlaceRecognitionConfig
from twc_env.kernels.compiled import BindsAnew, Lent, borrowing_kernel, bound, kernel, parts_of, rebound
from twc_env.records.growing_arrays import READINGS_ROOM, ROOM, grown, lazy_zeros, only
from twc_env.records.messages import Keyframe
from twc_env.slam.places.device_offsets import DeviceOffsets
from twc_env.slam.places.radio_fingerprint import rssi_similarity

MISSING_AFTER_S = 20.0
"""A robot without any sign reading, or any received transmitter, this long after the start counts as lacking that
cue."""
UNLIKE = -1.0
"""Similarity value of texts that are not similar."""


class RadioRule(NamedTuple):
    """Thresholds for the radio similarity of two places."""

    mac_similarity_min: float
    rssi_similarity_min: float
    rssi_tolerance_db: float
    spares_deaf: bool = False
    """Whether the radio test is skipped for robots that received nothing for MISSING_AFTER_S."""

    @classmethod
    def of(cls, config: PlaceRecognitionConfig, spares_deaf: bool = False) -> RadioRule:
        """The thresholds of a config; strengths are left to `rssi_cue` unless the mode is `saturating`."""
        rssi_min = config.rssi_similarity_min - 1e-9 if config.rssi_mode == "saturating" else -math.inf
        return cls(config.mac_similarity_min - 1e-9, rssi_min, config.rssi_tolerance_db, spares_deaf)


@kernel
def _compare(macs, levels, first, end, other_macs, other_levels, offset, faintest, other_faintest, mac_min):
    """`mac_similarity`, and distance and count of `rssi_distance_db`, of a table row and another fingerprint.

    offset [dB]: how much stronger the other's receiver reads. A transmitter that would be below the other's weakest
    reading [dBm] does not count as missing. All 0 if one side lacks so many that `mac_similarity` is below `mac_min`.
    """
    i, j, n, squares, length, other_length = first, 0, 0, 0.0, 0, 0
    may_miss, other_may_miss = (1.0 - mac_min) * (end - first), (1.0 - mac_min) * other_macs.shape[0]
    while i < end or j < other_macs.shape[0]:
        if length > may_miss or other_length > other_may_miss:
            return 0.0, 0.0, 0
        if j == other_macs.shape[0] or (i < end and macs[i] < other_macs[j]):
            length += offset >= 0.0 or levels[i] + offset >= other_faintest
            i += 1
        elif i == end or macs[i] > other_macs[j]:
            other_length += offset <= 0.0 or other_levels[j] - offset >= faintest
            j += 1
        else:
            squares += (levels[i] + offset - other_levels[j]) ** 2
            n += 1
            i += 1
            j += 1
    larger = n + max(length, other_length)
    return (n / larger if larger > 0 else 0.0), math.sqrt(squares), n


@borrowing_kernel
def _choose(table, place_count, robot, latest, other_macs, other_levels, mac_min, rssi_min, tolerance, spares_deaf):
    """See `SignTable.like`; writes the rows found to the table's output (places, 6) and returns their number."""
    places, travels, ends, macs, levels, out, likeness, is_skipped, is_deaf, _, offsets, faintest = parts_of(table)
    count = 0
    for k in range(place_count):
        other, similarity = places[k, 0], likeness[places[k, 1]]
        if similarity == UNLIKE or is_skipped[other] or (other == robot and travels[k] > latest):
            continue
        first = ends[k - 1] if k > 0 else np.int64(0)
        is_spared = spares_deaf and (is_deaf[robot] or is_deaf[other])
        shared, distance, number = _compare(
            macs, levels, first, ends[k], other_macs, other_levels, offsets[other, robot], faintest[other],
            faintest[robot], 0.0 if is_spared else mac_min,
        )  # fmt: skip
        rssi = rssi_similarity(distance, number, tolerance)
        if (shared >= mac_min and rssi >= rssi_min) or is_spared:
            out[count, 0], out[count, 1], out[count, 2], out[count, 3] = k, similarity, shared, rssi
            out[count, 4], out[count, 5] = distance, number
            count += 1
    return count


@borrowing_kernel
def _put(table, row, robot, text, travel, is_early, macs, levels):
    """Write a new row."""
    places, travels, ends, all_macs, all_levels, _, _, _, is_deaf, has_heard, _, _ = parts_of(table)
    first = ends[row - 1] if row > 0 else np.int64(0)
    for k in range(macs.shape[0]):
        all_macs[first + k], all_levels[first + k] = macs[k], levels[k]
    places[row, 0], places[row, 1], travels[row], ends[row] = robot, text, travel, first + macs.shape[0]
    has_heard[robot] |= macs.shape[0] > 0
    is_deaf[robot] = not (is_early or has_heard[robot])


class SignTable(BindsAnew):
    """A row per place: robot, text, path length, and fingerprint."""

    def __init__(self) -> None:
        self._places, self._travels_m = np.zeros((ROOM, 2), np.int64), np.zeros(ROOM)
        """Robot and text number; path length."""
        self._ends, self._found = np.zeros(ROOM, np.int64), np.zeros((ROOM, 6))
        """End of each row's fingerprint, which starts at the end of the previous one; output rows of a query."""
        self._macs, self._rssi_dbm = lazy_zeros((READINGS_ROOM,), np.int64), lazy_zeros((READINGS_ROOM,))
        """Fingerprints of all rows, concatenated."""
        self._likeness, self._is_skipped = np.full(ROOM, UNLIKE), np.zeros(0, bool)
        """Similarity of each text to the query, and robots to skip; reset after each query."""
        self._count = self._end = 0
        self._devices = DeviceOffsets()
        self._is_deaf, self._has_heard = np.zeros(0, bool), np.zeros(0, bool)
        self._first_m: dict[int, dict[int, float]] = {}
        """Text number -> robot -> path length at which it first read the text."""
        self._choose: Callable[..., int] | None = None
        self._put: Callable[..., None] | None = None
        """The kernels of these names, bound to these arrays."""

    def append(self, keyframe: Keyframe, text: str, number: int) -> list[int]:
        """Add a row for a text of this number, read at a keyframe.

        Returns the robots whose receivers are now known to differ from the keyframe's: places may be similar that were
        not.
        """
        heard, row = keyframe.fingerprint, self._count
        self._count, self._end = row + 1, self._end + len(heard.macs)
        self._make_room(keyframe.robot, number)
        is_early = keyframe.time_s < MISSING_AFTER_S
        new = row, keyframe.robot, number, keyframe.travel_m, is_early, heard.macs, heard.rssi_dbm
        if self._put is None:
            self._put = bound(_put, self._all(), *new)
        self._put(*new)
        self._note_first(keyframe.robot, number, keyframe.travel_m)
        return self._devices.note(keyframe.robot, text, heard)

    def keep(self, is_kept: Array, number_of: Array, texts: Collection[str]) -> None:
        """Keep only some rows (rows,) bool, with new text numbers by the old ones; `texts` are all remaining texts.

        Receiver offsets stay.
        """
        count, end = self._count, self._end
        of_row = np.repeat(is_kept, np.diff(self._ends[:count], prepend=0))
        self._places[:count, 1] = number_of[self._places[:count, 1]]
        self._places, self._travels_m = only(self._places[:count], is_kept), only(self._travels_m[:count], is_kept)
        self._macs, self._rssi_dbm = only(self._macs[:end], of_row), only(self._rssi_dbm[:end], of_row)
        ends = np.append(0, np.cumsum(of_row))[self._ends[:count]]
        self._ends, self._found = only(ends, is_kept), np.zeros((len(self._travels_m), 6))
        self._count, self._end = int(np.count_nonzero(is_kept)), int(np.count_nonzero(of_row))
        self._choose = self._put = None
        self._first_m.clear()
        for (robot, text), travel_m in zip(
            self._places[: self._count].tolist(), self._travels_m[: self._count].tolist(), strict=True
        ):
            self._note_first(robot, text, travel_m)
        self._devices.keep(texts)

    def _note_first(self, robot: int, text: int, travel_m: float) -> None:
        first_m = self._first_m.setdefault(text, {})
        first_m[robot] = min(first_m.get(robot, math.inf), travel_m)

    def _make_room(self, robot: int, text: int = 0) -> None:
        """Ensure capacity for all rows and readings, and for a robot and a text of these numbers."""
        robots, texts = len(self._is_skipped), len(self._likeness)
        if robot < robots and text < texts and self._end <= len(self._macs) and self._count <= len(self._places):
            return
        if text >= texts:
            self._likeness = np.full(2 * texts, UNLIKE)
        if robot >= robots:
            more = max(robot + 1, 2 * robots) - robots
            self._devices.make_room(robots + more)
            self._is_deaf, self._has_heard = np.pad(self._is_deaf, (0, more)), np.pad(self._has_heard, (0, more))
            self._is_skipped = np.zeros(robots + more, bool)
        while self._end > len(self._macs):
            self._macs, self._rssi_dbm = grown(self._macs), grown(self._rssi_dbm)
        if self._count > len(self._places):
            self._places, self._travels_m = grown(self._places), grown(self._travels_m)
            self._ends, self._found = grown(self._ends), grown(self._found)
        held = self._all()
        self._choose, self._put = rebound(self._choose, held), rebound(self._put, held)

    def _all(self) -> Lent:
        places = self._places, self._travels_m, self._ends, self._macs, self._rssi_dbm, self._found, self._likeness
        robots = self._is_skipped, self._is_deaf, self._has_heard, self._devices.offset_db, self._devices.faintest_dbm
        return Lent((*places, *robots))

    def like(
        self, alike: Sequence[tuple[int, float]], keyframe: Keyframe, skipped_robots: Sequence[int], apart_m: float,
        radio: RadioRule,
    ) -> list[list[float]]:  # fmt: skip
        """The rows whose text and radio are similar to those of a keyframe, ascending.

        alike: numbers and similarities of the texts that qualify. Rows of skipped robots are left out, and rows of the
        keyframe's own robot less than apart_m before it along the path. Each row: its index, text similarity,
        `mac_similarity`, `rssi_similarity`, distance [dB] and count of `rssi_distance_db`.
        """
        if keyframe.robot >= len(self._is_skipped):
            self._make_room(keyframe.robot)
        latest_m = keyframe.travel_m - apart_m
        if not self._has_any(alike, keyframe.robot, latest_m, skipped_robots):
            return []
        likeness, is_skipped = self._likeness, self._is_skipped
        for robot in skipped_robots:
            if robot < len(is_skipped):
                is_skipped[robot] = True
        for text, similarity in alike:
            likeness[text] = similarity
        heard = keyframe.fingerprint
        now = self._count, keyframe.robot, latest_m, heard.macs, heard.rssi_dbm, *radio
        if self._choose is None:
            self._choose = bound(_choose, self._all(), *now)
        rows: list[list[float]] = self._found[: self._choose(*now)].tolist()
        is_skipped[:] = False
        for text, _ in alike:
            likeness[text] = UNLIKE
        return rows

    def _has_any(
        self, alike: Sequence[tuple[int, float]], own: int, latest_m: float, skipped_robots: Sequence[int]
    ) -> bool:
        """Whether a robot that is not skipped has read one of these texts; the keyframe's own robot not after
        latest_m."""
        for text, _ in alike:
            for robot, first_m in self._first_m.get(text, {}).items():
                if robot not in skipped_robots and (robot != own or first_m <= latest_m):
                    return True
        return False
