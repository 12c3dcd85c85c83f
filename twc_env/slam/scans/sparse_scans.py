"""Interpolates beams of scans with few beams, so that walls are mapped without gaps.

The free space of a scan ends on the straight lines between neighbouring end points. Where these are close to each
other, the line is mapped as a wall.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.kernels.compiled import borrowing_kernel
from twc_env.records.geometry import beam_directions
from twc_env.slam.scans.lost_beams import NEAR_M

BEAMS_ENOUGH = 180
"""Scans with at least this many beams are not interpolated."""
JUMP_MAX_M = 0.5
"""No wall is assumed between neighbouring end points further apart: it may be a doorway."""


@borrowing_kernel
def _fill(scans, directions, range_max, ends, is_met, filled):
    """`SparseScans.filled`; ends (2, beams) and is_met (beams,) are work arrays."""
    x, y, beams = ends[0], ends[1], scans.shape[1]
    times = filled.shape[1] // beams
    for k in range(scans.shape[0]):
        for i in range(beams):
            r = min(abs(scans[k, i]), range_max)
            x[i], y[i] = r * directions[i * times, 0], r * directions[i * times, 1]
            is_met[i] = 0.0 <= scans[k, i] < range_max
        for i in range(beams):
            j = i + 1 if i + 1 < beams else 0
            dx, dy, area = x[j] - x[i], y[j] - y[i], x[i] * y[j] - y[i] * x[j]
            is_wall = is_met[i] and is_met[j] and dx * dx + dy * dy <= JUMP_MAX_M**2
            filled[k, i * times] = scans[k, i]
            for between in range(i * times + 1, (i + 1) * times):
                across = directions[between, 0] * dy - directions[between, 1] * dx
                r = max(area / across if across > 0.0 else 0.0, NEAR_M)
                filled[k, between] = r if is_wall else -r


class SparseScans:
    """Interpolation of the scans of one scanner."""

    def __init__(self, beams: int, range_max_m: float):
        self._times, self._range_max_m = max(1, -(-BEAMS_ENOUGH // beams)), range_max_m
        self.beam_count = self._times * beams
        """Number of beams after interpolation."""
        self.directions = beam_directions(self.beam_count)
        """(beam_count, 2) cosine and sine."""
        self._room = np.empty((2, beams)), np.empty(beams, bool)

    def filled(self, scans: Array) -> Array:
        """Scans (k, beams) with interpolated beams, (k, beam_count), that end on the line between neighbouring end
        points; negative (free up to there, without a wall) where these are far apart or a beam had no return."""
        if self._times == 1:
            return scans
        filled = np.empty((len(scans), self.beam_count))
        _fill(scans, self.directions, self._range_max_m, *self._room, filled)
        return filled
