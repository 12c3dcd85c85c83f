"""The walls that a scanner may see from around a place: those in reach that no other one hides."""

from __future__ import annotations

import math

import numpy as np

from twc_env.kernels import borrowing_kernel

_HIDER_COS = math.cos(0.5)
"""A wall must take up half a radian of the view for others to be looked for behind it."""
_MARGIN = 1e-6
"""What is hidden is hidden by more than this [m, m^2]: rounding never lets a beam pass an end of the wall before it."""


@borrowing_kernel
def gather_near(walls, origin, bucket, rows, columns, first, members, x, y, far, spare, stamps, scratch, near):
    """Walls that a scanner of range `far` may see from some place less than `spare` from (x, y) -> how many.

    Rows of near: begin x, y and extent x, y; stamps (walls,) and scratch (8 or more, walls) are overwritten.
    """
    count = _reached(walls, origin, bucket, rows, columns, first, members, x, y, far + spare, stamps, near)
    return _drop_hidden(near, count, x, y, spare, stamps, scratch)


@borrowing_kernel
def _reached(walls, origin, bucket, rows, columns, first, members, x, y, reach, stamps, near):
    """Walls of the buckets around a place that come within reach of it -> how many."""
    c0 = max(int(np.floor((x - reach - origin[0]) / bucket)), 0)
    c1 = min(int(np.floor((x + reach - origin[0]) / bucket)), columns - 1)
    r0 = max(int(np.floor((y - reach - origin[1]) / bucket)), 0)
    r1 = min(int(np.floor((y + reach - origin[1]) / bucket)), rows - 1)
    count = 0
    if c0 > c1:
        return 0
    stamps[:] = False
    for r in range(r0, r1 + 1):
        for m in range(first[r * columns + c0], first[r * columns + c1 + 1]):
            w = members[m]
            if stamps[w]:
                continue
            stamps[w] = True
            ax, ay = walls[w, 0] - x, walls[w, 1] - y
            ex, ey = walls[w, 2] - walls[w, 0], walls[w, 3] - walls[w, 1]
            t = min(max(-(ax * ex + ay * ey) / (ex * ex + ey * ey), 0.0), 1.0)
            nx, ny = ax + t * ex, ay + t * ey
            if nx * nx + ny * ny <= reach * reach:
                near[0, count], near[1, count], near[2, count], near[3, count] = walls[w, 0], walls[w, 1], ex, ey
                count += 1
    return count


@borrowing_kernel
def _drop_hidden(near, count, x, y, spare, is_hidden, scratch):
    """Keep the walls that no single other one hides from all places less than `spare` from (x, y) -> how many.

    A wall is hidden where both its ends are: what lies between them is behind the same wall.
    """
    hiders, begin_x, begin_y, end_x, end_y = scratch[:4], scratch[4], scratch[5], scratch[6], scratch[7]
    for w in range(count):
        begin_x[w], begin_y[w] = near[0, w] - x, near[1, w] - y
        end_x[w], end_y[w] = begin_x[w] + near[2, w], begin_y[w] + near[3, w]
        is_hidden[w] = False
    for h in range(_find_hiders(near, count, x, y, spare, hiders)):
        ax, ay, bx, by = hiders[0, h], hiders[1, h], hiders[2, h], hiders[3, h]
        # Without a branch, for which walls are hidden cannot be foretold: several are tested side by side.
        for w in range(count):
            is_begin_hidden = _hides(ax, ay, bx, by, begin_x[w], begin_y[w], spare)
            is_hidden[w] |= is_begin_hidden & _hides(ax, ay, bx, by, end_x[w], end_y[w], spare)
    kept = 0
    for w in range(count):
        for k in range(4):
            near[k, kept] = near[k, w]
        kept += int(not is_hidden[w])
    return kept


@borrowing_kernel
def _find_hiders(near, count, x, y, spare, hiders):
    """The walls that look large from (x, y) and from all around it show the same side -> how many.

    Rows of hiders: their ends as seen from there, counter-clockwise.
    """
    found = 0
    for w in range(count):
        ax, ay, ex, ey = near[0, w] - x, near[1, w] - y, near[2, w], near[3, w]
        bx, by = ax + ex, ay + ey
        offset = ax * by - ay * bx
        if offset * offset <= spare * spare * (ex * ex + ey * ey) + _MARGIN:
            continue
        if ax * bx + ay * by > _HIDER_COS * math.sqrt((ax * ax + ay * ay) * (bx * bx + by * by)):
            continue
        is_turned = offset < 0.0
        hiders[0, found], hiders[1, found] = (bx if is_turned else ax), (by if is_turned else ay)
        hiders[2, found], hiders[3, found] = (ax if is_turned else bx), (ay if is_turned else by)
        found += 1
    return found


@borrowing_kernel
def _hides(ax, ay, bx, by, px, py, spare):
    """Whether from all places less than `spare` from the origin the line to a point p crosses the hider from a to b.

    On which side of the point an end of the hider is seen is told by a cross product. It is linear in the place, so
    that over the disc it changes by no more than `spare` times the distance between end and point.
    """
    to_ax, to_ay, to_bx, to_by = px - ax, py - ay, bx - px, by - py
    left, right = ax * py - ay * px, px * by - py * bx
    return (
        (left > _MARGIN)
        & (right > _MARGIN)
        & (left * left > spare * spare * (to_ax * to_ax + to_ay * to_ay) + _MARGIN * _MARGIN)
        & (right * right > spare * spare * (to_bx * to_bx + to_by * to_by) + _MARGIN * _MARGIN)
        & ((bx - ax) * to_ay - (by - ay) * to_ax < -_MARGIN)
    )
