"""Find beams that hit a teammate, so that they are neither matched nor mapped as walls.

Robots are discs of known radius. A run of neighbouring beams that is nearer than the readings on both sides and whose
end points lie on such a disc is classified as a robot. At long range, where too few beams hit to test the shape, any
object as narrow as a disc is.
"""

from __future__ import annotations

import math

import numpy as np

from twc_env.kernels.compiled import borrowing_kernel, kernel

STEP_MAX_M, STEP_MAX_RADII = 0.15, 0.4
"""Maximum range difference of neighbouring beams on one disc [m], or as a multiple of its radius: at the edge of a
large disc it is greater."""
BACKGROUND_MIN_M = 0.25
"""Minimum range jump to the background on both sides [m]."""
SHAPE_TOLERANCE_M = 0.035
FEW_BEAMS = 4
"""Below this number of beams the shape is not tested."""
DISCS_MAX = 32
"""Maximum number of discs recorded per scan."""
STILL_M, STILL_S, STILL_TRAVEL_M = 0.2, 5.0, 2.0
"""A disc seen again within STILL_M after STILL_S, from STILL_TRAVEL_M further along the path, is static."""
NO_RETURN_M = 1e6
"""Replaces infinite ranges."""
MEMORY = 100
"""Discs that a robot remembers, to recognise a static pillar as wide as a robot, which is then mapped."""


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
def mark_teammates(ranges, range_max, radii, directions, is_jump, jumps, out, discs):
    """Copy the scan to `out` with beams on discs negated, write (x, y, first beam, beams) per disc; returns their
    number.

    radii (k,): of robots [m], ascending; without any, nothing is marked. is_jump (beams,) bool and jumps
    (beams + 1,) int64 are work arrays.
    """
    beams = ranges.shape[0]
    step, step_max_m = 2 * math.pi / beams, STEP_MAX_M
    if radii.shape[0]:
        step_max_m = max(STEP_MAX_M, STEP_MAX_RADII * radii[-1])
    for i in range(beams):
        out[i] = ranges[i]
    is_jump[0] = abs(ranges[0] - ranges[beams - 1]) > step_max_m
    for i in range(1, beams):  # many beams at once
        is_jump[i] = abs(ranges[i] - ranges[i - 1]) > step_max_m
    count = 0
    for i in range(beams):
        jumps[count] = i
        count += is_jump[i]
    if radii.shape[0] == 0 or count == 0:
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
        for radius in radii:
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
            break
    return found


@borrowing_kernel
def unmark(scan, discs, pose, seen, following, travel, time):
    """Restore the beams (beams,) on discs (k, 4) that stayed in place long enough, seen from different places.

    discs: as written by `mark_teammates`; seen (MEMORY, 4): x, y in the odom frame, travel [m] and time [s] of the
    first observation, infinite where unused. `following` is the row to overwrite next (ring buffer); returns the next
    one.
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
    """A scan (beams,) with beams on objects narrower than `width_m`, with free space on both sides, negated.

    Neither the shape nor how long the object stood still is tested: it may be a waiting robot.
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
