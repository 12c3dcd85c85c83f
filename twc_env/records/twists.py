"""SE(2) as a Lie group: twists (x [m], y [m], turn [rad]) and the transformation of twists and covariances.

World-frame twists along an odometry chain can be summed, however far it turns, and so can their covariances.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.records.geometry import wrap_angle


def adjoint(poses: Array) -> Array:
    """(..., 3, 3) adjoint: maps a twist from the pose's own frame to the world frame."""
    out = np.zeros((*poses.shape[:-1], 3, 3))
    c, s = np.cos(poses[..., 2]), np.sin(poses[..., 2])
    out[..., 0, 0], out[..., 0, 1], out[..., 0, 2] = c, -s, poses[..., 1]
    out[..., 1, 0], out[..., 1, 1], out[..., 1, 2] = s, c, -poses[..., 0]
    out[..., 2, 2] = 1.0
    return out


def logarithm(poses: Array) -> Array:
    """(..., 3): the twist whose exponential is the pose."""
    half = wrap_angle(poses[..., 2]) / 2
    ratio = np.where(np.abs(half) < 1e-6, 1.0, half / np.where(np.abs(half) < 1e-6, 1.0, np.tan(half)))
    x, y = poses[..., 0], poses[..., 1]
    return np.stack([ratio * x + half * y, -half * x + ratio * y, 2 * half], axis=-1)


def turned(matrix: Array, covariance: Array) -> Array:
    """(..., 3, 3): matrix @ covariance @ matrix^T."""
    return matrix @ covariance @ np.swapaxes(matrix, -1, -2)


def squared_length(error: Array, covariance: Array) -> Array:
    """(...,): squared Mahalanobis length of errors (..., 3)."""
    return (error * np.linalg.solve(covariance, error[..., None])[..., 0]).sum(axis=-1)
