"""Places of robots that share no map, recognised by WiFi alone: they meet before both have read the same signs."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection

import numpy as np

from twc_env.config import PlaceRecognitionConfig
from twc_env.messages import Keyframe, LoopCandidate, LoopClosure
from twc_env.slam.place_cues import rssi_cue
from twc_env.slam.sign_table import RadioRule, SignTable

MEETING = "meeting"
"""The name of such candidates."""
STEP_M, SILENT_STEP_M = 1.0, 3.0
"""Places are remembered, and compared, this often along a path; compared so often where none sounded alike."""
SHARED_MIN = 10
"""Places that hear fewer transmitters alike are not compared: those of two or three access points tell too little, and
where rooms repeat, scans that fit by chance agree with each other."""
CANDIDATES_MAX = 3
"""Of a keyframe so many places, those that sound most alike, are tried; of a robot whose last match was refused one."""
REST_M, RESTS_MAX = 2.0, 4
"""Two robots of which a match is refused are not compared until they have gone so far, together; after the next one in
a row twice as far, and so on up to so many."""
ANY_TEXT, NOT_READ = 0, ""
"""The table of signs takes all places for such at which one sign was read."""


class MeetingRecogniser:
    """Compares a keyframe with the places of robots in other maps; robots of one map cost next to nothing."""

    def __init__(self, config: PlaceRecognitionConfig, robot_count: int):
        self._config, self._robots = config, range(robot_count)
        self._places: list[Keyframe] = []
        """About STEP_M apart along each robot's path; the first of them are the rows of the table."""
        self._table = SignTable()
        self._row_count = 0
        self._radio = RadioRule.of(config)
        self._last_m, self._compared_from_m = [-math.inf] * robot_count, [-math.inf] * robot_count
        """Of each robot the path to its last place, and to where it is compared again."""
        self._refused: dict[tuple[int, int], tuple[int, float]] = {}
        """Of two robots how many matches were refused in a row, and the sum of their paths until which they rest."""

    def propose(self, keyframe: Keyframe, mates: Collection[int]) -> list[LoopCandidate]:
        """Candidates between this keyframe and earlier ones of robots that are not its mates; it is remembered."""
        robot = keyframe.robot
        if keyframe.travel_m - self._last_m[robot] < STEP_M:
            return []
        self._last_m[robot] = keyframe.travel_m
        candidates: list[LoopCandidate] = []
        if keyframe.travel_m >= self._compared_from_m[robot]:
            skipped = [other for other in self._robots if other in mates or self._rests(robot, other)]
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
        """What has become of a candidate: where matches are refused, its two robots are compared less often."""
        a, b = _pair(closure.candidate.target[0], closure.candidate.source[0])
        if closure.status == "accepted":
            self._refused.pop((a, b), None)
            return
        count = min(self._refused.get((a, b), (0, 0.0))[0] + 1, RESTS_MAX)
        self._refused[a, b] = count, self._last_m[a] + self._last_m[b] + REST_M * 2 ** (count - 1)

    def forget(self, is_held: Callable[[Keyframe], bool]) -> None:
        """See `Recogniser`."""
        is_kept = np.array([is_held(keyframe) for keyframe in self._places], bool)
        if self._row_count:
            self._table.keep(is_kept[: self._row_count], np.zeros(1, np.int64), ())
        self._row_count = int(np.count_nonzero(is_kept[: self._row_count]))
        self._places = [self._places[k] for k in np.flatnonzero(is_kept).tolist()]


def _pair(a: int, b: int) -> tuple[int, int]:
    return (a, b) if a < b else (b, a)
