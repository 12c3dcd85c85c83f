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

from twc_env.geometry import compose

Array = NDArray

STEP_MAX_M = 0.15
"""Neighbouring beams on one disc differ by less than this ..."""
BACKGROUND_MIN_M = 0.25
"""... and what lies beside it is further away by more than this."""
SHAPE_TOLERANCE_M = 0.035
FEW_BEAMS = 4
"""With fewer beams than this the shape is not judged."""
DISCS_MAX = 32
STILL_M, STILL_S, STILL_TRAVEL_M = 0.2, 5.0, 2.0
"""A disc met again this near after so long, from that much further along the path, stands there for good."""
MEMORY = 100
"""Discs remembered."""


@njit(cache=True, error_model="numpy")
def _mark(ranges, range_max, radius, out, discs):
    """Write the marked scan to out and a row (x, y, first beam, beams) for each disc; gives how many there are."""
    found = 0
    beams = ranges.shape[0]
    step = 2 * math.pi / beams
    out[:] = ranges
    start = -1
    for i in range(beams):  # begin behind a jump, so that no disc is cut in two
        if abs(ranges[i] - ranges[i - 1]) > STEP_MAX_M:
            start = i
            break
    if start < 0:
        return found
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
            if found < discs.shape[0]:
                discs[found, 0], discs[found, 1], discs[found, 2], discs[found, 3] = cx, cy, first % beams, count
                found += 1
    return found


def mark_mates(ranges_m: Array, range_max_m: float, radius_m: float) -> tuple[Array, Array]:
    """A scan (beams,) in which the beams that met a mate are negative: free up to there, but no wall.

    radius_m is that of a robot; 0 marks nothing. Also gives a row (x [m], y [m], first beam, beams) for each mate, its
    centre in the robot frame.
    """
    marked, discs = np.array(ranges_m, np.float64), np.empty((DISCS_MAX, 4))
    count = _mark(ranges_m, range_max_m, radius_m, marked, discs) if radius_m > 0 else 0
    return marked, discs[:count]


class StillDiscs:
    """Remembers where discs were seen, so that a pillar as wide as a robot is drawn after all: it never moves."""

    def __init__(self):
        self._seen = np.full((MEMORY, 4), np.inf)
        """Rows (x, y in the odom frame, travel and time when first seen there); the oldest is overwritten."""
        self._next = 0

    def unmark(self, scan: Array, discs: Array, pose_odom: Array, travel_m: float, time_s: float) -> None:
        """Make the beams (beams,) on discs that stood still for long, seen from more than one place, walls again."""
        for x, y, first, count in discs.tolist():
            centre = compose(pose_odom, [x, y, 0.0])[:2]
            away = np.abs(self._seen[:, :2] - centre).max(axis=1)
            held = int(np.argmin(away))
            if away[held] >= STILL_M:
                self._seen[self._next] = *centre, travel_m, time_s
                self._next = (self._next + 1) % MEMORY
            elif time_s - self._seen[held, 3] >= STILL_S and travel_m - self._seen[held, 2] >= STILL_TRAVEL_M:
                beams = (int(first) + np.arange(int(count))) % len(scan)
                scan[beams] = np.abs(scan[beams])
