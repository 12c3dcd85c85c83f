"""Where a scan leaves room to get away."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray as Array


def open_bearing(ranges_m: Array | None, random: np.random.Generator) -> float:
    """A bearing [rad] in the robot's frame drawn among the open ones of a scan (beams,), the wider the likelier."""
    if ranges_m is None or len(ranges_m) == 0:
        return float(random.uniform(-math.pi, math.pi))
    beams = len(ranges_m)
    half = max(1, round(beams * 0.04))
    ring = np.minimum(np.concatenate([ranges_m[-half:], ranges_m, ranges_m[:half]]), 3.0)
    room = np.lib.stride_tricks.sliding_window_view(ring, 2 * half + 1).min(axis=1)
    weight = np.maximum(room - 0.3, 0.0) ** 2 + 1e-9
    beam = int(random.choice(beams, p=weight / weight.sum()))
    return math.remainder(2 * math.pi * beam / beams, 2 * math.pi)


def is_open_behind(ranges_m: Array | None, radius_m: float) -> bool:
    """Whether a robot of this radius can back up a little, by its scan (beams,)."""
    if ranges_m is None or len(ranges_m) == 0:
        return False
    beams = len(ranges_m)
    behind = ranges_m[beams // 2 - beams // 6 : beams // 2 + beams // 6 + 1]
    return bool(behind.min() > radius_m + 0.25)
