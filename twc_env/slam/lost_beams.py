"""Beams without a return that may have been lost, though a wall is there: nothing is seen through them.

A scanner reads the same where nothing is in reach and where it lost an echo. Lost echoes are few in a row, openings
show by many beams; so a run of few beams without a return counts as free up to the nearer of what stands beside it.
Else the floor beyond each wall would count as seen, and nothing would ever say otherwise.
"""

from __future__ import annotations

import math

from twc_env.kernels import borrowing_kernel

CHANCE = 1e-4
"""That in one scan a run of lost beams is as long as an opening must be."""
NEAR_M = 1e-6
"""Free up to there, where no beam returned at all: nothing is."""


def opening_beams(beams: int, dropout_probability: float) -> int:
    """Neighbouring beams without a return that make an opening; a run as long starts at one of `beams` by chance."""
    if dropout_probability <= 0.0:
        return 1
    if dropout_probability >= 1.0:
        return beams + 1
    return max(1, math.ceil(math.log(CHANCE / beams) / math.log(dropout_probability)))


@borrowing_kernel
def bridge(ranges, range_max, opening, is_lost, out):
    """Write the scan to out, in which runs of fewer than `opening` beams without a return are as near as the nearer of
    the beams beside them; is_lost (beams,) bool says which these are. Gives whether there are any."""
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
    """Make lost beams negative: free up to there, but no wall."""
    for i in range(marked.shape[0]):
        if is_lost[i]:
            marked[i] = -abs(marked[i])
