"""Which keyframes of a large map an optimisation holds fixed, so that its time does not grow with the path length.

In a known building, new data hardly moves the map. Older keyframes of a large map are held fixed until it has grown by
a factor since it was last optimised as a whole; the amortised cost per keyframe is constant. After such an
optimisation, keyframes without new information are removed (`keyframe_sparsification`), so that the map stops growing.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray as Array

LARGE_FROM = 2500
"""Maps with fewer keyframes are always optimised as a whole."""
MOVABLE = 1000
"""Number of keyframes before the last optimisation that may still move."""
GROWN = 1.25
"""Growth factor after which a map is optimised as a whole again."""


class FixedKeyframes:
    """Per group, the first keyframe (in order of arrival) that may move."""

    def __init__(self, large_from: int = LARGE_FROM, movable: int = MOVABLE, sparsifies: bool = True) -> None:
        """sparsifies: whether keyframes without new information are removed."""
        self._large_from, self._movable, self._sparsifies = large_from, movable, sparsifies
        self._whole: dict[tuple[int, ...], int] = {}
        self._latest: dict[tuple[int, ...], int] = {}
        """Robots of a group -> keyframe count at its last whole optimisation, at its last optimisation ..."""
        self._sparsified: dict[tuple[int, ...], int] = {}
        """... and after its last sparsification."""

    def is_large(self, count: int) -> bool:
        """Whether a map to which this many keyframes were ever added is large."""
        return count >= self._large_from

    def first_movable(self, robots: tuple[int, ...], count: int, arrived: int | None = None) -> int:
        """The first of `count` keyframes that may move in the map of these robots; 0 for all of them.

        arrived: keyframes ever added, including removed ones; `count` if None.
        """
        if not self.is_large(arrived or count) or count >= GROWN * self._whole.get(robots, 0):
            return 0
        return max(self._latest[robots] - self._movable, 0)

    def sparsification_end(self, robots: tuple[int, ...], count: int, arrived: int) -> int:
        """End of the range of keyframes that may be removed after the map was optimised as a whole.

        0 if the map has not grown enough since keyframes were last removed.
        """
        has_grown = count >= GROWN * self._sparsified.get(robots, 0)
        return count - self._movable if self._sparsifies and self.is_large(arrived) and has_grown else 0

    def record_optimised(self, robots: tuple[int, ...], count: int, is_whole: bool) -> None:
        """Record that the map of these robots was optimised at this keyframe count."""
        self._latest[robots] = count
        if is_whole:
            self._whole[robots] = count

    def record_sparsified(self, robots: tuple[int, ...], kept: Array) -> None:
        """Record that keyframes of these robots were removed; kept (k,) lists the remaining ones by their old
        numbers."""
        self._whole, self._latest, self._sparsified = (
            {others: int(np.searchsorted(kept, count)) for others, count in counts.items()}
            for counts in (self._whole, self._latest, self._sparsified)
        )
        self._sparsified[robots] = len(kept)

    def reset(self) -> None:
        """Robots started or stopped sharing a map: no keyframe is fixed."""
        self._whole.clear()
        self._latest.clear()
        self._sparsified.clear()
