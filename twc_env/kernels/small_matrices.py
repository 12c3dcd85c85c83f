"""Inverses and quadratic forms of symmetric 3 x 3 matrices (covariances), without LAPACK."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.kernels.compiled import borrowing_kernel


@borrowing_kernel
def invert3(m, out):
    """Inverse of a symmetric 3 x 3 matrix by cofactors."""
    a, b, c, d, e, f = m[0, 0], m[0, 1], m[0, 2], m[1, 1], m[1, 2], m[2, 2]
    c00, c01, c02 = d * f - e * e, c * e - b * f, b * e - c * d
    det = a * c00 + b * c01 + c * c02
    out[0, 0], out[0, 1], out[0, 2] = c00 / det, c01 / det, c02 / det
    out[1, 1], out[1, 2], out[2, 2] = (a * f - c * c) / det, (b * c - a * e) / det, (a * d - b * b) / det
    out[1, 0], out[2, 0], out[2, 1] = out[0, 1], out[0, 2], out[1, 2]


def invert_symmetric(matrix: Array) -> Array:
    """Inverse of a symmetric (3, 3) matrix, without the overhead of LAPACK."""
    out = np.empty((3, 3))
    invert3(matrix, out)
    return out


@borrowing_kernel
def squared_error(error, covariance, inverse):
    """e^T C^-1 e of an error (3,) with its symmetric covariance (3, 3); writes the inverse to a third array."""
    invert3(covariance, inverse)
    total = 0.0
    for i in range(3):
        for j in range(3):
            total += error[i] * inverse[i, j] * error[j]
    return total
