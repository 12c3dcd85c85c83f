"""Places recognised by WiFi where no sign is read, beside a recogniser that needs signs."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from twc_env.config import PlaceRecognitionConfig
from twc_env.messages import Keyframe, LoopCandidate
from twc_env.slam.sign_table import MISSING_AFTER_S
from twc_env.slam.wayside_recognisers import WifiRecogniser

CANDIDATES_MAX = 3
"""Most candidates of one keyframe."""


class SignlessRecogniser:
    """Compares by WiFi robots that share no map; inside one, those that have read no sign for long with all others.

    A cue that is missing says nothing against a place, and robots cross each other's ways long before both have read
    the same sign; Algorithm 1 of TWC-SLAM would not compare them there, as it asks for like texts first.
    """

    def __init__(self, config: PlaceRecognitionConfig, range_max_m: float, robot_count: int):
        self._wifi = WifiRecogniser(config, range_max_m, CANDIDATES_MAX, guesses_turn=False)
        self._unread, self._signless = set(range(robot_count)), set[int]()
        """Robots that have read no sign yet, and those of them that have not for long."""

    def propose(self, keyframe: Keyframe, mates: Sequence[int], is_tied: bool) -> list[LoopCandidate]:
        """Candidates between this keyframe and earlier ones.

        mates: the robots of its own map, itself among them; while `is_tied`, it is compared with none of these.
        """
        robot = keyframe.robot
        if robot in self._unread:
            if keyframe.signs:
                self._unread.remove(robot)
                self._signless.discard(robot)
            elif keyframe.time_s >= MISSING_AFTER_S:
                self._signless.add(robot)
        if not is_tied and robot in self._signless:
            mates = ()
        elif not is_tied and self._signless:
            mates = [mate for mate in mates if mate not in self._signless]
        return self._wifi.propose(keyframe, mates)

    def forget(self, is_held: Callable[[Keyframe], bool]) -> None:
        """See `Forgetful`."""
        self._wifi.forget(is_held)
