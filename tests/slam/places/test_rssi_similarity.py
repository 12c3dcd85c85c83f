import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from twc_env.config import PlaceRecognitionConfig
from twc_env.records.messages import Fingerprint
from twc_env.slam.places.place_cues import similarities
from twc_env.slam.places.radio_fingerprint import rssi_distance_db, rssi_similarity
from twc_env.slam.places.rssi_similarity import BY_DISTANCE, COSINES, by_cosine, by_distance

MACS = np.arange(4)
FIRST, SECOND = np.array([-40.0, -50.0, -60.0, -70.0]), np.array([-44.0, -47.0, -62.0, -75.0])
D = math.sqrt(16 + 9 + 4 + 25)
RMS = D / 2
EXPECTED = {
    "saturating": min(1, 5 / RMS),
    "linear": 1.0,
    "saturating-sum": 1.0,
    "inverse": 1 / (1 + D),
    "inverse-rms": 1 / (1 + RMS),
    "exponential": math.exp(-D / 10),
    "range": 1 - RMS / 30,
    "paper": D,
}


def fingerprints(second=SECOND):
    return Fingerprint(MACS, FIRST), Fingerprint(MACS, np.asarray(second, float))


@pytest.mark.parametrize("mode", EXPECTED)
def test_each_variant_equals_its_formula(mode, keyframe):
    rule = PlaceRecognitionConfig(rssi_mode=mode)
    a, b = (replace(keyframe(robot), fingerprint=f) for robot, f in enumerate(fingerprints()))
    assert similarities(a, b, rule).rssi == pytest.approx(EXPECTED[mode])


@pytest.mark.parametrize("mode", BY_DISTANCE)
@given(st.floats(0, 200), st.floats(0, 200), st.integers(1, 40))
def test_similarity_never_increases_with_distance(mode, one, other, shared):
    low, high = by_distance(mode, np.array(sorted([one, other])), np.array([shared, shared]), 5.0)
    assert 1.0 >= low >= high >= 0.0
    assert by_distance(mode, np.array([3.0]), np.array([0]), 5.0)[0] == 0.0


def test_the_default_is_that_of_the_engine():
    distance, shared = rssi_distance_db(*fingerprints([-60, -40, -75, -90]))
    assert by_distance("saturating", distance, shared, 5.0) == pytest.approx(rssi_similarity(distance, shared, 5.0))


@pytest.mark.parametrize("mode", COSINES)
def test_the_cosine_is_one_for_equal_fingerprints_and_zero_without_a_shared_transmitter(mode):
    a, b = fingerprints(FIRST)
    assert by_cosine(mode, a, b) == pytest.approx(1.0)
    assert by_cosine(mode, a, Fingerprint(MACS + 10, SECOND)) == 0.0
    assert by_cosine(mode, a, Fingerprint(MACS[:0], SECOND[:0])) == 0.0


def test_the_shifted_cosine_is_that_of_the_levels_above_minus_hundred():
    a, b = fingerprints()
    x, y = FIRST + 100, SECOND + 100
    exact = x @ y / np.linalg.norm(x) / np.linalg.norm(y)
    assert by_cosine("cosine", a, b) == pytest.approx(exact)
    assert by_cosine("cosine-rounded", a, b) == round(exact, 2)
