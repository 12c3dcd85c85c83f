"""Open directions of a scan."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.planning import room_around_m
from twc_env.records.messages import UNSEEN_M

UNSEEN_SHARE_MAX = 0.25
"""Share of the beams behind the robot that may be without information when it drives back."""


def open_bearing(ranges_m: Array | None, random: np.random.Generator) -> float:
    """A random open bearing [rad] of a scan (beams,) in the robot frame, weighted by the free space there."""
    if ranges_m is None or len(ranges_m) == 0:
        return float(random.uniform(-math.pi, math.pi))
    weight = np.maximum(room_around_m(ranges_m) - 0.3, 0.0) ** 2 + 1e-9
    beam = int(random.choice(len(weight), p=weight / weight.sum()))
    return math.remainder(2 * math.pi * beam / len(weight), 2 * math.pi)


def is_open_behind(ranges_m: Array | None, radius_m: float) -> bool:
    """Whether the scan (beams,) leaves a robot of this radius room to move back a little.

    It does not where more than `UNSEEN_SHARE_MAX` of the beams behind say nothing.
    """
    if ranges_m is None or len(ranges_m) == 0:
        return False
    beams = len(ranges_m)
    behind = ranges_m[beams // 2 - beams // 6 : beams // 2 + beams // 6 + 1]
    seen = np.abs(behind[behind != UNSEEN_M])
    return len(seen) >= (1.0 - UNSEEN_SHARE_MAX) * len(behind) and bool(seen.min(initial=np.inf) > radius_m + 0.25)
