import tracemalloc

import numpy as np
import pytest
from threadpoolctl import threadpool_limits

from twc_env.errors import ConfigError, DataError
from twc_env.records.messages import Fingerprint
from twc_env.slam.radio.radio_map import GaussianProcessMap, RadioMap

BOXES = np.random.default_rng(0).uniform(0, 30, (25, 2))


def heard_at(place, seed: int) -> Fingerprint:
    level = -40 - 25 * np.log10(np.maximum(np.linalg.norm(BOXES - place, axis=1), 1.0))
    level = level + 2.0 * np.random.default_rng(seed).normal(size=len(BOXES))
    return Fingerprint(np.flatnonzero(level > -85).astype(np.int64), level[level > -85])


def surveyed() -> RadioMap:
    places = np.stack(np.meshgrid(np.arange(0, 31, 3.0), np.arange(0, 31, 3.0)), axis=-1).reshape(-1, 2)
    return RadioMap(places, [heard_at(p, k) for k, p in enumerate(places)])


def test_both_methods_locate_new_fingerprints_and_the_gaussian_process_is_better():
    radio_map = surveyed()
    process = GaussianProcessMap(radio_map)
    random = np.random.default_rng(1)
    places = random.uniform(3, 27, (30, 2))
    scans = [heard_at(p, 1000 + k) for k, p in enumerate(places)]
    nearest = np.mean([np.linalg.norm(radio_map.nearest(s) - p) for s, p in zip(scans, places, strict=True)])
    gaussian = np.mean([np.linalg.norm(process.locate(s)[0] - p) for s, p in zip(scans, places, strict=True)])
    assert gaussian < nearest < 3.0


def test_the_gaussian_process_matches_a_manual_computation():
    """Two places and one transmitter: mean and variance at candidate positions, and the estimate from a reading."""
    places, levels = np.array([[0.0, 0.0], [8.0, 0.0]]), np.array([-50.0, -70.0])
    radio_map = RadioMap(places, [Fingerprint(np.array([1]), levels[k : k + 1]) for k in range(2)])
    found, spread = GaussianProcessMap(radio_map, 6.0, 8.0, 4.0).locate(Fingerprint(np.array([1]), np.array([-54.0])))
    lattice = 0.5 * np.array([(x, y) for y in (-1, 0, 1) for x in (-1, 0, 1)])
    tried = np.concatenate([place + lattice for place in places])
    alike = [
        64 * np.exp(-0.5 * ((a[:, None] - b) ** 2).sum(axis=2) / 36) for a, b in ((places, places), (tried, places))
    ]
    gain = alike[1] @ np.linalg.inv(alike[0] + 16 * np.eye(2))
    mean, variance = -60 + gain @ (levels + 60), 64 - (gain * alike[1]).sum(axis=1) + 16
    weight = np.exp(-0.5 * (-54 - mean) ** 2 / variance) / np.sqrt(variance)
    weight /= weight.sum()
    away = tried - weight @ tried
    assert found == pytest.approx(weight @ tried)
    assert spread == pytest.approx(away.T @ (away * weight[:, None]))


def test_places_do_not_depend_on_the_threads_of_matrix_libraries():
    places = np.random.default_rng(0).uniform(0, 30, (300, 2))
    radio_map, found = RadioMap(places, [heard_at(p, k) for k, p in enumerate(places)]), []
    for count in (1, 2):
        with threadpool_limits(count, user_api="blas"):
            found.append(GaussianProcessMap(radio_map).locate(heard_at(places[0], 0))[1].tobytes())
    assert found[0] == found[1]


def test_memory_is_bounded_by_processing_places_in_batches():
    places = np.random.default_rng(0).uniform(0, 30, (700, 2))
    radio_map = RadioMap(places, [heard_at(p, k) for k, p in enumerate(places)])
    tracemalloc.start()
    try:
        GaussianProcessMap(radio_map)
        held_bytes = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert held_bytes < 9 * 700 * 700 * 8 / 2  # a matrix of all candidates and places has 9 x 700 x 700 numbers


def test_an_empty_fingerprint_has_no_preferred_position():
    radio_map = surveyed()
    assert radio_map.nearest(Fingerprint(np.zeros(0, np.int64), np.zeros(0))) == pytest.approx([15.0, 15.0])


@pytest.mark.parametrize("macs", [[], [999]])
def test_the_gaussian_process_is_not_sure_of_a_place_where_none_of_its_transmitters_was_heard(macs):
    places = np.random.default_rng(0).uniform(0.0, 30.0, (60, 2))
    process = GaussianProcessMap(RadioMap(places, [heard_at(place, k) for k, place in enumerate(places)]))
    found, spread = process.locate(Fingerprint(np.array(macs, np.int64), np.full(len(macs), -50.0)))
    assert found == pytest.approx(places.mean(axis=0))
    assert np.sqrt(np.diag(spread)) == pytest.approx(places.std(axis=0), abs=0.1)


def test_a_map_needs_a_position_for_each_fingerprint():
    with pytest.raises(ValueError, match="one position"):
        RadioMap(np.zeros((2, 2)), [heard_at((0, 0), 0)])


@pytest.mark.parametrize(
    ("fingerprint", "message"),
    [
        (None, "is None: give an empty Fingerprint"),
        (Fingerprint(np.array([1, 2]), np.array([-40.0])), r"addresses of shape \(2,\) and strengths of \(1,\)"),
        (Fingerprint(np.array([2, 1]), np.array([-40.0, -50.0])), "do not ascend"),
        (Fingerprint(np.array([2, 1], np.uint64), np.array([-40.0, -50.0])), "do not ascend"),
        (Fingerprint(np.array([1.5]), np.array([-40.0])), "whole numbers"),
        (Fingerprint(np.array([1]), np.array([np.nan])), "not finite"),
        (Fingerprint(np.array([1]), ["loud"]), "must hold numbers"),
    ],
)
def test_impossible_readings_are_rejected(fingerprint, message):
    radio_map = RadioMap(np.zeros((1, 2)), [heard_at((0, 0), 0)])
    process = GaussianProcessMap(radio_map)
    for call in (
        lambda: RadioMap(np.zeros((1, 2)), [fingerprint]),
        lambda: radio_map.nearest(fingerprint),
        lambda: process.locate(fingerprint),
    ):
        with pytest.raises(DataError, match=message):
            call()


def test_lists_of_fingerprints_are_accepted():
    scan = heard_at((3, 3), 0)
    listed = Fingerprint(scan.macs.tolist(), scan.rssi_dbm.tolist())
    assert np.array_equal(RadioMap([[1, 2]], [listed]).nearest(listed), [1.0, 2.0])


def test_invalid_sizes_of_a_radio_map_are_rejected():
    radio_map = surveyed()
    with pytest.raises(DataError, match="neighbours must be 1 or more"):
        radio_map.nearest(heard_at((0, 0), 0), 0)
    with pytest.raises(DataError, match="must be finite and above 0"):
        GaussianProcessMap(radio_map, length_m=0.0)
    with pytest.raises(DataError, match="must be finite and above 0"):
        GaussianProcessMap(radio_map, noise_std_db=np.nan)
    twice = RadioMap(np.zeros((30, 2)), [heard_at((0, 0), k) for k in range(30)])
    with pytest.raises(DataError, match="noise_std_db 1e-09 is too small"):
        GaussianProcessMap(twice, noise_std_db=1e-9)
    with pytest.raises(ConfigError, match="similarity mode"):
        RadioMap(np.zeros((1, 2)), [heard_at((0, 0), 0)], "loud")
