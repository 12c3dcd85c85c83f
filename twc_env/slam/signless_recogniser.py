"""Places recognised by WiFi for robots that read no signs, beside a recogniser that needs them."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from twc_env.config import PlaceRecognitionConfig
from twc_env.messages import Keyframe, LoopCandidate
from twc_env.slam.sign_table import MISSING_AFTER_S
from twc_env.slam.wayside_recognisers import WifiRecogniser


class SignlessRecogniser:
    """Compares by WiFi robots that have read no sign for long with all others, until each has read one.

    A cue that is missing altogether says nothing against a place; Algorithm 1 of TWC-SLAM would never compare such
    robots, as it asks for like texts first.
    """

    def __init__(self, config: PlaceRecognitionConfig, range_max_m: float, robot_count: int):
        self._wifi = WifiRecogniser(config, range_max_m)
        self._unread, self._readers = set(range(robot_count)), list[int]()
        self._kept: list[Keyframe] = []
        """Until one is needed."""
        self._is_needed = False

    def propose(self, keyframe: Keyframe, skipped_robots: Sequence[int] = ()) -> list[LoopCandidate]:
        """Candidates between this keyframe and earlier ones of robots that are not skipped, of which one reads none.

        As soon as the first robot turns out to read none, also those between all earlier ones.
        """
        if keyframe.signs and keyframe.robot in self._unread:
            self._unread.remove(keyframe.robot)
            self._readers.append(keyframe.robot)
        if not self._unread:
            self._kept.clear()
            return []
        self._kept.append(keyframe)
        self._is_needed |= keyframe.robot in self._unread and keyframe.time_s >= MISSING_AFTER_S
        if not self._is_needed:
            return []
        candidates = []
        for kept in self._kept:
            others = () if kept.robot in self._unread else self._readers
            candidates += self._wifi.propose(kept, [*skipped_robots, *others])
        self._kept.clear()
        return candidates

    def forget(self, is_held: Callable[[Keyframe], bool]) -> None:
        """See `Recogniser`."""
        self._wifi.forget(is_held)
        self._kept = [keyframe for keyframe in self._kept if is_held(keyframe)]
