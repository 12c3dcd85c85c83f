"""Scans of any scanner as the engine holds them: a full circle of directions around the robot, at one time.

The beams of a rolling scan are measured one after the other. Each is moved by the robot's motion since then, as
odometry and gyro tell it (deskewing), and by the mounting of the scanner. The circle takes its ranges from the lines
between neighbouring end points.
"""

from __future__ import annotations

import math

import numpy as np

from twc_env.kernels.angles import angle_of, turn_evenly
from twc_env.kernels.compiled import borrowing_kernel
from twc_env.records.messages import UNSEEN_M

SURFACE_GAP_M, SURFACE_GAP_STEPS = 0.3, 4.0
"""End points of neighbouring beams further apart, in metres or as a multiple of the distance between beams there, are
not on one surface: nothing is interpolated between them."""
STRAIGHT_M, STRAIGHT_NOISES = 0.04, 5.0
"""Three end points in a row are on one straight wall if the last is at most this far from the line through the first
two, in metres and as a multiple of the noise."""
STRIDE_TIMES, STRIDE_M = 3.0, 1.5
"""Such points are this far apart at most, as a multiple of the distance between the two before, and in metres."""
ALIGNED_STEPS = 0.15
"""A direction this close to a beam, in steps between beams, has the beam's own range."""
_NEAR_TIMES = 2.0
"""A gap of beams without return beside a return nearer than this multiple of the minimum range is taken for a surface
too near to be measured, not for an opening."""
_CLOSED_STEPS = 1.5
"""The last beam is a neighbour of the first if they are at most this many steps apart."""
_HIT, _OPEN, _UNKNOWN = 1.0, 0.0, -1.0
"""Kinds of beams: with a return, without, without information."""
_TIME, _X, _Y, _HEADING = 0, 1, 2, 3
ENDS = 11
"""Rows of the work array of `deskew`."""


@borrowing_kernel
def note_motion(time_s, motion, turn, track, latest):
    """Append a pose to the ring of poses (k, 4) of a robot: time [s], x, y, heading; returns its row.

    motion (3,): since the pose before, in the robot frame of that pose, with another turn [rad].
    """
    row = (latest + 1) % track.shape[0]
    heading = track[latest, _HEADING]
    c, s = math.cos(heading), math.sin(heading)
    track[row, _TIME] = time_s
    track[row, _X] = track[latest, _X] + c * motion[0] - s * motion[1]
    track[row, _Y] = track[latest, _Y] + s * motion[0] + c * motion[1]
    track[row, _HEADING] = heading + turn
    return row


@borrowing_kernel
def deskew(ranges, scanner, end_s, track, latest, range_max, noise, directions, ends, out, is_soft):
    """Fill the circle out (directions,) with a scan (beams,) as seen from the latest pose of a track (k, 4).

    is_soft (directions,): whether the wall of a direction is unsure, between two beams at a corner or an edge.

    scanner (9,): direction of beam 0, step, mount (3), minimum and maximum range, range that is free without return,
    time of the sweep; end_s: time of its last beam. range_max: of the engine's scans, which is no return; noise: of
    ranges, standard deviation [m]. directions
    (directions, 2): cosine and sine. ends (`ENDS`, beams + 2) is a work array: bearing, range and kind of each beam
    from the robot's centre, its end point, and what `_join_beams` adds.
    """
    count, size = ranges.shape[0], track.shape[0]
    sweep_s, pace_s = scanner[8], scanner[8] / max(count - 1, 1)
    row, older = latest, (latest - 1) % size  # the poses that beams' times are between, from the last beam backwards
    passed, high = 0, count - 1
    while high >= 0:
        time_s = end_s - pace_s * (count - 1 - high)
        while time_s < track[older, _TIME] and passed < size - 2:
            row, older, passed = older, (older - 1) % size, passed + 1
        low = 0
        if sweep_s > 0.0 and passed < size - 2:
            low = count - 1 - int(min(max((end_s - track[older, _TIME]) / pace_s, 0.0), count - 1.0))
        low = min(low, high)
        _place_beams(scanner, track, row, older, latest, end_s - sweep_s, pace_s, low, high, ends)
        high = low - 1
    _end_beams(ranges, scanner, range_max, ends)
    if scanner[5] > 0.0:
        _mark_too_near(ends, _NEAR_TIMES * scanner[5], count * abs(scanner[1]) > 2.0 * math.pi - 0.5 * abs(scanner[1]))
    _fill_circle(ends, scanner[1], range_max, max(STRAIGHT_M, STRAIGHT_NOISES * noise), directions, out, is_soft)


@borrowing_kernel
def _share(track, row, older, time_s):
    """How far back a time is between two poses of a track: 0 at the later one, 1 at the older one."""
    elapsed_s = track[row, _TIME] - track[older, _TIME]
    return min(max((track[row, _TIME] - time_s) / elapsed_s, 0.0), 1.0) if elapsed_s > 0.0 else 0.0


@borrowing_kernel
def _place_beams(scanner, track, row, older, latest, begin_s, pace_s, low, high, ends):
    """Write place (rows 0, 1) and direction (rows 3, 4) of beams low to high, seen from the latest pose, to ends.

    The beams are measured between two poses of the track: the robot's motion is even, and so is that of the beams, but
    for those before the older or after the later pose, where it stands.
    """
    now_heading = track[latest, _HEADING]
    c, s = math.cos(now_heading), math.sin(now_heading)
    x, y = track[row, _X] - track[latest, _X], track[row, _Y] - track[latest, _Y]
    back_x, back_y = track[older, _X] - track[row, _X], track[older, _Y] - track[row, _Y]
    turned, back = track[row, _HEADING] - now_heading, track[older, _HEADING] - track[row, _HEADING]
    x, y, back_x, back_y = c * x + s * y, c * y - s * x, c * back_x + s * back_y, c * back_y - s * back_x
    first, last = _share(track, row, older, begin_s + low * pace_s), _share(track, row, older, begin_s + high * pace_s)
    growth = (last - first) / max(high - low, 1)
    bearing = turned + scanner[4] + scanner[0] + first * back + low * scanner[1]
    if scanner[2] == 0.0 and scanner[3] == 0.0:
        for b in range(low, high + 1):
            ends[3, b] = ends[4, b] = 0.0
    else:
        turn_evenly(turned + first * back, growth * back, low, high, ends[3], ends[4])
    for b in range(low, high + 1):
        share, c, s = first + growth * (b - low), ends[3, b], ends[4, b]
        ends[0, b] = x + share * back_x + c * scanner[2] - s * scanner[3]
        ends[1, b] = y + share * back_y + s * scanner[2] + c * scanner[3]
    turn_evenly(bearing, scanner[1] + growth * back, low, high, ends[3], ends[4])


@borrowing_kernel
def _end_beams(ranges, scanner, range_max, ends):
    """Fill ends with bearing, range, kind and end point of each beam from its place and direction."""
    is_free, far = scanner[7] > 0.0, min(scanner[7], range_max) if scanner[7] > 0.0 else range_max
    for b in range(ranges.shape[0]):
        range_m = ranges[b]
        is_hit = (range_m > 0.0) & (scanner[5] <= range_m) & (range_m < scanner[6])  # false for NaN
        is_known = not range_m < 0.0
        reach = range_m if is_hit else far
        px, py = ends[0, b] + reach * ends[3, b], ends[1, b] + reach * ends[4, b]
        px, py = px if is_known else ends[3, b], py if is_known else ends[4, b]
        range_m = math.sqrt(px * px + py * py) if is_hit else range_max
        ends[0, b], ends[1, b], ends[3, b], ends[4, b] = angle_of(px, py), range_m if is_known else 0.0, px, py
        ends[2, b] = _HIT if is_hit else (_OPEN if is_free & is_known else _UNKNOWN)


@borrowing_kernel
def _mark_too_near(ends, near_m, is_closed):
    """Beams without return that may have met something below the minimum range have no information."""
    count = ends.shape[1] - 2
    for side in (1, -1):
        is_near = False
        for k in range(2 * count if is_closed else count):
            b = k % count if side > 0 else count - 1 - k % count
            if ends[2, b] == _HIT:
                is_near = ends[1, b] < near_m
            elif is_near and ends[2, b] == _OPEN:
                ends[2, b] = _UNKNOWN


@borrowing_kernel
def _join_beams(step, straight, per_rad, ends):
    """Fill the rows from 5 on of ends (11, beams + 2), for each beam b and the next one, in the order of directions.

    Rows: whether both met one surface; whether the end points of b, the next and the one after it are in a row on one
    straight wall, the last not much further than the one before; the same seen from the other side; the first and the
    last direction between b and the next beam, and the angle between them. The last two columns are the first two.
    """
    count = ends.shape[1] - 2
    for row in range(5):
        for b in range(2):
            ends[row, count + b] = ends[row, b]
    bearing, ranges, kinds, xs, ys, near, onwards, backwards, low, high, gaps = (
        ends[0], ends[1], ends[2], ends[3], ends[4], ends[5], ends[6], ends[7], ends[8], ends[9], ends[10],
    )  # fmt: skip
    one, two, side = np.uint64(1), np.uint64(2), 1.0 if step > 0.0 else -1.0
    # Branch-free, so that the loops are vectorised.
    for b in range(np.uint64(0), np.uint64(count + 1)):
        ex, ey = xs[b + one] - xs[b], ys[b + one] - ys[b]
        gap_m = min(SURFACE_GAP_M, SURFACE_GAP_STEPS * abs(step) * min(ranges[b], ranges[b + one]))
        is_surface = (kinds[b] == _HIT) & (kinds[b + one] == _HIT) & (ex * ex + ey * ey <= gap_m * gap_m)
        near[b] = 1.0 if is_surface else 0.0
    for b in range(np.uint64(0), np.uint64(count)):
        ex, ey, fx, fy = xs[b + one] - xs[b], ys[b + one] - ys[b], xs[b + two] - xs[b + one], ys[b + two] - ys[b + one]
        e2, f2, across = ex * ex + ey * ey, fx * fx + fy * fy, ex * fy - ey * fx
        is_hit = (kinds[b] == _HIT) & (kinds[b + one] == _HIT) & (kinds[b + two] == _HIT)
        is_ahead, across2, straight2 = ex * fx + ey * fy > 0.0, across * across, straight * straight
        # Noise alone may put points in a row that are hardly apart.
        is_apart = is_ahead & (e2 >= 4.0 * straight2) & (f2 <= min(STRIDE_TIMES**2 * e2, STRIDE_M**2))
        onwards[b] = 1.0 if is_hit & ((near[b + one] > 0.0) | is_apart) & (across2 <= straight2 * e2) else 0.0
        is_apart = is_ahead & (f2 >= 4.0 * straight2) & (e2 <= min(STRIDE_TIMES**2 * f2, STRIDE_M**2))
        backwards[b] = 1.0 if is_hit & ((near[b] > 0.0) | is_apart) & (across2 <= straight2 * f2) else 0.0
    for b in range(np.uint64(0), np.uint64(count)):
        gap = side * (bearing[b + one] - bearing[b])
        gap = gap + 2.0 * math.pi if gap < -math.pi else (gap - 2.0 * math.pi if gap >= math.pi else gap)
        begin = (bearing[b] if step > 0.0 else bearing[b + one]) * per_rad
        gaps[b], low[b], high[b] = gap, np.ceil(begin - 1e-6), np.floor(begin + gap * per_rad + 1e-6)
        high[b] = high[b] if gap >= 0.0 else low[b] - 1.0
    if gaps[count - 1] > _CLOSED_STEPS * abs(step):
        high[count - 1] = low[count - 1] - 1.0


@borrowing_kernel
def _range_on_line(ends, a, b, dx, dy):
    """Range at which a ray from the robot's centre meets the line through two beams' end points; infinite: not."""
    px, py = ends[3, a], ends[4, a]
    ex, ey = ends[3, b] - px, ends[4, b] - py
    closing = dx * ey - dy * ex
    range_m = (px * ey - py * ex) / closing
    return range_m if abs(closing) > 1e-9 and range_m > 0.0 else math.inf


@borrowing_kernel
def _fill_circle(ends, step, range_max, straight, rays, out, is_soft):
    """Fill the circle (directions,) from the ends of neighbouring beams, the nearest where they overlap.

    Between two beams on one surface the range is that of the line between their end points, soft unless the wall goes
    on straight on one side. At an edge it is that of the surface of the nearer beam, a little extended, and soft.
    """
    count, directions = ends.shape[1] - 2, out.shape[0]
    per_rad, aligned = directions / (2.0 * math.pi), ALIGNED_STEPS * abs(step)
    _join_beams(step, straight, per_rad, ends)
    for d in range(directions):
        out[d], is_soft[d] = UNSEEN_M, False
    for b in range(count):
        before, first, last, gap = (b - 1 if b > 0 else count - 1), b, b + 1, ends[10, b]
        is_near, is_straight = ends[5, b] > 0.0, ends[6, before] > 0.0 or ends[7, b] > 0.0
        if step < 0.0:
            first, last = last, first
        for k in range(int(ends[8, b]), int(ends[9, b]) + 1):
            d = k if k >= 0 else k + directions
            d = d if d < directions else d - directions
            from_first = k / per_rad - ends[0, first]
            nearer = first if 2.0 * from_first <= gap else last
            if ends[2, nearer] == _UNKNOWN:
                continue
            beyond = before if nearer == b else b + 2
            range_m = ends[1, nearer]
            if is_straight or is_near:
                range_m = min(_range_on_line(ends, first, last, rays[d, 0], rays[d, 1]), range_m + SURFACE_GAP_M)
            elif ends[5, before if nearer == b else b + 1] > 0.0:
                extended_m = _range_on_line(ends, nearer, beyond, rays[d, 0], rays[d, 1])
                range_m = extended_m if abs(extended_m - range_m) <= SURFACE_GAP_M else range_m
            range_m = min(range_m, range_max)
            is_unsure = not is_straight and min(from_first, gap - from_first) > aligned and range_m < range_max
            if out[d] == UNSEEN_M or range_m < out[d] - 1e-9:
                out[d], is_soft[d] = range_m, is_unsure
            elif range_m <= out[d] + 1e-9:
                is_soft[d] &= is_unsure


@borrowing_kernel
def limit_open(ranges, range_max, free_m):
    """Make beams without return that are free only up to `free_m` negative."""
    if free_m < range_max:
        for b in range(ranges.shape[0]):
            if ranges[b] >= range_max:
                ranges[b] = -free_m
