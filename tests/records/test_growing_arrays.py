import copy
import pickle
import tracemalloc

import numpy as np

from twc_env.records.growing_arrays import LARGE, grown, lazy_zeros


def test_room_that_is_not_written_to_is_none_of_the_allocators_memory():
    tracemalloc.start()
    try:
        rooms = [lazy_zeros((LARGE, 3), np.float32), grown(np.ones((LARGE, 2)))[LARGE:]]
        assert tracemalloc.get_traced_memory()[0] < LARGE
    finally:
        tracemalloc.stop()
    assert not any(room.any() for room in rooms)


def test_lazy_zeros_are_arrays_like_others():
    for shape in ((3, 2), (LARGE, 2)):
        zeros = lazy_zeros(shape, np.int32)
        assert zeros.shape == shape and zeros.dtype == np.int32 and zeros.flags.c_contiguous and not zeros.any()
        zeros[-1] = 1, 2
        for other in (copy.deepcopy(zeros), pickle.loads(pickle.dumps(zeros))):
            other[0] = 3
            assert zeros[0].tolist() == [0, 0] and other[-1].tolist() == [1, 2]


def test_a_grown_array_keeps_its_rows():
    rows = np.arange(2 * LARGE).reshape(-1, 2)
    assert np.array_equal(grown(rows), np.concatenate([rows, np.zeros_like(rows)]))
