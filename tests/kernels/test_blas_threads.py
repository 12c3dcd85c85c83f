import numpy as np
import pytest
import scipy.linalg.lapack  # noqa: F401  its library has threads of its own
from threadpoolctl import threadpool_info, threadpool_limits

from twc_env.kernels.blas_threads import one_blas_thread


def threads() -> set[int]:
    return {library["num_threads"] for library in threadpool_info() if library["user_api"] == "blas"}


@pytest.fixture
def two_threads():
    with threadpool_limits(2, user_api="blas"):
        if threads() != {2}:
            pytest.skip("these matrix libraries have one thread")
        yield


def test_all_libraries_have_one_thread_inside_and_their_own_number_after_an_error(two_threads):
    with pytest.raises(ZeroDivisionError), one_blas_thread():
        inside = threads()
        _ = 1 / 0
    assert inside == {1} and threads() == {2}


def test_decorated_functions_may_call_each_other(two_threads):
    @one_blas_thread()
    def inner():
        return threads()

    @one_blas_thread()
    def outer():
        return inner() | threads()

    assert outer() == {1} and threads() == {2}


@one_blas_thread()
def product(a):
    return a @ a


def test_results_are_those_of_one_thread(two_threads):
    a = np.random.default_rng(0).normal(size=(300, 300))
    with threadpool_limits(1, user_api="blas"):
        expected = a @ a
    assert product(a).tobytes() == expected.tobytes()
