"""Decide when two groups of robots share one building well enough to be put into one frame.

A closure between two groups says where one map lies in the other. One closure is no proof: rooms look alike and signs
repeat. A merge needs several closures that agree, no walls of one map in the free space of the other, fingerprints that
are as alike as the robots' own paths say fingerprints of one place are, and signs most of which read the same where the
two maps would share a place (`signs_in_place`). Where no fingerprint speaks, one of these must hang nowhere else.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.config import MergingConfig
from twc_env.geometry import compose, inverse
from twc_env.kernels import kernel
from twc_env.messages import GridMap, LoopClosure
from twc_env.slam.growing import enlarged
from twc_env.slam.heard_places import HeardPlaces

DRIFT_PER_M = 0.02
"""Closures this far apart may disagree by this much more, per metre."""
WALL_LOG_ODDS, FREE_LOG_ODDS = 20, -12
"""Cells counted as certain when two maps are compared."""
KNOWN_MIN = 20
"""Walls about which the other map must be certain."""
CELLS_AT_ONCE = 32
"""Most cells are no walls and are passed by the dozen."""
NEAR_CELLS = 3
"""A wall so near to a wall of the other map does not stand in its free space."""
SAME_PLACE_M = 1.2
"""Fingerprints this near each other after a merge should be alike ..."""
REFERENCE_M = (1.5, 3.5)
"""... at least as alike as those of one robot at this distance."""
PAIRS_MIN, PLACES_MAX = 4, 150
"""With fewer pairs nothing is concluded; of more places than twice that only some are compared with all others."""
REFERENCE_SLACK = 1.1


Weight = tuple[int, int, int]
"""How much speaks for a place of a merge, the most telling first: signs that both sides read alike to the letter, signs
at all, closures. Signs count that lie `spread_min_m` apart, and each once however often it was seen: where names follow
one another, those of a room and of the next are nearly alike, and so are all that follow."""


@dataclass(frozen=True, slots=True, eq=False)
class MergeProposal:
    """Where group b lies in the map of group a, and the closures that say so."""

    pose_a_b: Array
    """(3,)."""
    support: Array
    """(closures,) bool: which of the closures agree."""
    weight: Weight
    agreeing: tuple[LoopClosure, ...] = ()
    """These, where whoever asked has them."""


def largest_agreement(
    targets: Array, sources: Array, measured: Array, signs_m: Array, is_read_alike: Array, config: MergingConfig
) -> MergeProposal | None:
    """The pose of b in a for which most speaks; None while too few closures do or all stem from one sign.

    targets (k, 3) keyframes in map a, sources (k, 3) in map b, measured (k, 3) source in the target's frame, signs_m
    (k, 2) the sign behind each closure, in its own map, is_read_alike (k,) whether both read the same there. At least
    two signs that lie apart must agree, since one may have a twin elsewhere.
    """
    if len(targets) < config.closures_min:
        return None
    in_a = compose(targets, measured)
    poses_a_b = compose(in_a, inverse(sources))
    sources, signs_m = np.asarray(sources, float), np.asarray(signs_m, float)
    rows, read_alike, signs = _heaviest_agreement(
        poses_a_b, in_a, sources, signs_m, np.asarray(is_read_alike, bool), config.consistency_m,
        config.consistency_rad, config.spread_min_m, config.closures_min,
    )  # fmt: skip
    if not len(rows) or read_alike < config.signs_read_alike_min:
        return None
    support = np.zeros(len(targets), bool)
    support[rows] = True
    best = _most_central(poses_a_b, in_a, sources, rows)
    return MergeProposal(poses_a_b[best], support, (read_alike, signs, len(rows)))


@kernel
def _apart_m(pose, in_a, source):
    """How far a keyframe of b, put into a by the pose (3,), stands from where its own closure has it."""
    c, s = math.cos(pose[2]), math.sin(pose[2])
    x, y = pose[0] + c * source[0] - s * source[1] - in_a[0], pose[1] + s * source[0] + c * source[1] - in_a[1]
    return math.hypot(x, y)


@kernel
def _heaviest_agreement(
    poses_a_b, in_a, sources, signs_m, is_read_alike, consistency_m, consistency_rad, spread_min_m, closures_min
):
    """What agrees (n,) with the closure for which most speaks, and two parts of its weight; nothing: too little."""
    count = poses_a_b.shape[0]
    rows, alike, heaviest_rows = np.empty(count, np.int64), np.empty(count, np.int64), np.empty(count, np.int64)
    heaviest = (0, 0, 0)
    for i in range(count):
        votes = read_alike = same = 0
        for j in range(count):
            turned = (poses_a_b[i, 2] + sources[j, 2] - in_a[j, 2] + math.pi) % (2 * math.pi) - math.pi
            if abs(turned) > consistency_rad:
                continue
            away = math.hypot(sources[i, 0] - sources[j, 0], sources[i, 1] - sources[j, 1])
            if _apart_m(poses_a_b[i], in_a[j], sources[j]) > consistency_m + DRIFT_PER_M * away:
                continue
            rows[votes] = j
            same += votes < heaviest[2] and heaviest_rows[votes] == j
            votes += 1
            if is_read_alike[j]:
                alike[read_alike] = j
                read_alike += 1
        if votes < closures_min or same == votes == heaviest[2] or not _lie_apart(signs_m, rows[:votes], spread_min_m):
            continue
        read_alike = count_places(signs_m, alike[:read_alike], spread_min_m)
        weight = (read_alike, count_places(signs_m, rows[:votes], spread_min_m), votes)
        if weight > heaviest:
            heaviest = weight
            heaviest_rows[:votes] = rows[:votes]
    return heaviest_rows[: heaviest[2]], heaviest[0], heaviest[1]


@kernel
def _lie_apart(signs_m, rows, apart_m):
    """Whether any two of the chosen signs lie so far from each other."""
    low_x = high_x = signs_m[rows[0], 0]
    low_y = high_y = signs_m[rows[0], 1]
    for k in rows:
        low_x, high_x = min(low_x, signs_m[k, 0]), max(high_x, signs_m[k, 0])
        low_y, high_y = min(low_y, signs_m[k, 1]), max(high_y, signs_m[k, 1])
    longer = max(high_x - low_x, high_y - low_y)
    if longer >= apart_m or math.hypot(high_x - low_x, high_y - low_y) < apart_m:
        return longer >= apart_m
    for k in rows:
        for other in rows:
            if math.hypot(signs_m[k, 0] - signs_m[other, 0], signs_m[k, 1] - signs_m[other, 1]) >= apart_m:
                return True
    return False


@kernel
def count_places(signs_m, rows, apart_m):
    """How many of the chosen signs, rows of (k, 2), lie so far from each other, those counted before first."""
    counted = np.empty(rows.shape[0], np.int64)
    count = 0
    for k in rows:
        is_new = True
        for i in range(count):
            other = counted[i]
            if math.hypot(signs_m[k, 0] - signs_m[other, 0], signs_m[k, 1] - signs_m[other, 1]) < apart_m:
                is_new = False
                break
        if is_new:
            counted[count] = k
            count += 1
    return count


@kernel
def _most_central(poses_a_b, in_a, sources, rows):
    """Of the closures that agree (n,), the one from whose pose all of them stand least far in sum."""
    best, least = rows[0], math.inf
    for i in rows:
        total = 0.0
        for j in rows:
            total += _apart_m(poses_a_b[i], in_a[j], sources[j])
        if total < least:
            best, least = i, total
    return best


def weight_of(signs_m: Array, is_read_alike: Array, config: MergingConfig) -> Weight:
    """What some closures weigh that stem from these signs (k, 2), read alike on both sides or not (k,)."""
    every, apart_m = np.arange(len(signs_m)), config.spread_min_m
    return count_places(signs_m, every[is_read_alike], apart_m), count_places(signs_m, every, apart_m), len(signs_m)


def wall_contradiction(grid_a: GridMap, grid_b: GridMap, pose_a_b: Array) -> float:
    """Larger share of one map's certain walls that stand in the certain free space of the other, where both know."""
    return max(
        _walls_in_free_space(grid_a, grid_b, pose_a_b),
        _walls_in_free_space(grid_b, grid_a, inverse(pose_a_b)),
    )


def _walls_in_free_space(grid_a: GridMap, grid_b: GridMap, pose_a_b: Array) -> float:
    standing, known = _count_standing(
        grid_b.log_odds, np.asarray(grid_b.origin_m, float), grid_b.resolution_m, grid_a.log_odds,
        np.asarray(grid_a.origin_m, float), grid_a.resolution_m, np.asarray(pose_a_b, float),
    )  # fmt: skip
    return standing / known if known >= KNOWN_MIN else 0.0


@kernel
def _is_near_wall(log_odds, row, column):
    """Whether a wall lies at most NEAR_CELLS steps up, down, left or right."""
    for r in range(max(row - NEAR_CELLS, 0), min(row + NEAR_CELLS + 1, log_odds.shape[0])):
        reach = NEAR_CELLS - abs(r - row)
        for c in range(max(column - reach, 0), min(column + reach + 1, log_odds.shape[1])):
            if log_odds[r, c] > 0:
                return True
    return False


@kernel
def _count_standing(walls, walls_origin, walls_cell, free, free_origin, free_cell, pose):
    """Certain walls of one grid that stand in certain free space of the other, and all that it is certain about."""
    c, s = math.cos(pose[2]), math.sin(pose[2])
    standing = known = 0
    for i in range(walls.shape[0]):
        for first in range(0, walls.shape[1], CELLS_AT_ONCE):
            end = min(first + CELLS_AT_ONCE, walls.shape[1])
            highest = walls[i, first]
            for j in range(first, end):
                highest = max(highest, walls[i, j])
            if highest < WALL_LOG_ODDS:
                continue
            for j in range(first, end):
                if walls[i, j] < WALL_LOG_ODDS:
                    continue
                x, y = walls_origin[0] + (j + 0.5) * walls_cell, walls_origin[1] + (i + 0.5) * walls_cell
                column = int(math.floor((pose[0] + c * x - s * y - free_origin[0]) / free_cell))
                row = int(math.floor((pose[1] + s * x + c * y - free_origin[1]) / free_cell))
                if row < 0 or column < 0 or row >= free.shape[0] or column >= free.shape[1]:
                    continue
                level = free[row, column]
                known += abs(level) >= -FREE_LOG_ODDS
                standing += level <= FREE_LOG_ODDS and not _is_near_wall(free, row, column)
    return standing, known


@kernel
def _fingerprint_distance_db(macs, levels, starts, a, b, differences):
    """Rms difference over shared transmitters after removing its mean (the two receivers' offset); NaN below three."""
    count, total = 0, 0.0
    i, j = starts[a], starts[b]
    while i < starts[a + 1] and j < starts[b + 1]:
        if macs[i] < macs[j]:
            i += 1
        elif macs[i] > macs[j]:
            j += 1
        else:
            differences[count] = levels[i] - levels[j]
            total += differences[count]
            count += 1
            i += 1
            j += 1
    if count < 3:
        return math.nan
    mean, squares = total / count, 0.0
    for k in range(count):
        squares += (differences[k] - mean) ** 2
    return math.sqrt(squares / count)


@kernel
def _compare_places(macs, levels, starts, places, positions, robots, travels, is_b):
    """The distances of places brought together and of the yardstick's pairs."""
    together, reference = np.empty(256), np.empty(256)
    found = learned = longest = 0
    for i in range(positions.shape[0]):
        longest = max(longest, starts[places[i] + 1] - starts[places[i]])
    differences = np.empty(longest)
    reach = max(SAME_PLACE_M, REFERENCE_M[1])
    for i in range(0, positions.shape[0], max(positions.shape[0] // PLACES_MAX, 1)):
        for j in range(i, positions.shape[0]):
            dx, dy = positions[i, 0] - positions[j, 0], positions[i, 1] - positions[j, 1]
            if abs(dx) > reach or abs(dy) > reach:
                continue
            apart = math.sqrt(dx * dx + dy * dy)
            is_together = apart < SAME_PLACE_M and is_b[i] != is_b[j]
            is_own = robots[i] == robots[j] and abs(travels[i] - travels[j]) < 2 * REFERENCE_M[1]
            is_yardstick = is_own and REFERENCE_M[0] <= apart <= REFERENCE_M[1]
            if not is_together and not is_yardstick:
                continue
            distance = _fingerprint_distance_db(macs, levels, starts, places[i], places[j], differences)
            if math.isnan(distance):
                continue
            if is_together:
                if found == len(together):
                    together = enlarged(together, 0)
                together[found] = distance
                found += 1
            if is_yardstick:
                if learned == len(reference):
                    reference = enlarged(reference, 0)
                reference[learned] = distance
                learned += 1
    return together[:found], reference[:learned]


def wifi_agrees(
    positions: Array, robots: Array, travels_m: Array, heard: HeardPlaces, places: Array, is_b: Array
) -> bool | None:  # fmt: skip
    """Whether places that a merge would bring together sound alike; None while too few places can be compared.

    positions (k, 2) of all keyframes of both groups in the proposed common frame, robots (k,), travels_m (k,) path
    length of each, what was heard at many, places (k,) which of these each is, is_b (k,) bool. The yardstick is learned
    here and now: the median distance between fingerprints of one robot taken REFERENCE_M apart.
    """
    together, reference = _compare_places(
        heard.macs, heard.rssi_dbm, heard.starts, places, np.ascontiguousarray(positions, float), robots, travels_m,
        is_b,
    )  # fmt: skip
    if len(together) < PAIRS_MIN or len(reference) < PAIRS_MIN:
        return None
    return _middle(together) <= REFERENCE_SLACK * _middle(reference)


def _middle(values: Array) -> float:
    """The median: numpy's own takes ten times as long where values are few."""
    ascending = np.sort(values)
    return float(ascending[(len(values) - 1) // 2] + ascending[len(values) // 2]) / 2
