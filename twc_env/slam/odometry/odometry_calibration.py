"""Estimate systematic odometry errors from an optimised path.

Unequal wheels add the same angle per metre (curl), and turns are over- or underestimated by one factor. Over a
kilometre these errors outweigh all noise, and a few parameters correct them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.records.geometry import between, poses_along, wrap_angle

PIECE = 20
"""Motions summed before comparison, since single ones are mostly noise."""
CURL_STD_RAD_M, TURN_STD = 0.03, 0.2
"""Prior standard deviations of curl [rad/m] and turn error [share]."""
NOISE_RAD = 0.05
"""Expected heading noise over one metre."""


@dataclass(frozen=True, slots=True, eq=False)
class Motions:
    """Odometry of one chain of poses: motion (n - 1, 3) to the next pose, turned_rad (n - 1,) not wrapped."""

    motion: Array
    turned_rad: Array
    bent: Array | None = None
    """(2, n - 1, 3) derivative of motions with respect to curl [rad/m] and turn error (share). None: the motions are
    straight and both errors turn the robot at their end."""

    def __len__(self) -> int:
        return len(self.motion)

    @property
    def causes(self) -> Array:
        """(2, n - 1, 3) derivatives as `bent`."""
        if self.bent is not None:
            return self.bent
        causes = np.zeros((2, *self.motion.shape))
        causes[:, :, 2] = self.length_m, self.turned_rad
        return causes

    @property
    def length_m(self) -> Array:
        """(n - 1,) [m]."""
        return np.hypot(self.motion[:, 0], self.motion[:, 1])


@dataclass(frozen=True, slots=True)
class Calibration:
    """Systematic errors that are constant along a path."""

    scale: float = 1.0
    curl_rad_m: float = 0.0
    turn: float = 0.0
    """Missing share of each turn."""

    def applied(self, motions: Motions) -> Motions:
        """The motions with these errors removed."""
        curl, turn = motions.causes
        more = self.curl_rad_m * curl + self.turn * turn
        motion = motions.motion + more
        motion[:, :2] *= self.scale
        motion[:, 2] = wrap_angle(motion[:, 2])
        return Motions(motion, motions.turned_rad + more[:, 2], motions.bent)

    def then(self, other: Calibration) -> Calibration:
        """Composition: this calibration, then the other."""
        return Calibration(
            self.scale * other.scale,
            self.curl_rad_m * (1.0 + other.turn) + other.curl_rad_m * self.scale,
            self.turn + other.turn + self.turn * other.turn,
        )


def between_places(steps: Motions, places: Array) -> Motions:
    """Motions between chosen poses (k,) of a chain, ascending from 0, with their derivatives by the constant errors."""
    poses = poses_along(steps.motion)
    starts, ends = poses[places[:-1]], poses[places[1:]]
    motion_of = np.repeat(np.arange(len(starts)), np.diff(places))
    arm = ends[motion_of, :2] - 0.5 * (poses[:-1, :2] + poses[1:, :2])[: len(motion_of)]
    c, s = np.cos(starts[motion_of, 2]), np.sin(starts[motion_of, 2])
    swing = np.column_stack([s * arm[:, 0] - c * arm[:, 1], c * arm[:, 0] + s * arm[:, 1]])
    turned = np.stack([steps.length_m, steps.turned_rad])[:, : len(motion_of), None]
    bent = np.add.reduceat(turned * np.column_stack([swing, np.ones(len(arm))]), places[:-1], axis=1)
    return Motions(between(starts, ends), bent[1, :, 2], bent)


def calibration(motions: Motions, poses: Array) -> Calibration:
    """Scale, curl and turn error by least squares from optimised poses and the odometry of the same first part.

    poses: (k, 3) of the first k keyframes, with k - 1 of the motions.
    """
    corrected = between(poses[:-1], poses[1:])
    length, fitted = motions.length_m, len(corrected)
    travel_m = length[:fitted].sum()
    scale = np.hypot(corrected[:, 0], corrected[:, 1]).sum() / travel_m if travel_m > 0 else 1.0
    piece = np.arange(fitted) // PIECE
    missing = np.bincount(piece, wrap_angle(corrected[:, 2] - motions.motion[:fitted, 2]))
    causes = np.column_stack([np.bincount(piece, cause[:fitted, 2]) for cause in motions.causes])
    weight = 1.0 / (NOISE_RAD**2 * (causes[:, :1] + 0.1))
    normal = (causes * weight).T @ causes + np.diag([CURL_STD_RAD_M**-2, TURN_STD**-2])
    curl, turn = np.linalg.solve(normal, (causes * weight).T @ missing)
    return Calibration(float(scale), float(curl), float(turn))


def calibrated(motions: Motions, poses: Array) -> Motions:
    """All motions corrected by the errors that `poses` (k, 3), which cover the first k - 1, show (`calibration`)."""
    return calibration(motions, poses).applied(motions)
