"""Walls that a scanner may see from near a position: those in range and not occluded by a single other wall."""

from __future__ import annotations

import math

import numpy as np

from twc_env.kernels.compiled import borrowing_kernel

_OCCLUDER_COS = math.cos(0.5)
"""Occluders subtend at least 0.5 rad."""
_MARGIN = 1e-6
"""Tolerance [m, m^2] of the occlusion tests against rounding."""


@borrowing_kernel
def gather_near(walls, origin, bucket, rows, columns, first, members, x, y, range_max, margin, stamps, scratch, near):
    """Fill near (4, walls) with the walls that a scanner may see from any position within `margin` of (x, y).

    Rows of near: x, y of the begin and of the extent. stamps (walls,) and scratch (>= 8, walls) are overwritten.
    Returns the count.
    """
    count = _walls_in_range(
        walls, origin, bucket, rows, columns, first, members, x, y, range_max + margin, stamps, near
    )
    return _drop_occluded(near, count, x, y, margin, stamps, scratch)


@borrowing_kernel
def _walls_in_range(walls, origin, bucket, rows, columns, first, members, x, y, reach, stamps, near):
    """Fill near with the walls within `reach` of (x, y); returns their count."""
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
def _drop_occluded(near, count, x, y, margin, is_occluded, scratch):
    """Remove walls that another wall occludes from all positions within `margin` of (x, y); returns the count left.

    A wall is occluded if the same wall occludes both its ends.
    """
    occluders, begin_x, begin_y, end_x, end_y = scratch[:4], scratch[4], scratch[5], scratch[6], scratch[7]
    for w in range(count):
        begin_x[w], begin_y[w] = near[0, w] - x, near[1, w] - y
        end_x[w], end_y[w] = begin_x[w] + near[2, w], begin_y[w] + near[3, w]
        is_occluded[w] = False
    for h in range(_find_occluders(near, count, x, y, margin, occluders)):
        ax, ay, bx, by = occluders[0, h], occluders[1, h], occluders[2, h], occluders[3, h]
        # Branch-free, so that the loop is vectorised.
        for w in range(count):
            is_begin_occluded = _occludes(ax, ay, bx, by, begin_x[w], begin_y[w], margin)
            is_occluded[w] |= is_begin_occluded & _occludes(ax, ay, bx, by, end_x[w], end_y[w], margin)
    kept = 0
    for w in range(count):
        for k in range(4):
            near[k, kept] = near[k, w]
        kept += int(not is_occluded[w])
    return kept


@borrowing_kernel
def _find_occluders(near, count, x, y, margin, occluders):
    """Fill occluders with the walls that subtend a large angle at (x, y) and show one side to the disc around it.

    Rows of occluders: x, y of their ends relative to (x, y), in counter-clockwise order. Returns the count.
    """
    found = 0
    for w in range(count):
        ax, ay, ex, ey = near[0, w] - x, near[1, w] - y, near[2, w], near[3, w]
        bx, by = ax + ex, ay + ey
        offset = ax * by - ay * bx
        if offset * offset <= margin * margin * (ex * ex + ey * ey) + _MARGIN:
            continue
        if ax * bx + ay * by > _OCCLUDER_COS * math.sqrt((ax * ax + ay * ay) * (bx * bx + by * by)):
            continue
        is_turned = offset < 0.0
        occluders[0, found], occluders[1, found] = (bx if is_turned else ax), (by if is_turned else ay)
        occluders[2, found], occluders[3, found] = (ax if is_turned else bx), (ay if is_turned else by)
        found += 1
    return found


@borrowing_kernel
def _occludes(ax, ay, bx, by, px, py, margin):
    """Whether the line to the point p crosses the wall from a to b from all positions within `margin` of the origin.

    The side on which an end is seen is the sign of a cross product. That is linear in the position, so over the disc
    it changes by at most `margin` times the distance from the end to p.
    """
    to_ax, to_ay, to_bx, to_by = px - ax, py - ay, bx - px, by - py
    left, right = ax * py - ay * px, px * by - py * bx
    return (
        (left > _MARGIN)
        & (right > _MARGIN)
        & (left * left > margin * margin * (to_ax * to_ax + to_ay * to_ay) + _MARGIN * _MARGIN)
        & (right * right > margin * margin * (to_bx * to_bx + to_by * to_by) + _MARGIN * _MARGIN)
        & ((bx - ax) * to_ay - (by - ay) * to_ax < -_MARGIN)
    )
