"""Ranges of beams that each have a place and a direction of their own, as in a scan taken while the robot moves.

An angular z-buffer as in `lidar.sweep` needs all beams in one place. Here the walls near the robot give, seen from its
last place, the beams that may hit them; with a margin for the motion, these are tested exactly.
"""

from __future__ import annotations

import math

from twc_env.kernels.compiled import borrowing_kernel

NOTHING = -1
"""Number of the wall of a beam that hits none of those that `cast` knows: a robot, a pane, a mirror."""


@borrowing_kernel
def place_beams(path, taus, mount, first, step, angles, beams):
    """Fill beams (4, beams) with the place and direction of each beam of a scanner on a robot that moves.

    path (steps, 3): poses of the robot, the latest first; taus (beams,): time [steps] from each beam to the latest
    pose; mount (3,): pose of the scanner in the robot frame. Work array: angles (beams,). Returns direction of beam 0,
    mean angle between beams and largest deviation from both.
    """
    count = beams.shape[1]
    for b in range(count):
        k = min(int(taus[b]), path.shape[0] - 2)
        share = taus[b] - k
        turn = (path[k + 1, 2] - path[k, 2] + math.pi) % (2.0 * math.pi) - math.pi
        x = path[k, 0] + share * (path[k + 1, 0] - path[k, 0])
        y = path[k, 1] + share * (path[k + 1, 1] - path[k, 1])
        heading = path[k, 2] + share * turn
        c, s = math.cos(heading), math.sin(heading)
        angle = heading + mount[2] + first + b * step
        beams[0, b], beams[1, b] = x + c * mount[0] - s * mount[1], y + s * mount[0] + c * mount[1]
        beams[2, b], beams[3, b] = math.cos(angle), math.sin(angle)
        angles[b] = angle
    for b in range(1, count):
        angles[b] = angles[b - 1] + (angles[b] - angles[b - 1] + math.pi) % (2.0 * math.pi) - math.pi
    mean, spread = (angles[count - 1] - angles[0]) / (count - 1), 0.0
    if mean * step < 0.2 * step * step:  # a robot that turns about as fast as its scanner: any beam may hit anything
        return angles[0], step, 2.0 * math.pi
    for b in range(count):
        spread = max(spread, abs(angles[b] - angles[0] - b * mean))
    return angles[0], mean, spread


@borrowing_kernel
def cast(near, count, beams, centre, first, step, spread, reach, range_max, ranges, hit):
    """Lower ranges (beams,) to the nearest wall, and write its number to hit (beams,).

    near (4, walls): x, y of the begin and of the extent. beams (4, beams): place and direction of each. centre (2,): a
    place at most `reach` [m] from all of them; first, step: direction of beam 0 and angle between beams, from which
    they differ by at most `spread` [rad].
    """
    beam_count = beams.shape[1]
    per_step, turn = 1.0 / step, 2.0 * math.pi / abs(step)
    for w in range(count):
        ax, ay, ex, ey = near[0, w] - centre[0], near[1, w] - centre[1], near[2, w], near[3, w]
        bx, by = ax + ex, ay + ey
        along = min(max(-(ax * ex + ay * ey) / max(ex * ex + ey * ey, 1e-300), 0.0), 1.0)
        nearest = math.hypot(ax + along * ex, ay + along * ey)
        if nearest > range_max + reach:
            continue
        if nearest <= 1.5 * reach + 1e-6:
            low, high = 0, beam_count - 1
            _meet(near, w, beams, low, high, ranges, hit)
            continue
        margin = (math.asin(min(reach / nearest, 1.0)) + spread) * abs(per_step) + 1.0
        begin = (math.atan2(ay, ax) - first) * per_step
        extent = math.atan2(ax * by - ay * bx, ax * bx + ay * by) * per_step
        low_beam, high_beam = min(begin, begin + extent) - margin, max(begin, begin + extent) + margin
        shift = math.floor(high_beam / turn)  # so that 0 <= high_beam < turn
        low_beam, high_beam = low_beam - shift * turn, high_beam - shift * turn
        while low_beam < beam_count:  # at most thrice: a scan of a robot that turns may cover more than a circle
            if high_beam >= 0.0:
                low, high = max(int(math.ceil(low_beam)), 0), min(int(math.floor(high_beam)), beam_count - 1)
                _meet(near, w, beams, low, high, ranges, hit)
            low_beam, high_beam = low_beam + turn, high_beam + turn


@borrowing_kernel
def _meet(near, w, beams, low, high, ranges, hit):
    """Test beams low to high against one wall."""
    wx, wy, ex, ey = near[0, w], near[1, w], near[2, w], near[3, w]
    for b in range(low, high + 1):
        ax, ay, dx, dy = wx - beams[0, b], wy - beams[1, b], beams[2, b], beams[3, b]
        closing = dx * ey - dy * ex
        offset, across = ax * ey - ay * ex, ax * dy - ay * dx
        if closing < 0.0:
            closing, offset, across = -closing, -offset, -across
        # 1e-9: beams through the corner of two walls hit one of them
        if closing > 1e-12 and -1e-9 * closing <= across <= (1.0 + 1e-9) * closing and offset >= 0.0:
            range_m = offset / closing
            if range_m < ranges[b]:
                ranges[b], hit[b] = range_m, w


@borrowing_kernel
def cast_discs(places, taus, radii, own, beams, centre, first, step, spread, reach, range_max, ranges, hit):
    """Lower ranges (beams,) to discs that move: places (steps, discs, 3), the latest first, radii (discs,).

    own: number of the disc that carries the scanner, which does not see itself; -1: none. Else as `cast`.
    """
    beam_count = ranges.shape[0]
    per_step, turn = 1.0 / step, 2.0 * math.pi / abs(step)
    for j in range(places.shape[1]):
        if j == own:
            continue
        dx, dy = places[0, j, 0] - centre[0], places[0, j, 1] - centre[1]
        nearest = math.hypot(dx, dy)
        if nearest > range_max + 2.0 * reach + radii[j]:
            continue
        moved = 0.0
        for k in range(1, places.shape[0]):
            moved = max(moved, math.hypot(places[k, j, 0] - places[0, j, 0], places[k, j, 1] - places[0, j, 1]))
        wide = reach + moved + radii[j]
        if nearest <= 1.5 * wide + 1e-6:
            _meet_disc(places, taus, radii, j, beams, 0, beam_count - 1, ranges, hit)
            continue
        middle = (math.atan2(dy, dx) - first) * per_step
        margin = (math.asin(wide / nearest) + spread) * abs(per_step) + 1.0
        shift = math.floor((middle + margin) / turn)
        low_beam, high_beam = middle - margin - shift * turn, middle + margin - shift * turn
        while low_beam < beam_count:
            if high_beam >= 0.0:
                low, high = max(int(math.ceil(low_beam)), 0), min(int(math.floor(high_beam)), beam_count - 1)
                _meet_disc(places, taus, radii, j, beams, low, high, ranges, hit)
            low_beam, high_beam = low_beam + turn, high_beam + turn


@borrowing_kernel
def _meet_disc(places, taus, radii, j, beams, low, high, ranges, hit):
    """Lower the ranges of beams from low to high to disc j where they meet it."""
    radius = radii[j]
    for b in range(low, high + 1):
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
