import numpy as np
import pytest
from scipy.sparse import csr_array

from twc_env.records.messages import Fingerprint
from twc_env.slam.radio.radio_similarity import (
    CELL_ID_MIN,
    FingerprintStore,
    all_similarities,
    averaged,
    feature_rows,
    split_cues,
)


def heard(levels: dict[int, float]) -> Fingerprint:
    macs = np.array(sorted(levels), np.int64)
    return Fingerprint(macs, np.array([levels[m] for m in macs.tolist()], float))


def cosine(a: Fingerprint, b: Fingerprint, mode: str = "shifted") -> float:
    return float(all_similarities(feature_rows([a, b], mode))[0, 1])


def crowd(count: int = 60, seed: int = 0) -> list[Fingerprint]:
    random = np.random.default_rng(seed)
    return [
        heard({int(m): float(random.integers(-90, -40)) for m in random.choice(80, random.integers(0, 30), False)})
        for _ in range(count)
    ]


@pytest.mark.parametrize("mode", ["shifted", "raw", "linear"])
def test_the_cosine_is_one_for_itself_symmetric_and_zero_without_a_common_transmitter(mode):
    a, b = heard({1: -50, 2: -70, 3: -60}), heard({2: -65, 4: -40})
    assert cosine(a, a, mode) == pytest.approx(1.0, abs=1e-6)
    assert cosine(a, b, mode) == pytest.approx(cosine(b, a, mode))
    assert cosine(a, heard({7: -50}), mode) == 0.0
    assert cosine(a, heard({}), mode) == 0.0


def test_equation_two_matches_a_manual_computation():
    a, b = heard({1: -50, 2: -70}), heard({1: -40, 3: -60})
    assert cosine(a, b) == pytest.approx(50 * 60 / np.hypot(50, 30) / np.hypot(60, 40), rel=1e-6)
    assert cosine(a, b, "raw") == pytest.approx(50 * 40 / np.hypot(50, 70) / np.hypot(40, 60), rel=1e-6)
    assert cosine(a, b, "linear") == pytest.approx(1 / np.hypot(1, 0.1) / np.hypot(1, 0.1), rel=1e-6)


def test_features_are_averaged_along_the_path_with_weights_that_vanish_at_the_reach():
    rows = csr_array(np.array([[8.0, 0.0], [4.0, 2.0], [0.0, 6.0], [0.0, 9.0]]))
    travel_m = np.array([0.0, 1.0, 3.0, 7.0])
    near = averaged(rows, travel_m, 4.0, np.array([1, 3])).toarray()
    assert near[0] == pytest.approx((0.75 * rows[[0]] + rows[[1]] + 0.5 * rows[[2]]).toarray()[0] / 2.25)
    assert near[1] == pytest.approx([0.0, 9.0])
    assert np.array_equal(averaged(rows, travel_m, 0.0, np.array([2])).toarray(), [[0.0, 6.0]])


def test_all_pairs_and_the_store_agree_with_a_dense_product():
    prints = crowd()
    rows = feature_rows(prints).toarray()
    unit = rows / np.maximum(np.linalg.norm(rows, axis=1, keepdims=True), 1e-12)
    expected = unit @ unit.T
    found = all_similarities(feature_rows(prints))
    assert found == pytest.approx(expected, abs=1e-5)
    store = FingerprintStore()
    for k, one in enumerate(prints):
        assert store.similarities(one) == pytest.approx(expected[k, :k], abs=1e-5)
        assert store.add(one) == k
    best, similarity = store.nearest(prints[7], 5)
    assert best[0] == 7 and similarity[0] == pytest.approx(1.0, abs=1e-5)
    assert similarity == pytest.approx(np.sort(expected[7])[::-1][:5], abs=1e-5)


def test_the_most_similar_rows_do_not_depend_on_the_number_requested():
    store = FingerprintStore()
    for k in range(60):
        store.add(heard({1: -50} if k % 3 else {1: -50, 2: -60}))
    best, similarity = store.nearest(heard({1: -50}), 60)
    for count in range(60):
        fewer, their_similarity = store.nearest(heard({1: -50}), count)
        assert fewer.tolist() == best[:count].tolist() and their_similarity.tolist() == similarity[:count].tolist()


def test_an_unknown_transmitter_lowers_the_similarity():
    store = FingerprintStore()
    store.add(heard({1: -50}))
    assert store.similarities(heard({1: -50, 2: -50}))[0] == pytest.approx(np.sqrt(0.5), abs=1e-6)


def test_wifi_and_lte_are_distinguished_by_their_ids():
    cues = split_cues(heard({5: -60, CELL_ID_MIN + 1: -100}))
    assert cues["wifi"].macs.tolist() == [5] and cues["lte"].macs.tolist() == [CELL_ID_MIN + 1]
    assert feature_rows([cues["lte"]]).toarray().tolist() == [[20.0]]


def test_the_order_of_a_rows_columns_does_not_matter():
    rows = csr_array(([1.0, 5.0, 2.0, 3.0], [2, 0, 0, 1], [0, 2, 4]), shape=(2, 3))
    expected = 10.0 / np.sqrt(26.0 * 13.0)
    assert all_similarities(rows)[0, 1] == pytest.approx(expected, rel=1e-6)
