"""Which part of a map an optimisation may leave as it is, so that its time does not grow with the way gone.

Once a building is known, what comes anew hardly moves its map. So older keyframes of a large map are held where they
are until it has grown by a share of what it was when all of it was last optimised: this costs the same for each new
keyframe. Then keyframes that tell nothing new are forgotten (`forgetting`), so that maps do not grow for ever.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray as Array

LARGE_FROM = 2500
"""Smaller maps are optimised as a whole."""
MOVABLE = 1000
"""Keyframes before the last optimisation, the latest ones, that may still move."""
GROWN = 1.25
"""A map that has grown by this factor is optimised as a whole again."""


class SettledMaps:
    """The first keyframe, counted as they arrived, of each group's map that may move."""

    def __init__(self, large_from: int = LARGE_FROM, movable: int = MOVABLE, forgets: bool = True) -> None:
        """forgets: whether keyframes that tell nothing new are forgotten."""
        self._large_from, self._movable, self._forgets = large_from, movable, forgets
        self._whole: dict[tuple[int, ...], int] = {}
        self._latest: dict[tuple[int, ...], int] = {}
        """How many keyframes there were when the map of these robots was optimised as a whole, and at all ..."""
        self._thinned: dict[tuple[int, ...], int] = {}
        """... and after some of them were forgotten."""

    def is_large(self, count: int) -> bool:
        """Whether a map is to which so many keyframes ever came."""
        return count >= self._large_from

    def first_movable(self, robots: tuple[int, ...], count: int, arrived: int | None = None) -> int:
        """The first of `count` keyframes that may move in the map of these robots; 0 for all of them.

        arrived: so many ever came; as many as are held where none is given.
        """
        if not self.is_large(arrived or count) or count >= GROWN * self._whole.get(robots, 0):
            return 0
        return max(self._latest[robots] - self._movable, 0)

    def first_unsettled(self, robots: tuple[int, ...], count: int, arrived: int) -> int:
        """The first of `count` keyframes that may not be forgotten now that all of a map has been optimised.

        0 until it has grown by a share since keyframes were forgotten last.
        """
        has_grown = count >= GROWN * self._thinned.get(robots, 0)
        return count - self._movable if self._forgets and self.is_large(arrived) and has_grown else 0

    def note(self, robots: tuple[int, ...], count: int, is_whole: bool) -> None:
        """The map of these robots was optimised when there were so many keyframes."""
        self._latest[robots] = count
        if is_whole:
            self._whole[robots] = count

    def note_thinned(self, robots: tuple[int, ...], kept: Array) -> None:
        """Keyframes of these robots were forgotten: of all only some are left (k,), in this order."""
        self._whole, self._latest, self._thinned = (
            {others: int(np.searchsorted(kept, count)) for others, count in counts.items()}
            for counts in (self._whole, self._latest, self._thinned)
        )
        self._thinned[robots] = len(kept)

    def forget(self) -> None:
        """Robots came to share a map or no longer do: nothing is settled."""
        self._whole.clear()
        self._latest.clear()
        self._thinned.clear()
