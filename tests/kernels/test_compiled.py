"""Kernels: what they may import; borrowing and bound kernels."""

import copy
import pickle
import sys

import numpy as np
import pytest
from numba.core.errors import NumbaError

from twc_env.bench.rates import wander
from twc_env.exploration.environment import ExplorationEnv
from twc_env.kernels import compiled
from twc_env.kernels.compiled import Lent, borrowing_kernel, bound, kernel, parts_of, rebound
from twc_env.records import geometry


def test_a_kernel_must_import_names_not_modules_of_the_package():
    def reaching(x):
        return geometry.wrap_angle(x)

    with pytest.raises(TypeError, match=r"kernel reaching: import names from twc_env\.records\.geometry"):
        kernel(reaching)


def fill(out, value):
    for i in range(len(out)):
        out[i] = value


def filled(out, value):
    made = np.empty(len(out))
    for i in range(len(out)):
        made[i] = out[i] = value


def test_a_borrowing_kernel_fills_its_arguments_and_cannot_return_arrays():
    out = np.zeros(3)
    borrowing_kernel(fill)(out, 2.0)
    assert out.tolist() == [2.0, 2.0, 2.0]
    with pytest.raises(NumbaError, match="Only accept returning of array"):
        borrowing_kernel(filled)(out, 2.0)


def test_kernels_called_by_a_borrowing_kernel_may_allocate_arrays():
    inner = kernel(length_of_a_copy)
    outer = borrowing_kernel(lambda out: inner(out))
    assert outer(np.zeros(3)) == 3


def length_of_a_copy(values):
    return len(values.copy())


def test_no_step_leaks_arrays_in_compiled_code():
    from numba.core.runtime import _nrt_python, rtsys

    env = ExplorationEnv(map="gen:office:100:1", robots=2, max_cycles=600)
    stood = []
    _nrt_python.memsys_enable_stats()
    try:
        for _ in range(3):
            env.reset(seed=1)
            for actions in wander(env, 1):
                env.step(actions)
            stats = rtsys.get_allocation_stats()
            stood.append(stats.mi_alloc - stats.mi_free)
    finally:
        _nrt_python.memsys_disable_stats()
    assert len(set(stood[1:])) == 1  # the first episode also creates what is kept between episodes


def scaled_sum(held, shift, out):
    (numbers, factor), total = parts_of(held), 0.0
    for number in numbers:
        total += factor * number
    out[0] = total + shift


def test_a_bound_kernel_does_not_leak_references_to_lent_arrays():
    numbers, out = np.arange(4.0), np.zeros(1)
    holders = sys.getrefcount(numbers)
    call = bound(borrowing_kernel(scaled_sum), Lent((numbers, 2.0)), 1, out)
    for shift in (1, 5):
        call(shift, out)
        assert out[0] == 12.0 + shift
    numbers[0] = 10.0
    call(0, out)
    assert out[0] == 32.0
    call = rebound(call, Lent((np.ones(100), 3.0)))
    call(0, out)
    assert out[0] == 300.0
    assert sys.getrefcount(numbers) == holders


def seen_by_kernel(held, out):
    is_first, (is_second, whole, (broken, few)), matrix, empty, frozen, small, columns = parts_of(held)
    out[0], out[1], out[2], out[3] = is_first, is_second, whole, broken
    out[4] = few[0] + 10 * few[1] + 100 * few.shape[0]
    out[5] = matrix[1, 2] + 100 * matrix.shape[0] + 1000 * matrix.shape[1]
    out[6] = empty.shape[0] + 10 * empty.shape[1]
    out[7], out[8], out[9] = frozen[1], small, columns[1, 2]


def test_parts_of_all_types_are_laid_out_correctly():
    frozen, matrix, out = np.arange(3.0), np.arange(6, dtype=np.int32).reshape(2, 3), np.zeros(10)
    frozen.flags.writeable = False
    held = Lent(
        (
            True,
            (False, -7, (2.5, np.array([3, 4], np.uint8))),
            matrix,
            np.empty((0, 4)),
            frozen,
            np.float32(0.5),
            np.asfortranarray(matrix),
        )
    )
    borrowing_kernel(seen_by_kernel)(held, out)
    assert out.tolist() == [1.0, 0.0, -7.0, 2.5, 243.0, 3205.0, 40.0, 1.0, 0.5, 5.0]


def test_a_lent_cannot_be_copied():
    for copied in (copy.deepcopy, pickle.dumps):
        with pytest.raises(TypeError, match="make it anew"):
            copied(Lent((np.zeros(3),)))


def total_of(numbers, factor):
    total = 0.0
    for i in range(numbers.shape[0]):
        for k in range(numbers.shape[1]):
            total += factor * (1 + 2 * i + k) * numbers[i, k]
    return total


def test_a_rebound_kernel_uses_its_new_first_argument():
    numbers, summed = np.arange(6.0).reshape(2, 3), borrowing_kernel(total_of)
    read_only = numbers.view()
    read_only.flags.writeable = False
    kinds = (numbers, np.asfortranarray(numbers), numbers.astype(np.float32), np.repeat(numbers, 2, axis=1)[:, ::2])
    for held in (*kinds, read_only, *kinds):
        for factor in (2, 0.5):
            assert bound(summed, held, factor)(factor) == total_of(numbers, factor)
    assert len(summed.signatures) == 2 * (len(kinds) + 1)


@pytest.mark.parametrize("known", [True, False])
def test_kernels_work_with_a_numba_that_lacks_the_undocumented_options(monkeypatch, known):
    asked, real = [], compiled.njit

    def njit(**options):
        asked.append(set(options))
        if not known and "_nrt" in options:
            raise KeyError("Unrecognized options: {'_nrt'}")
        return real(**options)

    monkeypatch.setattr(compiled, "njit", njit)
    compiled._knows_own_options.cache_clear()
    out = np.zeros(3)
    compiled.borrowing_kernel(fill)(out, 2.0)
    compiled._knows_own_options.cache_clear()
    assert out.tolist() == [2.0, 2.0, 2.0]
    assert ("_nrt" in asked[-1]) == known and {"cache", "error_model"} <= asked[-1]


def test_a_kernel_whose_numba_returns_no_entry_point_is_called_as_usual():
    class Plain:
        """`compile` of a dispatcher is documented, what it returns is not."""

        def compile(self, _types):
            return None

        def __call__(self, numbers, factor):
            return total_of(numbers, factor)

    numbers = np.arange(6.0).reshape(2, 3)
    assert bound(Plain(), numbers, 2)(2) == total_of(numbers, 2)
