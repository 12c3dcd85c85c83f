"""What sensors notice of people: beams that end at legs, signs behind bodies, radio signals through them."""

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


@borrowing_kernel
def lose_in_bodies(x, y, boxes, crossed, bodies, losses):
    """Add the losses of bodies (k, 5) in the line of sight from (x, y) to losses (bands, sources).

    A body: x, y, radius, loss [dB], and the most walls between behind which it still counts. boxes (>= 3, sources): x,
    y and height of the sources; those on other storeys do not change. crossed (sources,): walls between.
    """
    for a in range(crossed.shape[0]):
        if boxes[2, a] > 0.0:
            continue
        dx, dy = boxes[0, a] - x, boxes[1, a] - y
        distance2 = max(dx * dx + dy * dy, 1e-12)
        for k in range(bodies.shape[0]):
            if crossed[a] > bodies[k, 4]:
                continue
            ox, oy, radius = bodies[k, 0] - x, bodies[k, 1] - y, bodies[k, 2]
            share = (ox * dx + oy * dy) / distance2
            if 0.0 < share < 1.0 and (ox - share * dx) ** 2 + (oy - share * dy) ** 2 < radius * radius:
                for band in range(losses.shape[0]):
                    losses[band, a] += bodies[k, 3]
