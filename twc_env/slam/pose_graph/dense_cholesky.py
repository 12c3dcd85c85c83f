"""Inverses of dense positive definite matrices.

LAPACK shares even small ones among threads, which wait for each other: on a machine that other programs keep busy an
inverse of 240 rows took a second instead of milliseconds. Sums here have one order, so results do not depend on the
number of threads or on the processor.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.kernels.compiled import kernel

ROWS_MAX = 300
"""Rows of matrices that one thread inverts; larger ones are left to LAPACK."""
PIVOT_MIN = 1e-300


def inverse_of(matrix: Array) -> Array:
    """The inverse of a symmetric positive definite matrix (n, n), which may be overwritten."""
    if len(matrix) <= ROWS_MAX:
        return _inverse(matrix)
    from scipy.linalg.lapack import dpotrf, dpotri  # imported here: a tenth of the start-up time, not needed there

    factor, _ = dpotrf(matrix.T, lower=0, overwrite_a=1)
    lower = np.tril(dpotri(factor, lower=0, overwrite_c=1)[0].T)
    return lower + np.tril(lower, -1).T


@kernel
def _inverse(matrix):
    """W^T W with W the inverse of the lower Cholesky factor; the lower triangle of `matrix` becomes the factor."""
    n = matrix.shape[0]
    column, lower, inverse = np.empty(n), np.zeros((n, n)), np.zeros((n, n))
    for k in range(n):
        pivot = math.sqrt(max(matrix[k, k], PIVOT_MIN))
        matrix[k, k] = pivot
        for i in range(k + 1, n):
            matrix[i, k] /= pivot
            column[i] = matrix[i, k]
        for i in range(k + 1, n):
            factor, row = column[i], matrix[i]
            for j in range(k + 1, i + 1):
                row[j] -= factor * column[j]
    for i in range(n):
        row = lower[i]
        for k in range(i):
            factor, above = matrix[i, k], lower[k]
            for j in range(k + 1):
                row[j] -= factor * above[j]
        scale = 1.0 / matrix[i, i]
        for j in range(i):
            row[j] *= scale
        row[i] = scale
    for i in range(n):
        row = lower[i]
        for k in range(i + 1):
            factor, own = row[k], inverse[k]
            for j in range(k + 1):
                own[j] += factor * row[j]
    for i in range(n):
        for j in range(i):
            inverse[j, i] = inverse[i, j]
    return inverse
