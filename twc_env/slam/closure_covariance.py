"""How well a closure is measured, from what its match and the candidate itself say of the pose."""

from __future__ import annotations

import math

import numpy as np
from numba.core import types
from numba.extending import intrinsic
from numpy.typing import NDArray as Array

from twc_env.kernels import kernel
from twc_env.slam.small_matrices import invert3

STD_MIN = np.array((0.03, 0.03, 0.01))
"""No match is known better than this [m, m, rad]."""


@intrinsic
def _fused(_context, a, b, c):
    """a b + c, rounded once, as libraries of matrices work out their products."""

    def generate(_target, builder, _signature, arguments):
        return builder.fma(*arguments)

    return types.float64(types.float64, types.float64, types.float64), generate


@kernel
def _covariance(information, prior, heading, out):
    """See `closure_covariance`."""
    c, s = math.cos(heading), math.sin(heading)
    turned, own = np.empty((3, 3)), np.empty((3, 3))
    for j in range(3):  # turned = R^T (information + prior), own = turned @ R
        x, y = information[0, j] + prior[0, j], information[1, j] + prior[1, j]
        turned[0, j], turned[1, j] = _fused(s, y, c * x), _fused(c, y, -s * x)
        turned[2, j] = information[2, j] + prior[2, j]
    for i in range(3):
        x, y = turned[i, 0], turned[i, 1]
        own[i, 0], own[i, 1], own[i, 2] = _fused(y, s, x * c), _fused(y, c, x * -s), turned[i, 2]
    invert3(own, out)
    for j in range(3):
        out[j, j] += STD_MIN[j] ** 2


def closure_covariance(information: Array, prior: Array, heading_rad: float) -> Array:
    """(3, 3) of a pose with this heading, along its own axes; information and prior (3, 3) along those of its frame."""
    out = np.empty((3, 3))
    _covariance(information, prior, heading_rad, out)
    return out
