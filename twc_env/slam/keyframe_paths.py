"""Where on a robot's path a keyframe is, of which some may have been forgotten."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Sequence
from operator import attrgetter

from twc_env.messages import Keyframe

_index = attrgetter("index")


def place_on(path: Sequence[Keyframe], index: int) -> int:
    """The place of the keyframe of this number among those of its robot, in order, that are held."""
    if index < len(path) and path[index].index == index:
        return index
    return bisect_left(path, index, key=_index)
