"""Position of a keyframe on a robot's path, from which others may have been removed."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Sequence
from operator import attrgetter

from twc_env.records.messages import Keyframe

_index = attrgetter("index")


def path_position(path: Sequence[Keyframe], index: int) -> int:
    """Position in a robot's path (its stored keyframes, in order) of the keyframe with this index."""
    if index < len(path) and path[index].index == index:
        return index
    return bisect_left(path, index, key=_index)
