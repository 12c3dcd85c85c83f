"""Point-to-point ICP as TWC-SLAM prints it (Eq. 11-12): pair nearest points under a gate, turn and shift, repeat.

The paper leaves open the gate, the number of repetitions and when to stop; here the gate shrinks from 1 m to 0.3 m. It
is kept beside point-to-line matching so that both can be measured: pairing points of walls that two scans sample at
different places pulls towards the guess, and what is paired along a corridor looks as if it fixed the corridor's axis.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.geometry import align_rigidly, between, transform_points
from twc_env.slam.given_arrays import given_points, given_pose

if TYPE_CHECKING:
    from scipy.spatial import cKDTree


GATE_FIRST_M, GATE_LAST_M, GATE_SHRINK = 1.0, 0.3, 0.85
"""Points further apart are no pair; the gate shrinks by this factor with every repetition."""
ITERATIONS_MAX = 30
STOP = 1e-4
"""A step [m, rad] below it, once the gate has shrunk, ends the match."""
PAIRS_MIN = 3


@dataclass(frozen=True, slots=True, eq=False)
class PointMatch:
    """Where a cloud of points lies on another."""

    pose: Array
    """(3,) of the source in the target's frame."""
    fitness_m2: float
    """Mean squared distance of the pairs, Eq. 12; NaN without any."""
    inlier_ratio: float
    """Share of the source's points that have a partner within the last gate."""
    hessian: Array
    """(3, 3) sum of J^T J over the pairs."""

    def information(self, beam_std_m: float, correlation: float) -> Array:
        """(3, 3) information of `pose`, as if every pair were a measured point."""
        return self.hessian / (beam_std_m**2 * correlation)


def match_points(target: Array, source: Array, guess: Array) -> PointMatch:
    """Lay source points (m, 2) on target points (n, 2) from a guess (3,) of the source's pose in the target's frame.

    Raises DataError for points or a guess of another shape, or not finite.
    """
    target, source = given_points(target, "target points"), given_points(source, "source points")
    pose, gate_m = given_pose(guess, "guess").copy(), GATE_FIRST_M
    if len(target) == 0 or len(source) == 0:
        return PointMatch(pose, np.nan, 0.0, np.zeros((3, 3)))
    from scipy.spatial import cKDTree  # slow to import, and not used by the default method

    tree = cKDTree(target)
    for _ in range(ITERATIONS_MAX):
        away_m, nearest = tree.query(transform_points(pose, source), distance_upper_bound=gate_m)
        paired = np.isfinite(away_m)
        if np.count_nonzero(paired) < PAIRS_MIN:
            break
        before, pose = pose, align_rigidly(source[paired], target[nearest[paired]])
        if gate_m == GATE_LAST_M and np.abs(between(before, pose)).max() < STOP:
            break
        gate_m = max(GATE_LAST_M, GATE_SHRINK * gate_m)
    return _judged(tree, source, pose)


def _judged(tree: cKDTree, source: Array, pose: Array) -> PointMatch:
    """The match at its final pose, over the pairs within the last gate."""
    away_m, _ = tree.query(transform_points(pose, source), distance_upper_bound=GATE_LAST_M)
    paired = np.isfinite(away_m)
    count = int(np.count_nonzero(paired))
    if count < PAIRS_MIN:
        return PointMatch(pose, np.nan, count / len(source), np.zeros((3, 3)))
    x, y = transform_points(np.array([0.0, 0.0, pose[2]]), source[paired]).T
    turn_x, turn_y = -y.sum(), x.sum()
    hessian = np.array([[count, 0.0, turn_x], [0.0, count, turn_y], [turn_x, turn_y, (x**2 + y**2).sum()]])
    return PointMatch(pose, float(np.mean(away_m[paired] ** 2)), count / len(source), hessian)
