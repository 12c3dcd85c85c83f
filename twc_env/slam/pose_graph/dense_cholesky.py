"""Inverses of dense positive definite matrices, and solutions of their equations.

LAPACK shares even small ones among threads, which wait for each other: on a machine that other programs keep busy a
step may stall. So it gets one thread, too, and sums have one order: results do not depend on the number of cores.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.kernels.blas_threads import one_blas_thread
from twc_env.kernels.compiled import kernel

ROWS_MAX = 400
"""Rows of matrices that are factorised here; larger ones are left to LAPACK."""
PIVOT_MIN = 1e-300


def inverse_of(matrix: Array) -> Array:
    """The inverse of a symmetric positive definite matrix (n, n), which may be overwritten."""
    if len(matrix) <= ROWS_MAX:
        return _inverse(matrix)
    from scipy.linalg.lapack import dpotrf, dpotri  # imported here: a tenth of the start-up time, not needed there

    with one_blas_thread():
        factor, _ = dpotrf(matrix.T, lower=0, overwrite_a=1)
        lower = np.tril(dpotri(factor, lower=0, overwrite_c=1)[0].T)
    return lower + np.tril(lower, -1).T


def solution_of(matrix: Array, right: Array) -> Array | None:
    """x (n,) with matrix @ x = right (n,); None if the matrix is not positive definite, or holds a NaN.

    Of the symmetric matrix (n, n) the lower triangle counts. Both may be overwritten.
    """
    if len(matrix) <= ROWS_MAX:
        return right if _solve(matrix, right) else None
    from scipy.linalg.lapack import dpotrf, dpotrs  # imported late: takes a tenth of the start-up time

    with one_blas_thread():
        factor, failed = dpotrf(np.asfortranarray(matrix), lower=1, overwrite_a=1)
        if failed or np.isnan(factor.diagonal()).any():  # LAPACK's libraries differ in whether they look for NaN
            return None
        found: Array = dpotrs(factor, right[:, None], lower=1)[0][:, 0]
    return found


@kernel
def _factorise(matrix):
    """Replace the lower triangle by the Cholesky factor, whose negative pivots are raised; returns the least pivot
    before that, or NaN if there is one."""
    n, least = matrix.shape[0], np.inf
    column = np.empty(n)
    for k in range(n):
        if not matrix[k, k] >= least:
            least = matrix[k, k]
        pivot = math.sqrt(max(matrix[k, k], PIVOT_MIN))
        matrix[k, k] = pivot
        for i in range(k + 1, n):
            matrix[i, k] /= pivot
            column[i] = matrix[i, k]
        for i in range(k + 1, n):
            factor, row = column[i], matrix[i]
            for j in range(k + 1, i + 1):
                row[j] -= factor * column[j]
    return least


@kernel
def _solve(matrix, right):
    """Replace right (n,) by the solution; False if the matrix is not positive definite."""
    if not _factorise(matrix) > 0.0:
        return False
    n = matrix.shape[0]
    for i in range(n):
        total = right[i]
        for j in range(i):
            total -= matrix[i, j] * right[j]
        right[i] = total / matrix[i, i]
    for i in range(n - 1, -1, -1):
        right[i] /= matrix[i, i]
        for j in range(i):
            right[j] -= matrix[i, j] * right[i]
    return True


@kernel
def _inverse(matrix):
    """W^T W with W the inverse of the lower Cholesky factor."""
    _factorise(matrix)
    n = matrix.shape[0]
    lower, inverse = np.zeros((n, n)), np.zeros((n, n))
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
