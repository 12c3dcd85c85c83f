"""Covariance of a loop closure, from the information of its scan match and a prior from its candidate."""

from __future__ import annotations

import math

import numpy as np
from numba import types
from numba.extending import intrinsic
from numpy.typing import NDArray as Array

from twc_env.kernels.compiled import borrowing_kernel
from twc_env.kernels.small_matrices import invert3
from twc_env.records.messages import LOOSE_M

STD_MIN = np.array((0.03, 0.03, 0.01))
"""Least standard deviation of a match [m, m, rad]."""


@intrinsic
def _fused(_context, a, b, c):
    """Fused multiply-add a b + c with a single rounding, as in BLAS matrix products."""

    def generate(_target, builder, _signature, arguments):
        return builder.fma(*arguments)

    return types.float64(types.float64, types.float64, types.float64), generate


@borrowing_kernel
def _fill(information, prior, heading, room, out):
    c, s = math.cos(heading), math.sin(heading)
    turned, own = room[0], room[1]
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


@borrowing_kernel
def fill_closure_covariance(information, priors, heading, room, out):
    """Write `closure_covariance` to out (3, 3); room (2, 3, 3) is scratch memory."""
    _fill(information, priors[0], heading, room, out)
    if out[0, 0] + out[1, 1] > LOOSE_M**2:
        _fill(information, priors[1], heading, room, out)


def closure_covariance(information: Array, priors: Array, heading_rad: float) -> Array:
    """(3, 3) covariance of a measured pose with this heading, in its own axes.

    information (3, 3) of the match and priors (2, 3, 3) are in the axes of the reference frame. The second prior is
    used if the closure would be loose with the first.
    """
    out = np.empty((3, 3))
    fill_closure_covariance(information, priors, heading_rad, np.empty((2, 3, 3)), out)
    return out
