"""Treatment of beams without a return whose echo may have been lost (dropout).

A scanner gives the same reading if nothing is in range and if an echo is lost. Dropouts affect few neighbouring beams,
openings many. A short run of beams without a return therefore counts as free only up to the nearer of the beams beside
it. Otherwise the floor behind a wall would be marked free, and later scans would not correct it.
"""

from __future__ import annotations

import math

from twc_env.kernels.compiled import borrowing_kernel

CHANCE = 1e-4
"""Probability per scan that a run of dropouts is long enough to count as an opening."""
NEAR_M = 1e-6
"""Range of lost beams if no beam has a return: nothing is free."""


def opening_beams(beams: int, dropout_probability: float) -> int:
    """Number of neighbouring beams without a return that count as an opening: dropouts are that long with `CHANCE`."""
    if dropout_probability <= 0.0:
        return 1
    if dropout_probability >= 1.0:
        return beams + 1
    return max(1, math.ceil(math.log(CHANCE / beams) / math.log(dropout_probability)))


@borrowing_kernel
def bridge(ranges, range_max, opening, is_lost, out):
    """Write the scan to out, with runs of fewer than `opening` beams without a return set to the nearer beam beside
    them. Writes is_lost (beams,) bool, true for these beams; returns whether there are any."""
    beams = ranges.shape[0]
    first = -1
    for i in range(beams):
        out[i], is_lost[i] = ranges[i], False
        if first < 0 and ranges[i] < range_max:
            first = i
    if first < 0:
        if beams < opening:
            out[:], is_lost[:] = NEAR_M, True
        return beams < opening
    has_lost, begun = False, first
    for k in range(first + 1, first + beams + 1):
        i = k % beams
        if ranges[i] >= range_max:
            continue
        if 1 < k - begun <= opening:
            has_lost, nearer = True, min(ranges[begun % beams], ranges[i])
            for lost in range(begun + 1, k):
                out[lost % beams], is_lost[lost % beams] = nearer, True
        begun = k
    return has_lost


@borrowing_kernel
def mark_lost(is_lost, marked):
    """Make lost beams negative: free up to that range, but no wall."""
    for i in range(marked.shape[0]):
        if is_lost[i]:
            marked[i] = -abs(marked[i])
