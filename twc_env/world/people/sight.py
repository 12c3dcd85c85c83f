"""What scanners notice of people: beams that end at legs."""

from __future__ import annotations

import math

import numpy as np

from twc_env.kernels.compiled import borrowing_kernel

_RANGE_MIN_M = 0.001
"""Least range of a return, as of walls."""


@borrowing_kernel
def shorten(discs, poses, directions, range_max, range_std, noise, used, end, ranges):
    """Shorten ranges (r, beams) [m] to discs (k, 3: x, y, radius) that are nearer; directions (2, beams) of the beams.

    Negative ranges are beams without information and stay. noise (r, numbers): standard normal, of which those from
    used (r,) to end (r,) are unused. If a robot has fewer than one per beam, nothing is done and the result is False.
    """
    beams = directions.shape[1]
    per_beam = beams / (2.0 * np.pi)
    for i in range(ranges.shape[0]):
        if end[i] - used[i] < beams:
            return False
    for i in range(ranges.shape[0]):
        x, y, c, s = poses[i, 0], poses[i, 1], math.cos(poses[i, 2]), math.sin(poses[i, 2])
        hits = 0
        for k in range(discs.shape[0]):
            wx, wy, radius = discs[k, 0] - x, discs[k, 1] - y, discs[k, 2]
            distance2 = wx * wx + wy * wy
            if distance2 > (range_max + radius) ** 2 or distance2 <= radius * radius:
                continue
            px, py = c * wx + s * wy, c * wy - s * wx
            middle, half = math.atan2(py, px), math.asin(radius / math.sqrt(distance2))
            for n in range(int(np.ceil((middle - half) * per_beam)), int(np.floor((middle + half) * per_beam)) + 1):
                b = n % beams
                ahead = px * directions[0, b] + py * directions[1, b]
                aside = px * directions[1, b] - py * directions[0, b]
                inside = radius * radius - aside * aside
                if inside < 0.0:
                    continue
                reach = ahead - math.sqrt(inside)
                if reach < ranges[i, b] and reach < range_max:
                    if range_std > 0.0 and hits < beams:
                        reach += range_std * noise[i, used[i] + hits]
                        hits += 1
                    ranges[i, b] = max(min(reach, ranges[i, b]), _RANGE_MIN_M)
        used[i] += hits
    return True
