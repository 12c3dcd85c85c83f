"""Inverses of dense positive definite matrices."""

import numpy as np
import pytest

from twc_env.slam.pose_graph import dense_cholesky
from twc_env.slam.pose_graph.dense_cholesky import ROWS_MAX, inverse_of


def positive_definite(rows: int) -> np.ndarray:
    """A matrix with eigenvalues from 1e-1 to 1e8, as those of key poses have."""
    turns = np.linalg.qr(np.random.default_rng(rows).normal(size=(rows, rows)))[0]
    return turns * np.geomspace(1e-1, 1e8, rows) @ turns.T


@pytest.mark.parametrize("rows", [1, 2, 3, 60, ROWS_MAX, ROWS_MAX + 1])
def test_inverts_up_to_rounding(rows):
    matrix = positive_definite(rows)
    found = inverse_of(matrix.copy())
    assert np.array_equal(found, found.T)
    assert np.abs(found @ matrix - np.eye(rows)).max() < 1e-5


def test_small_matrices_are_left_to_no_library(monkeypatch):
    """LAPACK adds in another order with other numbers of threads."""
    import scipy.linalg.lapack

    monkeypatch.setattr(scipy.linalg.lapack, "dpotrf", None)
    inverse_of(positive_definite(dense_cholesky.ROWS_MAX))
    with pytest.raises(TypeError):
        inverse_of(positive_definite(ROWS_MAX + 1))
