"""Test whether two groups of robots can be merged into one map frame.

An inter-group closure measures the transform between two maps. One closure is not enough, because rooms look alike and
sign texts repeat. A merge needs several closures that agree on one transform, no walls of one map in the free space of
the other, radio fingerprints as similar as the robots' own paths predict for one place, and signs that mostly read the
same where the maps overlap (`sign_consistency`). Without any fingerprint, one sign must have a name read nowhere else.
Where the robots saw each other often enough as a closure by a sign implies (`mutual_observations`), it alone is enough.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.config import MergingConfig
from twc_env.kernels.compiled import kernel
from twc_env.records.geometry import compose, inverse, wrap_angle
from twc_env.records.growing_arrays import enlarged
from twc_env.records.messages import GridMap, LoopClosure
from twc_env.slam.places.heard_places import HeardPlaces

DRIFT_PER_M = 0.02
"""Allowed disagreement of two closures grows by this much per metre between their keyframes in map b."""
WALL_LOG_ODDS, FREE_LOG_ODDS = 20, -12
"""Log-odds beyond which a cell counts as certain when two maps are compared."""
KNOWN_MIN = 20
"""Minimum number of certain wall cells that fall on certain cells of the other map."""
CELLS_AT_ONCE = 32
"""Cells scanned per block; most blocks hold no wall and are skipped."""
NEAR_CELLS = 3
"""A wall this many cells (Manhattan distance) from a wall of the other map is not in its free space."""
SAME_PLACE_M = 1.2
"""Two places of different groups closer than this after a merge must have fingerprints ..."""
REFERENCE_M = (1.5, 3.5)
"""... more alike than pairs of one robot at this distance range ..."""
SOON_M, LATER_M = (0.0, 2 * REFERENCE_M[1]), (40.0, math.inf)
"""... heard soon after each other, or when it came back: the path length between them."""
PAIRS_MIN, PLACES_MAX = 4, 150
"""Minimum number of pairs for a decision; of more than twice PLACES_MAX places only every n-th is compared with all."""
APART_M, APART_RAD = 1.5, 0.35
"""Two hypotheses that place a keyframe further apart than this, or turn it by more, exclude each other."""


Weight = tuple[int, int, int]
"""Weight of a merge hypothesis, compared lexicographically: distinct signs that both sides read identically, distinct
signs, closures. Signs closer than `spread_min_m` count once, and each sign once however often it was seen: where names
are numbered consecutively, the name of a room is similar to that of the next, and so are all names that follow."""


@dataclass(frozen=True, slots=True, eq=False)
class MergeProposal:
    """A transform from map b to map a and the closures that support it."""

    pose_a_b: Array
    """(3,) pose of map b in map a."""
    support: Array
    """(closures,) bool: inliers among the given closures."""
    weight: Weight
    agreeing: tuple[LoopClosure, ...] = ()
    """The inlier closures themselves, where the caller provides them."""
    is_proven: bool = False
    """Whether mutual observations of the robots prove it (`mutual_observations`), so that one closure is enough."""


def largest_agreement(
    targets: Array, sources: Array, measured: Array, signs_m: Array, is_read_alike: Array, config: MergingConfig
) -> MergeProposal | None:
    """The merge hypothesis of largest weight; None with fewer than `closures_min` closures or support from one sign
    only.

    targets (k, 3) keyframes in map a, sources (k, 3) in map b, measured (k, 3) source in the target's frame, signs_m
    (k, 2) position of each closure's sign in map a, is_read_alike (k,) bool whether both readings are identical. At
    least two signs `spread_min_m` apart must agree, since a single sign may have a duplicate elsewhere.
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


def agree_with(pose_a_b: Array, in_a: Array, sources: Array, config: MergingConfig) -> Array:
    """(k,) bool: closures consistent with a hypothesis; in_a, sources (k, 3): poses of their keyframes of b, in the map
    of a by the closure itself, and in b.

    Unlike `_heaviest_agreement` without DRIFT_PER_M: a hypothesis that mutual observations prove needs no further
    support, and a closure that agrees only within the drift between two places is to be tried as a hypothesis of its
    own.
    """
    apart = compose(pose_a_b, sources) - in_a
    turned = np.abs(wrap_angle(apart[:, 2]))
    return (np.hypot(apart[:, 0], apart[:, 1]) <= config.consistency_m) & (turned <= config.consistency_rad)


def exclude(apart: Array) -> Array:
    """(k,) bool: whether two poses of one keyframe, this far apart (k, 3), exclude each other."""
    return (np.hypot(apart[:, 0], apart[:, 1]) > APART_M) | (np.abs(wrap_angle(apart[:, 2])) > APART_RAD)


@kernel
def _apart_m(pose, in_a, source):
    """Distance [m] between source keyframe (3,) transformed by `pose` (3,) and its position in a by its own closure."""
    c, s = math.cos(pose[2]), math.sin(pose[2])
    x, y = pose[0] + c * source[0] - s * source[1] - in_a[0], pose[1] + s * source[0] + c * source[1] - in_a[1]
    return math.hypot(x, y)


@kernel
def _heaviest_agreement(
    poses_a_b, in_a, sources, signs_m, is_read_alike, consistency_m, consistency_rad, spread_min_m, closures_min
):
    """Inliers (n,) of the hypothesis of largest weight and the first two parts of that weight; empty if none
    suffices."""
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
    """Whether at least two of the chosen signs are `apart_m` or more from each other."""
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
    """Number of chosen signs, rows of (k, 2), after greedy suppression of those closer than `apart_m` to a counted
    one."""
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
    """The inlier (of n) whose transform has the smallest sum of distances to all inliers."""
    best, least = rows[0], math.inf
    for i in rows:
        total = 0.0
        for j in rows:
            total += _apart_m(poses_a_b[i], in_a[j], sources[j])
        if total < least:
            best, least = i, total
    return best


def weight_of(signs_m: Array, is_read_alike: Array, config: MergingConfig) -> Weight:
    """Weight of closures with these signs (k, 2) and identical-reading flags (k,)."""
    every, apart_m = np.arange(len(signs_m)), config.spread_min_m
    return count_places(signs_m, every[is_read_alike], apart_m), count_places(signs_m, every, apart_m), len(signs_m)


def wall_contradiction(grid_a: GridMap, grid_b: GridMap, pose_a_b: Array) -> float:
    """Larger of the two shares of certain walls of one map in certain free space of the other, over the common known
    area."""
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
    """Whether a wall cell lies within NEAR_CELLS (Manhattan distance)."""
    for r in range(max(row - NEAR_CELLS, 0), min(row + NEAR_CELLS + 1, log_odds.shape[0])):
        reach = NEAR_CELLS - abs(r - row)
        for c in range(max(column - reach, 0), min(column + reach + 1, log_odds.shape[1])):
            if log_odds[r, c] > 0:
                return True
    return False


@kernel
def _count_standing(walls, walls_origin, walls_cell, free, free_origin, free_cell, pose):
    """Certain walls of one grid in certain free space of the other, and those on any certain cell of it."""
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
    """RMS difference [dB] over shared transmitters after removing the mean (receiver offset); NaN with fewer than
    three."""
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
def _compare_places(macs, levels, starts, places, positions, robots, travels, is_b, least_m, most_m):
    """Fingerprint distances [dB] of pairs that the merge brings together, and of the reference pairs."""
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
            is_own = robots[i] == robots[j] and least_m <= abs(travels[i] - travels[j]) < most_m
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


def wifi_difference(
    positions: Array, robots: Array, travels_m: Array, heard: HeardPlaces, places: Array, is_b: Array,
    between_m: tuple[float, float] = SOON_M,
) -> float | None:  # fmt: skip
    """How different the fingerprints of places are that a merge would bring together, as a share of the reference;
    None with too few pairs to compare.

    positions (k, 2) of all keyframes of both groups in the proposed common frame, robots (k,), travels_m (k,) path
    length of each, `heard` fingerprints, places (k,) index of each keyframe's fingerprint in it, is_b (k,) bool. The
    reference is computed from the same data: the median distance of fingerprints of one robot taken REFERENCE_M apart,
    `between_m` along its path.
    """
    together, reference = _compare_places(
        heard.macs, heard.rssi_dbm, heard.starts, places, np.ascontiguousarray(positions, float), robots, travels_m,
        is_b, *between_m,
    )  # fmt: skip
    if len(together) < PAIRS_MIN or len(reference) < PAIRS_MIN:
        return None
    return _median(together) / max(_median(reference), 1e-9)


def _median(values: Array) -> float:
    """The median; numpy's own takes ten times as long for few values."""
    ascending = np.sort(values)
    return float(ascending[(len(values) - 1) // 2] + ascending[len(values) // 2]) / 2
