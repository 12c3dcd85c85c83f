"""Place recognition by WiFi alone between robots that share no map, before both have read a common sign."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection

import numpy as np

from twc_env.config import PlaceRecognitionConfig
from twc_env.records.messages import Keyframe, LoopCandidate, LoopClosure
from twc_env.slam.places.place_cues import rssi_cue
from twc_env.slam.places.sign_table import RadioRule, SignTable

MEETING = "meeting"
"""`LoopCandidate.recogniser` of these candidates."""
STEP_M, SILENT_STEP_M = 1.0, 3.0
"""Path length between stored places, and between queries while no similar place was found [m]."""
SHARED_MIN = 10
"""Minimum number of shared transmitters. Two or three access points carry too little information, and in buildings with
repeated rooms, scans that match by chance are consistent with each other."""
CANDIDATES_MAX = 3
"""Maximum candidates per keyframe, most similar first; only one per robot whose last match was rejected."""
REST_M, RESTS_MAX = 2.0, 4
"""After a rejected match, a pair of robots is skipped until both together have travelled REST_M; the distance doubles
with each further rejection in a row, RESTS_MAX at most."""
ANY_TEXT, NOT_READ = 0, ""
"""`SignTable` is reused with one dummy text for all places."""


class MeetingRecogniser:
    """Compares keyframes with places of robots in other maps. Robots of one map are skipped at almost no cost."""

    def __init__(self, config: PlaceRecognitionConfig, robot_count: int):
        self._config, self._robots = config, range(robot_count)
        self._places: list[Keyframe] = []
        """Places about STEP_M apart along each robot's path; the first `_row_count` are rows of the table."""
        self._table = SignTable()
        self._row_count = 0
        self._radio = RadioRule.of(config)
        self._last_m, self._compared_from_m = [-math.inf] * robot_count, [-math.inf] * robot_count
        """Per robot: path length at its last stored place, and from which it is compared again [m]."""
        self._refused: dict[tuple[int, int], tuple[int, float]] = {}
        """Pair of robots -> rejections in a row, and the sum of path lengths until which the pair is skipped [m]."""

    def propose(self, keyframe: Keyframe, teammates: Collection[int]) -> list[LoopCandidate]:
        """Candidates between this keyframe and stored places of robots other than `teammates`; stores the keyframe."""
        robot = keyframe.robot
        if keyframe.travel_m - self._last_m[robot] < STEP_M:
            return []
        self._last_m[robot] = keyframe.travel_m
        candidates: list[LoopCandidate] = []
        if keyframe.travel_m >= self._compared_from_m[robot]:
            skipped = [other for other in self._robots if other in teammates or self._rests(robot, other)]
            if len(skipped) < len(self._robots):
                candidates = self._most_alike(keyframe, skipped)
                self._compared_from_m[robot] = keyframe.travel_m + (0.0 if candidates else SILENT_STEP_M)
        self._places.append(keyframe)
        return candidates

    def _most_alike(self, keyframe: Keyframe, skipped: list[int]) -> list[LoopCandidate]:
        for place in self._places[self._row_count :]:
            self._table.append(place, NOT_READ, ANY_TEXT)
        self._row_count = len(self._places)
        rows = self._table.like([(ANY_TEXT, 1.0)], keyframe, skipped, 0.0, self._radio)
        found = []
        for row, _, macs, _, distance_db, shared in rows:
            place = self._places[int(row)]
            rssi, is_alike = rssi_cue(distance_db, int(shared), self._config, (place.fingerprint, keyframe.fingerprint))
            if is_alike and shared >= SHARED_MIN:
                found.append((distance_db / math.sqrt(max(shared, 1.0)), int(row), macs, rssi))
        candidates: list[LoopCandidate] = []
        tried = set[int]()
        for _, row, macs, rssi in sorted(found):
            other = self._places[row].robot
            if other in tried and _pair(keyframe.robot, other) in self._refused:
                continue
            tried.add(other)
            ends = self._places[row].key, keyframe.key
            candidates.append(LoopCandidate(*ends, np.zeros(3), MEETING, mac_similarity=macs, rssi_similarity=rssi))
            if len(candidates) == CANDIDATES_MAX:
                break
        return candidates

    def _rests(self, a: int, b: int) -> bool:
        refused = self._refused.get(_pair(a, b))
        return refused is not None and self._last_m[a] + self._last_m[b] < refused[1]

    def note(self, closure: LoopClosure) -> None:
        """Record the result of geometric verification: after a rejection the pair is compared less often."""
        a, b = _pair(closure.candidate.target[0], closure.candidate.source[0])
        if closure.status == "accepted":
            self._refused.pop((a, b), None)
            return
        count = min(self._refused.get((a, b), (0, 0.0))[0] + 1, RESTS_MAX)
        self._refused[a, b] = count, self._last_m[a] + self._last_m[b] + REST_M * 2 ** (count - 1)

    def sparsify(self, is_held: Callable[[Keyframe], bool]) -> None:
        """See `Recogniser`."""
        is_kept = np.array([is_held(keyframe) for keyframe in self._places], bool)
        if self._row_count:
            self._table.keep(is_kept[: self._row_count], np.zeros(1, np.int64), ())
        self._row_count = int(np.count_nonzero(is_kept[: self._row_count]))
        self._places = [self._places[k] for k in np.flatnonzero(is_kept).tolist()]


def _pair(a: int, b: int) -> tuple[int, int]:
    return (a, b) if a < b else (b, a)
