"""Inverses of dense positive definite matrices."""

import numpy as np
import pytest

from twc_env.slam.pose_graph.dense_cholesky import ROWS_MAX, inverse_of, solution_of


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
    inverse_of(positive_definite(ROWS_MAX))
    solution_of(positive_definite(ROWS_MAX), np.ones(ROWS_MAX))
    for call in (inverse_of, lambda matrix: solution_of(matrix, np.ones(len(matrix)))):
        with pytest.raises(TypeError):
            call(positive_definite(ROWS_MAX + 1))


@pytest.mark.parametrize("rows", [1, 3, 60, ROWS_MAX, ROWS_MAX + 1])
def test_solves_up_to_rounding_with_the_lower_triangle_alone(rows):
    matrix, right = positive_definite(rows), np.random.default_rng(1).normal(size=rows)
    found = solution_of(np.tril(matrix), right.copy())
    assert found is not None and np.abs(matrix @ found - right).max() < 1e-5


@pytest.mark.parametrize("rows", [3, ROWS_MAX + 1])
def test_a_matrix_that_is_not_positive_definite_has_no_solution(rows):
    matrix = positive_definite(rows)
    matrix[-1, -1] = -1.0
    assert solution_of(matrix, np.ones(rows)) is None


@pytest.mark.parametrize("rows", [3, ROWS_MAX + 1])
@pytest.mark.parametrize("place", [0, 1, -1])
def test_a_matrix_that_holds_a_nan_has_no_solution(rows, place):
    matrix = positive_definite(rows)
    matrix[place, place] = np.nan
    assert solution_of(matrix, np.ones(rows)) is None
