"""What a real scanner makes of exact ranges: returns that are lost, mirrors, mixed pixels, and noise.

Each error is one setting of `LidarConfig`, with random numbers of its own, so that none changes the draws of another.
"""

from __future__ import annotations

import math

import numpy as np

from twc_env.kernels.compiled import borrowing_kernel
from twc_env.records.scanner import DARK_REFLECTIVITY, WALL_REFLECTIVITY, WHITE_REFLECTIVITY
from twc_env.world.sensors.beam_casting import NOTHING

PATCH_M = 1.0
"""Side of the squares in which all surfaces are dark or none is."""
FADING = 0.2
"""Detection falls from certain to impossible between 1 - this and 1 + this of the detection range."""
EDGE_MIN_M, EDGE_SLOPE = 0.1, 3.0
"""Least difference of the ranges of neighbouring beams at an edge, in metres and as a multiple of the distance between
them: two walls that meet in a corner, seen up to this slope, are none."""
_MIX = np.uint64(0x9E3779B97F4A7C15)


@borrowing_kernel
def incidence_cos(near, w, beams, b):
    """Cosine of the angle between beam b and the normal of wall w; 1 for a robot."""
    if w == NOTHING:
        return 1.0
    ex, ey = near[2, w], near[3, w]
    return abs(beams[2, b] * ey - beams[3, b] * ex) / math.sqrt(ex * ex + ey * ey)


@borrowing_kernel
def _crossing(panes, w, x, y, dx, dy):
    """Distance along a ray at which it crosses pane w of panes (k, 4), and the cosine of its incidence; infinite
    without crossing."""
    ax, ay, ex, ey = panes[w, 0] - x, panes[w, 1] - y, panes[w, 2] - panes[w, 0], panes[w, 3] - panes[w, 1]
    closing = dx * ey - dy * ex
    if abs(closing) < 1e-12:
        return np.inf, 0.0
    along, range_m = (ax * dy - ay * dx) / closing, (ax * ey - ay * ex) / closing
    if along < 0.0 or along > 1.0 or range_m < 1e-6:
        return np.inf, 0.0
    return range_m, abs(closing) / math.sqrt(ex * ex + ey * ey)


@borrowing_kernel
def reflect_glass(panes, beams, chance, normal_probability, incidence_max, ranges, hit):
    """Lower ranges (beams,) to panes (k, 4) that return the beam, with a probability that falls linearly with the angle
    of incidence, from `normal_probability` to 0 at `incidence_max`; one draw per beam serves all panes."""
    for w in range(panes.shape[0]):
        for b in range(ranges.shape[0]):
            range_m, cos = _crossing(panes, w, beams[0, b], beams[1, b], beams[2, b], beams[3, b])
            probability = normal_probability * (1.0 - math.acos(min(cos, 1.0)) / incidence_max)
            if range_m < ranges[b] and chance[b] < probability:
                ranges[b], hit[b] = range_m, NOTHING


@borrowing_kernel
def look_in_mirrors(mirrors, near, count, beams, chance, probability, range_max, ranges, hit):
    """Replace ranges (beams,) of beams that meet mirrors (k, 4) first by those to what they show: the walls `near`.

    A beam that is not mirrored, and one of an infinite wall of mirrors, measures the mirror itself.
    """
    for b in range(ranges.shape[0]):
        first, mirror = ranges[b], -1
        for w in range(mirrors.shape[0]):
            range_m, _ = _crossing(mirrors, w, beams[0, b], beams[1, b], beams[2, b], beams[3, b])
            if range_m < first:
                first, mirror = range_m, w
        if mirror < 0:
            continue
        ranges[b], hit[b] = first, NOTHING
        if chance[b] >= probability:
            continue
        dx, dy = beams[2, b], beams[3, b]
        x, y = beams[0, b] + first * dx, beams[1, b] + first * dy
        ex, ey = mirrors[mirror, 2] - mirrors[mirror, 0], mirrors[mirror, 3] - mirrors[mirror, 1]
        along = 2.0 * (dx * ex + dy * ey) / (ex * ex + ey * ey)
        dx, dy = along * ex - dx, along * ey - dy
        beyond = range_max - first
        for w in range(count):
            ax, ay, wx, wy = near[0, w] - x, near[1, w] - y, near[2, w], near[3, w]
            closing = dx * wy - dy * wx
            if abs(closing) < 1e-12:
                continue
            at, range_m = (ax * dy - ay * dx) / closing, (ax * wy - ay * wx) / closing
            if 0.0 <= at <= 1.0 and 1e-6 < range_m < beyond:
                beyond = range_m
        ranges[b] = first + beyond


@borrowing_kernel
def is_dark(x, y, seed, share):
    """Whether the surface at a point is dark: a hash of its square."""
    column, row = np.int64(math.floor(x / PATCH_M)), np.int64(math.floor(y / PATCH_M))
    word = np.uint64(seed) ^ (np.uint64(column) * _MIX)
    word = (word ^ (word >> np.uint64(29))) * np.uint64(0xBF58476D1CE4E5B9) + np.uint64(row) * _MIX
    word = (word ^ (word >> np.uint64(32))) * np.uint64(0x94D049BB133111EB)
    word ^= word >> np.uint64(31)
    return np.float64(word >> np.uint64(11)) * (1.0 / 9007199254740992.0) < share


@borrowing_kernel
def lose_returns(near, beams, hit, chance, detection, dark, lattice, seed, range_max, ranges):
    """Take the returns of surfaces that reflect too little light back: chance (beams,) in [0, 1).

    Lidar equation of a surface that reflects diffusely: the power received falls with reflectivity, cosine of the angle
    of incidence, and the square of the range. lattice (2,): origin of the squares of dark surfaces.
    """
    for b in range(ranges.shape[0]):
        range_m = ranges[b]
        if range_m >= range_max:
            continue
        reflectivity = WALL_REFLECTIVITY
        if dark > 0.0:
            x, y = beams[0, b] + range_m * beams[2, b], beams[1, b] + range_m * beams[3, b]
            if is_dark(x - lattice[0], y - lattice[1], seed, dark):
                reflectivity = DARK_REFLECTIVITY
        share = reflectivity / WHITE_REFLECTIVITY * incidence_cos(near, hit[b], beams, b)
        if range_m > detection * math.sqrt(share) * (1.0 - FADING + 2.0 * FADING * chance[b]):
            ranges[b] = range_max


@borrowing_kernel
def mix_pixels(hit, chance, cone, step, range_max, is_closed, mixed, ranges):
    """Mix ranges at edges: cone of a beam and angle between beams [rad], chance (2, beams) in [0, 1).

    mixed (beams,) is a work array.

    Between two beams on different surfaces the edge is anywhere. If it is in the cone of one of them, which it covers
    by half at most, that beam measures a mean of both ranges, weighted by what it covers of each surface (Ye and
    Borenstein 2002, section 5).
    """
    count, width = ranges.shape[0], cone / step
    for b in range(count):
        mixed[b] = ranges[b]
    for b in range(count if is_closed else count - 1):
        other = b + 1 if b + 1 < count else 0
        here, there = ranges[b], ranges[other]
        if here >= range_max or there >= range_max:
            continue
        if abs(here - there) < max(EDGE_MIN_M, EDGE_SLOPE * step * min(here, there)):
            continue
        if hit[b] == hit[other] or chance[0, b] >= width:
            continue
        covered = 0.5 * chance[1, b]
        if chance[0, b] < 0.5 * width:
            mixed[b] = here + covered * (there - here)
        else:
            mixed[other] = there + covered * (here - there)
    for b in range(count):
        ranges[b] = mixed[b]


@borrowing_kernel
def add_noise(deviates, std, std_per_m, range_min, range_max, ranges):
    """Add normal noise, whose variance has a constant part and one that grows with range; too near: no return."""
    for b in range(ranges.shape[0]):
        range_m, slope = ranges[b], std_per_m * ranges[b]
        noisy = min(max(range_m + math.sqrt(std * std + slope * slope) * deviates[b], 0.001), range_max)
        ranges[b] = noisy if (range_m < range_max) & (range_m >= range_min) else range_max
