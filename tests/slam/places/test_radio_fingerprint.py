import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from twc_env.records.messages import Fingerprint, WifiScan
from twc_env.slam.places.radio_fingerprint import fingerprint, mac_similarity, rssi_distance_db, rssi_similarity

MODES = ["population", "sample", "paper"]
levels = st.lists(st.integers(-90, -30), min_size=1, max_size=12)


def scans_of(*readings: dict[int, float]) -> list[WifiScan]:
    return [WifiScan(np.array(sorted(r), np.int64), np.array([r[m] for m in sorted(r)], float)) for r in readings]


def one_mac(values) -> list[WifiScan]:
    return scans_of(*({7: value} for value in values))


def place(*macs: int, rssi_dbm=None) -> Fingerprint:
    return Fingerprint(np.array(macs, np.int64), np.array(rssi_dbm if rssi_dbm is not None else [-60.0] * len(macs)))


def clipped_mean(values, divisor: float) -> float:
    """Equations 7 and 8 for one transmitter, without array functions."""
    mean = sum(values) / len(values)
    spread = (sum((v - mean) ** 2 for v in values) / divisor) ** 0.5
    kept = [v for v in values if abs(v - mean) <= spread + 1e-9]
    return sum(kept) / len(kept)


@given(levels)
def test_each_spread_gives_the_clipped_mean_of_equation_eight(values):
    divisors = {"population": len(values), "sample": max(len(values) - 1, 1), "paper": 1.0}
    for mode, divisor in divisors.items():
        found = fingerprint(one_mac(values), 0.0, mode)
        assert found.macs.tolist() == [7]
        assert found.rssi_dbm[0] == pytest.approx(clipped_mean(values, divisor), abs=1e-9)


def test_the_repaired_spread_rejects_an_outlier():
    values = [-60, -60, -61, -59, -60, -90]
    assert fingerprint(one_mac(values), 0.0, "population").rssi_dbm[0] == pytest.approx(-60.0)
    assert fingerprint(one_mac(values), 0.0, "paper").rssi_dbm[0] == pytest.approx(-65.0)


def test_repeated_readings_that_are_too_old_are_ignored():
    scan = WifiScan(np.array([3, 7, 9]), np.array([-50.0, -60.0, -70.0]), np.array([0.0, 4.0, 4.5]))
    assert fingerprint([scan], 0.4, age_max_s=4.0).macs.tolist() == [3, 7]
    assert fingerprint([scan], 0.4).macs.tolist() == [3, 7, 9]
    # A new reading in one of two scans and a repeated one in the other: heard in half of the scans.
    fresh = WifiScan(np.array([9]), np.array([-72.0]), np.array([0.0]))
    assert fingerprint([scan, fresh], 0.5, age_max_s=4.0).rssi_dbm.tolist()[-1] == -72.0


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("values", [(-60, -61), (-33, -90), (-70.1, -70.2)])
def test_two_readings_tie_with_their_spread_and_both_count(mode, values):
    assert fingerprint(one_mac(values), 0.0, mode).rssi_dbm[0] == pytest.approx(np.mean(values), abs=1e-9)


def test_a_transmitter_heard_too_rarely_is_not_in_the_fingerprint():
    heard = scans_of({1: -50.0, 2: -80.0}, {1: -50.0}, {1: -50.0}, {1: -50.0, 3: -85.0}, {1: -50.0, 3: -85.0})
    assert fingerprint(heard, 0.4).macs.tolist() == [1, 3]
    assert fingerprint(heard, 0.2).macs.tolist() == [1, 2, 3]


def test_empty_scans_count_as_not_heard():
    heard = scans_of({5: -70.0}, {}, {}, {})
    assert fingerprint(heard, 0.4).macs.tolist() == []
    assert fingerprint(heard, 0.25).macs.tolist() == [5]


@pytest.mark.parametrize("scans", [[], scans_of({}), scans_of({}, {})])
def test_no_readings_give_an_empty_fingerprint(scans):
    found = fingerprint(scans, 0.4)
    assert (len(found.macs), len(found.rssi_dbm)) == (0, 0)


def test_mac_similarity_is_the_shared_part_of_the_larger_set():
    assert mac_similarity(place(1, 2, 3, 4, 5), place(2, 3, 4, 9)) == pytest.approx(3 / 5)
    assert mac_similarity(place(1, 2), place(1, 2)) == 1.0
    for nothing_shared in ((place(1, 2), place(3, 4)), (place(), place()), (place(1), place()), (place(), place(1))):
        assert mac_similarity(*nothing_shared) == 0.0


def test_rssi_distance_sums_squares_over_shared_transmitters_only():
    a = place(1, 2, 3, rssi_dbm=[-50.0, -60.0, -70.0])
    b = place(2, 3, 9, rssi_dbm=[-63.0, -66.0, -10.0])
    assert rssi_distance_db(a, b) == (pytest.approx(5.0), 2)
    assert rssi_distance_db(a, place(8)) == (0.0, 0)
    assert rssi_distance_db(a, place()) == (0.0, 0)


def test_rssi_similarity_is_one_up_to_the_tolerance_and_falls_beyond():
    shared = 9
    for rms, expected in [(0.0, 1.0), (4.99, 1.0), (5.0, 1.0), (6.25, 0.8), (10.0, 0.5)]:
        assert rssi_similarity(rms * shared**0.5, shared, 5.0) == pytest.approx(expected, abs=1e-12)
    assert rssi_similarity(5.0 * shared**0.5, shared, 5.0) == 1.0
    assert rssi_similarity(0.0, 0, 5.0) == 0.0, "nothing shared"


@given(
    st.dictionaries(st.integers(1, 9), st.integers(-90, -30), max_size=9),
    st.dictionaries(st.integers(1, 9), st.integers(-90, -30), max_size=9),
)
def test_both_similarities_are_symmetric_and_lie_between_zero_and_one(first, second):
    a, b = (place(*sorted(d), rssi_dbm=[float(d[m]) for m in sorted(d)]) for d in (first, second))
    assert mac_similarity(a, b) == mac_similarity(b, a)
    assert 0.0 <= mac_similarity(a, b) <= 1.0
    assert rssi_distance_db(a, b) == rssi_distance_db(b, a)
    assert 0.0 <= rssi_similarity(*rssi_distance_db(a, b), 5.0) <= 1.0
