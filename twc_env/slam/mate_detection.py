"""Find the beams that met a team mate: mates move, so they must neither be matched nor drawn as walls.

Robots are discs of a known radius. A run of neighbouring beams, nearer than what lies on both sides of it, whose end
points lie on such a disc is taken for one; far away, where too few beams meet a disc to see its shape, any thing as
narrow as a disc is.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray

STEP_MAX_M = 0.15
"""Neighbouring beams on one disc differ by less than this ..."""
BACKGROUND_MIN_M = 0.25
"""... and what lies beside it is further away by more than this."""
SHAPE_TOLERANCE_M = 0.035
FEW_BEAMS = 4
"""With fewer beams than this the shape is not judged."""


@njit(cache=True, error_model="numpy")
def _mark(ranges, range_max, radius, out):
    beams = ranges.shape[0]
    step = 2 * math.pi / beams
    out[:] = ranges
    start = -1
    for i in range(beams):  # begin behind a jump, so that no disc is cut in two
        if abs(ranges[i] - ranges[i - 1]) > STEP_MAX_M:
            start = i
            break
    if start < 0:
        return
    i = start
    while i < start + beams:
        first = i
        nearest = ranges[i % beams]
        while i + 1 < start + beams and abs(ranges[(i + 1) % beams] - ranges[i % beams]) <= STEP_MAX_M:
            i += 1
            nearest = min(nearest, ranges[i % beams])
        count = i - first + 1
        i += 1
        if nearest >= range_max or nearest <= 0.0:
            continue
        widest = 2 * math.asin(min(radius / (nearest + radius), 1.0)) / step + 2
        if count > widest:
            continue
        if ranges[(first - 1) % beams] < ranges[first % beams] + BACKGROUND_MIN_M:
            continue
        if ranges[i % beams] < ranges[(i - 1) % beams] + BACKGROUND_MIN_M:
            continue
        middle = 0.5 * (first + i - 1) * step
        cx, cy = (nearest + radius) * math.cos(middle), (nearest + radius) * math.sin(middle)
        is_disc = True
        if count >= FEW_BEAMS:
            for k in range(first, i):
                r = ranges[k % beams]
                x, y = r * math.cos(k * step) - cx, r * math.sin(k * step) - cy
                if abs(math.sqrt(x * x + y * y) - radius) > SHAPE_TOLERANCE_M:
                    is_disc = False
        if is_disc:
            for k in range(first, i):
                out[k % beams] = -ranges[k % beams]


def mark_mates(ranges_m: Array, range_max_m: float, radius_m: float) -> Array:
    """A scan (beams,) in which the beams that met a mate are negative: free up to there, but no wall.

    radius_m is that of a robot; 0 marks nothing.
    """
    marked = np.array(ranges_m, np.float64)
    if radius_m > 0:
        _mark(ranges_m, range_max_m, radius_m, marked)
    return marked
