"""Decide when two groups of robots share one building well enough to be put into one frame.

A closure between two groups says where one map lies in the other. One closure is no proof: rooms look alike and signs
repeat. A merge needs several closures that agree, no walls of one map in the free space of the other, and fingerprints
that are as alike as the robots' own paths say fingerprints of one place are.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation

from twc_env.config import MergingConfig
from twc_env.geometry import between, compose, inverse, transform_points
from twc_env.messages import Fingerprint, GridMap

Array = NDArray

DRIFT_PER_M = 0.02
"""Closures this far apart may disagree by this much more, per metre."""
WALL_LOG_ODDS, FREE_LOG_ODDS = 20, -12
"""Cells counted as certain when two maps are compared."""
SAME_PLACE_M = 1.2
"""Fingerprints this near each other after a merge should be alike ..."""
REFERENCE_M = (1.5, 3.5)
"""... at least as alike as those of one robot at this distance."""
PAIRS_MIN = 4
REFERENCE_SLACK = 1.1


@dataclass(frozen=True, slots=True, eq=False)
class MergeProposal:
    """Where group b lies in the map of group a, and the closures that say so."""

    pose_a_b: Array
    """(3,)."""
    support: Array
    """(closures,) bool: which of the closures agree."""


def largest_agreement(
    targets: Array, sources: Array, measured: Array, signs_m: Array, config: MergingConfig
) -> MergeProposal | None:
    """The pose of b in a on which most closures agree; None while too few do or all stem from one sign.

    targets (k, 3) keyframes in map a, sources (k, 3) in map b, measured (k, 3) source in the target's frame, signs_m
    (k, 2) the sign behind each closure, in its own map: a single sign may have a twin elsewhere, so at least two that
    lie apart must agree.
    """
    if len(targets) < config.closures_min:
        return None
    in_a = compose(targets, measured)
    poses_a_b = compose(in_a, inverse(sources))
    predicted = compose(poses_a_b[:, None], sources[None])  # (seed, closure, 3)
    error = between(in_a[None], predicted)
    distance = np.linalg.norm(sources[:, None, :2] - sources[None, :, :2], axis=2)
    agrees = np.linalg.norm(error[..., :2], axis=2) <= config.consistency_m + DRIFT_PER_M * distance
    agrees &= np.abs(error[..., 2]) <= config.consistency_rad
    between_signs = np.linalg.norm(signs_m[:, None] - signs_m[None, :], axis=2)
    spread = np.array([between_signs[np.ix_(row, row)].max() for row in agrees])
    votes = np.where(spread >= config.spread_min_m, agrees.sum(axis=1), 0)
    seed = int(np.argmax(votes))
    if votes[seed] < config.closures_min:
        return None
    support = agrees[seed]
    cost = np.where(support[None, :], np.linalg.norm(error[..., :2], axis=2), 0.0).sum(axis=1)
    best = int(np.flatnonzero(support)[np.argmin(cost[support])])
    return MergeProposal(poses_a_b[best], support)


def wall_contradiction(grid_a: GridMap, grid_b: GridMap, pose_a_b: Array) -> float:
    """Larger share of one map's certain walls that stand in the certain free space of the other, where both know."""
    return max(
        _walls_in_free_space(grid_a, grid_b, pose_a_b),
        _walls_in_free_space(grid_b, grid_a, inverse(pose_a_b)),
    )


def _walls_in_free_space(grid_a: GridMap, grid_b: GridMap, pose_a_b: Array) -> float:
    walls = grid_b.centre_of(np.argwhere(grid_b.log_odds >= WALL_LOG_ODDS))
    if len(walls) == 0:
        return 0.0
    cells = grid_a.cell_of(transform_points(pose_a_b, walls))
    inside = np.all((cells >= 0) & (cells < grid_a.log_odds.shape), axis=1)
    row, column = cells[inside].T
    near_wall = binary_dilation(grid_a.log_odds > 0, iterations=3)
    level = grid_a.log_odds[row, column]
    known = np.abs(level) >= -FREE_LOG_ODDS
    if known.sum() < 20:
        return 0.0
    return float(((level <= FREE_LOG_ODDS) & ~near_wall[row, column]).sum() / known.sum())


def fingerprint_matrix(fingerprints: Sequence[Fingerprint]) -> Array:
    """(places, transmitters) strength [dBm], NaN where not heard."""
    macs = np.unique(np.concatenate([f.macs for f in fingerprints]))
    levels = np.full((len(fingerprints), len(macs)), np.nan)
    for row, f in enumerate(fingerprints):
        levels[row, np.searchsorted(macs, f.macs)] = f.rssi_dbm
    return levels


def fingerprint_distances_db(levels: Array, first: Array, second: Array) -> Array:
    """(pairs,) rms difference over shared transmitters after removing its mean (the two receivers' offset)."""
    difference = levels[first] - levels[second]
    count = np.isfinite(difference).sum(axis=1)
    usable = count >= 3
    difference = difference[usable]
    difference = difference - np.nanmean(difference, axis=1, keepdims=True)
    return np.sqrt(np.nanmean(difference**2, axis=1))


def wifi_agrees(
    positions: Array, robots: Array, travels_m: Array, fingerprints: Sequence[Fingerprint], is_b: Array
) -> bool | None:
    """Whether places that a merge would bring together sound alike; None while too few places can be compared.

    positions (k, 2) of all keyframes of both groups in the proposed common frame, robots (k,), travels_m (k,) path
    length of each, is_b (k,) bool. The yardstick is learned here and now: the median distance between fingerprints of
    one robot taken REFERENCE_M apart.
    """
    levels = fingerprint_matrix(fingerprints)
    apart = np.linalg.norm(positions[:, None] - positions[None], axis=2)
    first, second = np.nonzero((apart < SAME_PLACE_M) & ~is_b[:, None] & is_b[None])
    together = fingerprint_distances_db(levels, first, second)
    own = (robots[:, None] == robots[None]) & (np.abs(travels_m[:, None] - travels_m[None]) < 2 * REFERENCE_M[1])
    first, second = np.nonzero(np.triu(own & (apart >= REFERENCE_M[0]) & (apart <= REFERENCE_M[1])))
    reference = fingerprint_distances_db(levels, first, second)
    if len(together) < PAIRS_MIN or len(reference) < PAIRS_MIN:
        return None
    return bool(np.median(together) <= REFERENCE_SLACK * np.median(reference))
