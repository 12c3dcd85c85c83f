"""Noise of a laser scanner's ranges, which may grow with range."""

from __future__ import annotations

import math
from typing import NamedTuple


class RangeNoise(NamedTuple):
    """Standard deviation of ranges: the root of the sum of the squares of a constant and of a share of the range."""

    std_m: float = 0.0
    per_m: float = 0.0
    typical_range_m: float = 0.0
    """Range of most walls."""

    @property
    def typical_std_m(self) -> float:
        """Standard deviation at the typical range."""
        return math.hypot(self.std_m, self.per_m * self.typical_range_m)
