"""Which keyframes of a large map tell nothing that earlier ones of the same robot do not tell.

The map of a building that is known well needs no more of them, however often robots pass: as in the pruning of laser
scans for lifelong mapping (Kretzschmar and Stachniss 2012), but by place: a keyframe goes if another one of its robot
that stays was taken nearby, with nothing in between, and the signs that it read were read often enough. So there are
as many in the end as the building has room for. Robots are thinned each for itself, so that a merge can be undone.
"""

from __future__ import annotations

import math

import numpy as np

from twc_env.kernels import borrowing_kernel, kernel

SAME_PLACE_M = 1.0
"""Keyframes this near see the same."""
SAME_SIGN_M, VIEWS_ENOUGH = 1.0, 3
"""A sign that was read so often within this need not be read there again."""


@borrowing_kernel
def _is_open(pose, ranges, other):
    """Whether a scan (beams,) taken at a pose reaches as far as another place."""
    dx, dy = other[0] - pose[0], other[1] - pose[1]
    beams = ranges.shape[0]
    beam = int(math.floor((math.atan2(dy, dx) - pose[2]) * beams / (2 * math.pi) + 0.5)) % beams
    return abs(ranges[beam]) >= math.hypot(dx, dy)


@borrowing_kernel
def _adds_sign(places, first, end, before, robots, owner, robot, is_kept):
    """Whether any of the signs from `first` to `end` was read too seldom, as far as that is kept, by its robot."""
    for k in range(first, end):
        views = 0
        for j in range(before):
            if is_kept[owner[j]] and robots[owner[j]] == robot:
                views += math.hypot(places[j, 0] - places[k, 0], places[j, 1] - places[k, 1]) < SAME_SIGN_M
        if views < VIEWS_ENOUGH:
            return True
    return False


@kernel
def carriers_of(poses, scans, robots, may_go, sign_ends, sign_places):
    """(nodes,) of each that may go and tells nothing new, which of those that stay tells it; -1 for those that stay.

    poses (nodes, 3) and scans (nodes, beams) in the order in which they came, robots (nodes,), may_go (nodes,) bool;
    sign_places (signs, 2) in the map, those read at one node after those of the nodes before, which end at sign_ends
    (nodes,).
    """
    count = poses.shape[0]
    carriers, is_kept, owner = np.full(count, -1), np.ones(count, np.bool_), np.empty(sign_places.shape[0], np.int64)
    for n in range(count):
        first = sign_ends[n - 1] if n > 0 else 0
        for k in range(first, sign_ends[n]):
            owner[k] = n
        if not may_go[n]:
            continue
        nearest_m2 = SAME_PLACE_M**2
        for m in range(n):
            dx, dy = poses[m, 0] - poses[n, 0], poses[m, 1] - poses[n, 1]
            if dx * dx + dy * dy >= nearest_m2 or not is_kept[m] or robots[m] != robots[n]:
                continue
            if _is_open(poses[m], scans[m], poses[n]) and _is_open(poses[n], scans[n], poses[m]):
                nearest_m2, carriers[n] = dx * dx + dy * dy, m
        if carriers[n] >= 0:
            if _adds_sign(sign_places, first, sign_ends[n], first, robots, owner, robots[n], is_kept):
                carriers[n] = -1
            else:
                is_kept[n] = False
    return carriers
