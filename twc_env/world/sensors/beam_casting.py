"""Ranges of beams that each have a place and a direction of their own, as in a scan taken while the robot moves.

An angular z-buffer as in `lidar.sweep` needs all beams in one place. Here the walls near the robot give, seen from its
last place, the beams that may hit them; with a margin for the motion, these are tested exactly.
"""

from __future__ import annotations

import math

import numpy as np

from twc_env.kernels.angles import angle_of, turn_evenly, wrapped
from twc_env.kernels.compiled import borrowing_kernel

_ARC = 1.1
"""Arc sines of up to 2/3 are at most this multiple of their argument."""
_NEVER = 1e9
"""A beam that no scan has."""
NOTHING = -1
"""Number of the wall of a beam that hits none of those that `cast` knows: a robot, a pane, a mirror."""


@borrowing_kernel
def place_beams(path, taus, mount, first, step, beams):
    """Fill beams (4, beams) with the place and direction of each beam of a scanner on a robot that moves.

    path (steps, 3): poses of the robot, the latest first; taus (beams,): time [steps] from each beam to the latest
    pose, which falls evenly; mount (3,): pose of the scanner in the robot frame. Returns direction of beam 0, mean
    angle between beams and largest deviation from both.
    """
    count, last = beams.shape[1], beams.shape[1] - 1
    ahead = mount[2] + first
    begin = _heading_at(path, taus[0]) + ahead
    mean = step + (_heading_at(path, taus[last]) + ahead - begin) / max(last, 1)
    pace, spread, low = (taus[0] - taus[last]) / max(last, 1), 0.0, 0
    while low < count:
        k, high = min(int(taus[low]), path.shape[0] - 2), low
        while high < last and taus[high + 1] >= k:
            high += 1
        # Beams low to high are measured between poses k + 1 and k.
        heading, turn = _heading_at(path, taus[low]), wrapped(path[k + 1, 2] - path[k, 2])
        angle, growth = heading + ahead + low * step, step - pace * turn
        spread = max(spread, abs(angle - begin - low * mean))
        spread = max(spread, abs(angle + (high - low) * growth - begin - high * mean))
        xs, ys = beams[0], beams[1]
        if mount[0] == 0.0 and mount[1] == 0.0:
            for b in range(low, high + 1):
                xs[b] = ys[b] = 0.0
        else:
            turn_evenly(heading, -pace * turn, low, high, ys, xs)
            for b in range(low, high + 1):
                c, s = ys[b], xs[b]
                xs[b], ys[b] = c * mount[0] - s * mount[1], s * mount[0] + c * mount[1]
        for b in range(low, high + 1):
            share = taus[b] - k
            xs[b] += path[k, 0] + share * (path[k + 1, 0] - path[k, 0])
            ys[b] += path[k, 1] + share * (path[k + 1, 1] - path[k, 1])
        turn_evenly(angle, growth, low, high, beams[2], beams[3])
        low = high + 1
    if mean * step < 0.2 * step * step:  # a robot that turns about as fast as its scanner: any beam may hit anything
        return begin, step, 2.0 * math.pi
    return begin, mean, spread


@borrowing_kernel
def _heading_at(path, tau):
    """Heading a time [steps] before the latest pose of a path (steps, 3), without jumps of a whole turn."""
    heading = path[0, 2]
    for k in range(min(int(tau) + 1, path.shape[0] - 1)):
        share = min(tau - k, 1.0) if k < path.shape[0] - 2 else tau - k
        heading += share * wrapped(path[k + 1, 2] - path[k, 2])
    return heading


@borrowing_kernel
def cast(near, count, beams, centre, first, step, spread, reach, range_max, spans, ranges, hit):
    """Lower ranges (beams,) to the nearest wall, and write its number to hit (beams,).

    near (4, walls): x, y of the begin and of the extent. beams (4, beams): place and direction of each. centre (2,): a
    place at most `reach` [m] from all of them; first, step: direction of beam 0 and angle between beams, from which
    they differ by at most `spread` [rad]. spans (3, walls) is a work array.
    """
    beam_count, per_step, turn = beams.shape[1], 1.0 / step, 2.0 * math.pi / abs(step)
    far2, beside2 = (range_max + reach) ** 2, (1.5 * reach + 1e-6) ** 2
    for w in range(count):  # branch-free, so that it is vectorised
        ax, ay, ex, ey = near[0, w] - centre[0], near[1, w] - centre[1], near[2, w], near[3, w]
        bx, by = ax + ex, ay + ey
        along = min(max(-(ax * ex + ay * ey) / max(ex * ex + ey * ey, 1e-300), 0.0), 1.0)
        nearest2 = (ax + along * ex) ** 2 + (ay + along * ey) ** 2
        begin = (angle_of(ax, ay) - first) * per_step
        end = begin + angle_of(ax * bx + ay * by, ax * by - ay * bx) * per_step
        margin = (_ARC * reach / math.sqrt(max(nearest2, 1e-300)) + spread) * abs(per_step) + 1.0
        low, high = _span(min(begin, end) - margin, max(begin, end) + margin, turn, nearest2 <= beside2, beam_count)
        spans[0, w], spans[1, w] = (_NEVER if nearest2 > far2 else low), high
    for w in range(count):
        low_beam, high_beam = spans[0, w], spans[1, w]
        while low_beam < beam_count:  # at most thrice: a scan of a robot that turns may cover more than a circle
            if high_beam >= 0.0:
                low, high = max(int(math.ceil(low_beam)), 0), min(int(math.floor(high_beam)), beam_count - 1)
                _meet(near, w, beams, low, high, ranges, hit)
            low_beam, high_beam = low_beam + turn, high_beam + turn


@borrowing_kernel
def _span(low, high, turn, is_all, beam_count):
    """The span of beams from low to high so that the highest is in the first turn; or all beams."""
    shift = np.floor(high / turn) * turn
    return (0.0 if is_all else low - shift), (beam_count - 1.0 if is_all else high - shift)


@borrowing_kernel
def _meet(near, w, beams, low, high, ranges, hit):
    """Test beams low to high against one wall."""
    wx, wy, ex, ey = near[0, w], near[1, w], near[2, w], near[3, w]
    xs, ys, cosines, sines = beams[0], beams[1], beams[2], beams[3]
    for b in range(np.uint64(low), np.uint64(max(high + 1, low))):  # branch-free, so that it is vectorised
        ax, ay, dx, dy = wx - xs[b], wy - ys[b], cosines[b], sines[b]
        closing, offset, across = dx * ey - dy * ex, ax * ey - ay * ex, ax * dy - ay * dx
        side = -1.0 if closing < 0.0 else 1.0
        closing, offset, across = side * closing, side * offset, side * across
        # 1e-9: beams through the corner of two walls hit one of them
        is_met = (closing > 1e-12) & (across >= -1e-9 * closing) & (across <= (1.0 + 1e-9) * closing) & (offset >= 0.0)
        range_m = offset / closing
        is_met &= range_m < ranges[b]
        ranges[b] = range_m if is_met else ranges[b]
        hit[b] = w if is_met else hit[b]


@borrowing_kernel
def cast_discs(places, taus, radii, own, beams, centre, first, step, spread, reach, range_max, spans, ranges, hit):
    """Lower ranges (beams,) to discs that move: places (steps, discs, 3), the latest first, radii (discs,).

    own: number of the disc that carries the scanner, which does not see itself; -1: none. Else as `cast`.
    """
    beam_count, per_step, turn = ranges.shape[0], 1.0 / step, 2.0 * math.pi / abs(step)
    for j in range(places.shape[1]):
        spans[0, j] = 0.0
    for k in range(1, places.shape[0]):
        for j in range(places.shape[1]):
            x, y = places[k, j, 0] - places[0, j, 0], places[k, j, 1] - places[0, j, 1]
            spans[0, j] = max(spans[0, j], x * x + y * y)
    for j in range(places.shape[1]):  # branch-free, so that it is vectorised
        dx, dy, wide = (
            places[0, j, 0] - centre[0],
            places[0, j, 1] - centre[1],
            reach + math.sqrt(spans[0, j]) + radii[j],
        )
        distance = math.sqrt(dx * dx + dy * dy)
        middle = (angle_of(dx, dy) - first) * per_step
        margin = (_ARC * wide / max(distance, 1e-300) + spread) * abs(per_step) + 1.0
        is_all = distance <= 1.5 * wide + 1e-6
        low, high = _span(middle - margin, middle + margin, turn, is_all, beam_count)
        spans[2, j] = distance - wide
        spans[0, j], spans[1, j] = (_NEVER if distance > range_max + 2.0 * reach + radii[j] else low), high
    for j in range(places.shape[1]):
        low_beam, high_beam = (spans[0, j] if j != own else _NEVER), spans[1, j]
        while low_beam < beam_count:
            if high_beam >= 0.0:
                low, high = max(int(math.ceil(low_beam)), 0), min(int(math.floor(high_beam)), beam_count - 1)
                _meet_disc(places, taus, radii, j, spans[2, j], beams, low, high, ranges, hit)
            low_beam, high_beam = low_beam + turn, high_beam + turn


@borrowing_kernel
def _meet_disc(places, taus, radii, j, nearest, beams, low, high, ranges, hit):
    """Lower the ranges of beams from low to high to disc j, from which all are further than `nearest`."""
    radius = radii[j]
    for b in range(low, high + 1):
        if ranges[b] <= nearest:
            continue
        k = min(int(taus[b]), places.shape[0] - 2)
        share = taus[b] - k
        ax = places[k, j, 0] + share * (places[k + 1, j, 0] - places[k, j, 0]) - beams[0, b]
        ay = places[k, j, 1] + share * (places[k + 1, j, 1] - places[k, j, 1]) - beams[1, b]
        ahead, aside = ax * beams[2, b] + ay * beams[3, b], ax * beams[3, b] - ay * beams[2, b]
        inside = radius * radius - aside * aside
        if ahead > 0.0 and inside >= 0.0 and ax * ax + ay * ay > radius * radius:
            range_m = ahead - math.sqrt(inside)
            if range_m < ranges[b]:
                ranges[b], hit[b] = range_m, NOTHING
