"""Find the beams that met a team mate: mates move, so they must neither be matched nor drawn as walls.

Robots are discs of a known radius. A run of neighbouring beams, nearer than what lies on both sides of it, whose end
points lie on such a disc is taken for one; far away, where too few beams meet a disc to see its shape, any thing as
narrow as a disc is.
"""

from __future__ import annotations

import math

import numpy as np

from twc_env.kernels import borrowing_kernel, kernel

STEP_MAX_M = 0.15
"""Neighbouring beams on one disc differ by less than this ..."""
BACKGROUND_MIN_M = 0.25
"""... and what lies beside it is further away by more than this."""
SHAPE_TOLERANCE_M = 0.035
FEW_BEAMS = 4
"""With fewer beams than this the shape is not judged."""
DISCS_MAX = 32
"""In one scan."""
STILL_M, STILL_S, STILL_TRAVEL_M = 0.2, 5.0, 2.0
"""A disc met again this near after so long, from that much further along the path, stands there for good."""
NO_RETURN_M = 1e6
"""In place of infinity."""
MEMORY = 100
"""Discs that a robot remembers, so that a pillar as wide as a robot is drawn after all: it never moves."""


@borrowing_kernel
def _is_disc(ranges, directions, first, count, cx, cy, radius):
    """Whether the end points of these beams lie on the disc."""
    beams = ranges.shape[0]
    for k in range(first, first + count):
        i = k % beams
        x, y = ranges[i] * directions[i, 0] - cx, ranges[i] * directions[i, 1] - cy
        if abs(math.sqrt(x * x + y * y) - radius) > SHAPE_TOLERANCE_M:
            return False
    return True


@borrowing_kernel
def mark_mates(ranges, range_max, radius, directions, is_jump, jumps, out, discs):
    """Write the marked scan to out and a row (x, y, first beam, beams) for each disc; gives how many there are.

    radius is that of a robot; 0 marks nothing. is_jump (beams,) bool and jumps (beams + 1,) int64 are room to work in.
    """
    beams = ranges.shape[0]
    step = 2 * math.pi / beams
    for i in range(beams):
        out[i] = ranges[i]
    is_jump[0] = abs(ranges[0] - ranges[beams - 1]) > STEP_MAX_M
    for i in range(1, beams):  # many beams at once
        is_jump[i] = abs(ranges[i] - ranges[i - 1]) > STEP_MAX_M
    count = 0
    for i in range(beams):
        jumps[count] = i
        count += is_jump[i]
    if radius <= 0.0 or count == 0:
        return 0
    jumps[count] = jumps[0] + beams
    found = 0
    for m in range(count):
        first, end = jumps[m], jumps[m + 1]
        if ranges[first - 1] < ranges[first] + BACKGROUND_MIN_M:
            continue
        beyond = end - beams if end >= beams else end  # quicker than a remainder
        if ranges[beyond] < ranges[beyond - 1] + BACKGROUND_MIN_M:
            continue
        nearest = ranges[first]
        for k in range(first + 1, end):
            nearest = min(nearest, ranges[k % beams])
        if nearest >= range_max or nearest <= 0.0:
            continue
        if end - first > 2 * math.asin(min(radius / (nearest + radius), 1.0)) / step + 2:
            continue
        middle = 0.5 * (first + end - 1) * step
        cx, cy = (nearest + radius) * math.cos(middle), (nearest + radius) * math.sin(middle)
        if end - first >= FEW_BEAMS and not _is_disc(ranges, directions, first, end - first, cx, cy, radius):
            continue
        for k in range(first, end):
            out[k % beams] = -ranges[k % beams]
        if found < discs.shape[0]:
            discs[found, 0], discs[found, 1], discs[found, 2], discs[found, 3] = cx, cy, first, end - first
            found += 1
    return found


@borrowing_kernel
def unmark(scan, discs, pose, seen, following, travel, time):
    """Make the beams (beams,) on discs (k, 4) that stood still for long, seen from more than one place, walls again.

    discs: as `mark_mates` has them; seen (MEMORY, 4): x and y in the odom frame, travel and time when first seen there,
    infinite before. Of these the row `following`, the oldest, is overwritten next; gives the one after.
    """
    beams = scan.shape[0]
    c, s = math.cos(pose[2]), math.sin(pose[2])
    for d in range(discs.shape[0]):
        x, y = pose[0] + c * discs[d, 0] - s * discs[d, 1], pose[1] + s * discs[d, 0] + c * discs[d, 1]
        held, nearest = 0, np.inf
        for i in range(seen.shape[0]):
            away = max(abs(seen[i, 0] - x), abs(seen[i, 1] - y))
            if away < nearest:
                held, nearest = i, away
        if nearest >= STILL_M:
            seen[following, 0], seen[following, 1], seen[following, 2], seen[following, 3] = x, y, travel, time
            following = (following + 1) % seen.shape[0]
        elif time - seen[held, 3] >= STILL_S and travel - seen[held, 2] >= STILL_TRAVEL_M:
            for k in range(int(discs[d, 3])):
                i = (int(discs[d, 2]) + k) % beams
                scan[i] = abs(scan[i])
    return following


@kernel
def without_narrow(ranges_m, width_m):
    """A scan (beams,) in which things narrower than so much, with more room on both sides, are marked as mates are.

    Whatever their shape, and if they stood still for long: one may be a robot that waits.
    """
    beams, marked, count = ranges_m.shape[0], ranges_m.copy(), 0
    ranges, jumps = np.empty(beams), np.empty(beams + 1, np.int64)
    for i in range(beams):
        ranges[i] = min(abs(ranges_m[i]), NO_RETURN_M)
    for i in range(beams):
        if abs(ranges[i] - ranges[i - 1]) > STEP_MAX_M:
            jumps[count] = i
            count += 1
    jumps[count] = jumps[0] + beams
    for m in range(count):
        first, end = jumps[m], jumps[m + 1]
        angle = (end - 1 - first) * 2 * math.pi / beams
        a, b = ranges[first], ranges[(end - 1) % beams]
        is_in_front = a < ranges[first - 1] and b < ranges[end % beams]
        if is_in_front and a * a + b * b - 2 * a * b * math.cos(angle) < width_m**2:
            for k in range(first, end):
                marked[k % beams] = -ranges[k % beams]
    return marked
