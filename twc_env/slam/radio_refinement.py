"""The last fit of radio SLAM: the path that is likeliest under odometry and under all that was heard along it at once.

Ties between single places (`radio_field`) tell displacements one by one. The evidence of the whole layout
(`radio_evidence`) also weighs what is alike far away and what is not, so it sees how the map lies as a whole. Its slope
by every place moves the path, whose unknowns are the errors of each motion in units of their deviation: steps are then
even, however long the path (maximum a posteriori; WiFi-SLAM, Ferris, Fox, Lawrence 2007, without its latent dynamics).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from twc_env.geometry import between, wrap_angle
from twc_env.slam.odometry_calibration import Motions, calibration, reckoned_poses
from twc_env.slam.radio_evidence import FieldEvidence

Array = NDArray

EVIDENCE_WEIGHT = 32.0
"""What is heard weighs as so many independent transmitters, against odometry of the configured noise. Chosen
in the semi-indoor twin, walks 0 to 3 and 100 to 105."""
ROUNDS, ITERATIONS, SIZE_ITERATIONS = 3, 40, 30
"""Each round calibrates the odometry, moves the path, then fits the covariance anew, which is first fitted in more."""


@dataclass(frozen=True, slots=True, eq=False)
class Refined:
    """A refined path."""

    poses: Array
    """(p, 3)."""
    misfit: float
    """Minus the logarithm of its probability, up to a constant: of paths by the same evidence the lowest is best."""
    explained: float
    """Share of what was heard, by variance, that places explain: the rest is noise, or shared by neighbours along the
    path only."""


def refined(poses: Array, motions: Motions, information: Array, evidences: Sequence[FieldEvidence]) -> Refined:
    """The path that is likeliest, from poses (p, 3); its first pose is the origin.

    `motions` lead from place to place, with information (p - 1, 3, 3) of which only the diagonal counts. Fields of any
    size explain what was heard as well in a map of that size: so it is the odometry's, whatever size the poses have.
    """
    std = 1.0 / np.sqrt(np.diagonal(information, axis1=1, axis2=2))
    poses = poses / [*2 * [calibration(motions, poses).scale], 1.0]
    sizes = [evidence.fitted(poses[:, :2], iterations=SIZE_ITERATIONS)[1] for evidence in evidences]
    strain = values = 0.0
    for _ in range(ROUNDS):
        motion = replace(calibration(motions, poses), scale=1.0).applied(motions).motion

        def cost(flat: Array, motion: Array = motion, sizes: Sequence[Array] = tuple(sizes)) -> tuple[float, Array]:
            moved = motion + std * flat.reshape(-1, 3)
            placed = reckoned_poses(moved)
            total, by_place = 0.5 * float(flat @ flat), np.zeros((len(placed), 2))
            for evidence, size in zip(evidences, sizes, strict=True):
                value, slope = evidence.slopes(placed[:, :2], size)
                total -= EVIDENCE_WEIGHT * value
                by_place -= EVIDENCE_WEIGHT * slope
            return total, flat + (std * by_motion(placed, moved, by_place)).ravel()

        missed = between(poses[:-1], poses[1:]) - motion
        missed[:, 2] = wrap_angle(missed[:, 2])
        found = minimize(cost, (missed / std).ravel(), method="L-BFGS-B", jac=True, options={"maxiter": ITERATIONS})
        poses = reckoned_poses(motion + std * found.x.reshape(-1, 3))
        strain = 0.5 * float(found.x @ found.x)
        fits = [evidence.fitted(poses[:, :2], size) for evidence, size in zip(evidences, sizes, strict=True)]
        values, sizes = sum(value for value, _ in fits), [size for _, size in fits]
    shares = [_explained(size) for size in sizes]
    return Refined(poses, strain - EVIDENCE_WEIGHT * values, sum(shares) / max(len(shares), 1))


def _explained(size: Array) -> float:
    """Share of the variance of a fitted covariance (`FieldEvidence.fitted`) that depends on places."""
    places, rest = np.exp(size[:2]).sum(), np.exp(size[4:6]).sum()
    return float(places / (places + rest))


def by_motion(poses: Array, motions: Array, by_place: Array) -> Array:
    """Slopes (p - 1, 3) by the motions between poses (p, 3), from slopes (p, 2) by their places: every later place
    moves with a motion, and swings with its turn."""
    later = np.cumsum(by_place[::-1], axis=0)[::-1][1:]
    c, s = np.cos(poses[:-1, 2]), np.sin(poses[:-1, 2])
    ahead, left = c * later[:, 0] + s * later[:, 1], -s * later[:, 0] + c * later[:, 1]
    by_heading = left * motions[:, 0] - ahead * motions[:, 1]
    swing = np.cumsum(by_heading[::-1])[::-1]
    return np.column_stack([ahead, left, np.append(swing[1:], 0.0)])
