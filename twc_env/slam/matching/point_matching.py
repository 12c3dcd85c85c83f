"""Point-to-point ICP as printed in TWC-SLAM (Eq. 11-12): pair nearest points within a gate, align, repeat.

The paper does not specify the gate, the number of iterations or the stopping rule; here the gate shrinks from 1 m to
0.3 m. Kept beside point-to-line matching so that both can be measured. Two scans sample a wall at different points, so
that point pairs pull towards the guess, and along a corridor they seem to constrain its axis.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.records.array_validation import validated_points, validated_pose
from twc_env.records.geometry import align_rigidly, between, transform_points

if TYPE_CHECKING:
    from scipy.spatial import cKDTree


GATE_FIRST_M, GATE_LAST_M, GATE_SHRINK = 1.0, 0.3, 0.85
"""Points further apart are not paired; the gate shrinks by this factor per iteration."""
ITERATIONS_MAX = 30
STOP = 1e-4
"""A step [m, rad] below this, with the gate at its minimum, ends the iteration."""
PAIRS_MIN = 3


@dataclass(frozen=True, slots=True, eq=False)
class PointMatch:
    """Result of aligning one point cloud to another."""

    pose: Array
    """(3,) of the source in the target's frame."""
    fitness_m2: float
    """Mean squared distance of the pairs (Eq. 12); NaN without pairs."""
    inlier_ratio: float
    """Share of source points with a partner within the last gate."""
    hessian: Array
    """(3, 3) sum of J^T J over the pairs."""

    def information(self, beam_std_m: float, correlation: float) -> Array:
        """(3, 3) information of `pose`, treating every pair as a point measurement."""
        return self.hessian / (beam_std_m**2 * correlation)


def match_points(target: Array, source: Array, guess: Array) -> PointMatch:
    """Align source points (m, 2) to target points (n, 2) from a guess (3,) of the source's pose in the target's frame.

    Raises DataError for points or a guess of another shape, or not finite.
    """
    target, source = validated_points(target, "target points"), validated_points(source, "source points")
    pose = validated_pose(guess, "guess").copy()
    if len(target) == 0 or len(source) == 0:
        return PointMatch(pose, np.nan, 0.0, np.zeros((3, 3)))
    from scipy.spatial import cKDTree  # slow to import, and not used by the default method

    return match_to_tree(cKDTree(target), source, pose)


def match_to_tree(tree: cKDTree, source: Array, guess: Array, gate_first_m: float = GATE_FIRST_M) -> PointMatch:
    """The same for target points in a tree, which many matches share; points and guess are not checked."""
    target, pose, gate_m = tree.data, guess.copy(), gate_first_m
    for _ in range(ITERATIONS_MAX):
        away_m, nearest = tree.query(transform_points(pose, source), distance_upper_bound=gate_m)
        paired = np.isfinite(away_m)
        if np.count_nonzero(paired) < PAIRS_MIN:
            break
        before, pose = pose, align_rigidly(source[paired], target[nearest[paired]])
        if gate_m == GATE_LAST_M and np.abs(between(before, pose)).max() < STOP:
            break
        gate_m = max(GATE_LAST_M, GATE_SHRINK * gate_m)
    return _evaluated(tree, source, pose)


def _evaluated(tree: cKDTree, source: Array, pose: Array) -> PointMatch:
    """Evaluate the match at its final pose, over the pairs within the last gate."""
    away_m, _ = tree.query(transform_points(pose, source), distance_upper_bound=GATE_LAST_M)
    paired = np.isfinite(away_m)
    count = int(np.count_nonzero(paired))
    if count < PAIRS_MIN:
        return PointMatch(pose, np.nan, count / len(source), np.zeros((3, 3)))
    x, y = transform_points(np.array([0.0, 0.0, pose[2]]), source[paired]).T
    turn_x, turn_y = -y.sum(), x.sum()
    hessian = np.array([[count, 0.0, turn_x], [0.0, count, turn_y], [turn_x, turn_y, (x**2 + y**2).sum()]])
    return PointMatch(pose, float(np.mean(away_m[paired] ** 2)), count / len(source), hessian)
