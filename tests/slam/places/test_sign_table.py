import math

import numpy as np
import pytest

from twc_env.slam.places.radio_fingerprint import mac_similarity, rssi_distance_db, rssi_similarity
from twc_env.slam.places.sign_table import RadioRule, SignTable

ROBOTS, PLACES, APART_M = 4, 90, 12.0


@pytest.fixture
def make(keyframe):
    """A keyframe of a random robot at a random travel, with readings of some of twelve transmitters, or none."""
    random = np.random.default_rng(4)

    def one():
        macs = np.flatnonzero(random.random(12) < random.choice([0.0, 0.5, 0.8]))
        return keyframe(
            int(random.integers(ROBOTS)), macs=macs, rssi_dbm=random.uniform(-90, -30, len(macs)),
            travel_m=float(random.uniform(0, 40)),
        )  # fmt: skip

    return one


@pytest.mark.parametrize(
    "radio",
    [
        RadioRule(-math.inf, -math.inf, 5.0),
        RadioRule(0.3, 0.0, 5.0),
        RadioRule(0.2, 0.3, 8.0),
        RadioRule(0.6, -math.inf, 5.0),
    ],
)
@pytest.mark.parametrize("skipped", [(), (1,), (0, 3, 7)])
@pytest.mark.parametrize("text_count", [5, 45])
def test_the_table_equals_a_pairwise_comparison(make, radio, skipped, text_count):
    places, texts = [make() for _ in range(PLACES)], np.arange(PLACES) % text_count
    random = np.random.default_rng(5)
    table = SignTable()
    for place, text in zip(places, texts.tolist(), strict=True):
        table.append(place, str(text), text)
    in_all = 0
    for _ in range(80):
        here = make()
        likeness = dict(zip(random.choice(text_count, 3, replace=False).tolist(), (0.9, 1.0, 0.0), strict=True))
        expected = []
        for k, place in enumerate(places):
            is_far = place.robot != here.robot or place.travel_m <= here.travel_m - APART_M
            macs = mac_similarity(place.fingerprint, here.fingerprint)
            strengths = rssi_distance_db(place.fingerprint, here.fingerprint)
            rssi = rssi_similarity(*strengths, radio.rssi_tolerance_db)
            is_alike = macs >= radio.mac_similarity_min and rssi >= radio.rssi_similarity_min
            if texts[k] in likeness and place.robot not in skipped and is_far and is_alike:
                expected.append([k, likeness[texts[k]], macs, rssi, *strengths])
        found = table.like(list(likeness.items()), here, skipped, APART_M, radio)
        assert len(found) == len(expected)
        assert np.array(found) == pytest.approx(np.array(expected), abs=1e-9)
        in_all += len(found)
    assert in_all > 18


def test_a_table_after_removing_rows_equals_one_without_them(make):
    places, random = [make() for _ in range(PLACES)], np.random.default_rng(6)
    texts, is_kept = random.integers(0, 9, PLACES), random.random(PLACES) < 0.4
    is_kept &= texts != 4
    number_of = np.array([0, 1, 2, 3, -1, 4, 5, 6, 7])
    table, fresh = SignTable(), SignTable()
    for k, (place, text) in enumerate(zip(places, texts.tolist(), strict=True)):
        table.append(place, f"text {text}", text)
        if is_kept[k]:
            fresh.append(place, f"text {text}", int(number_of[text]))
    table.keep(is_kept, number_of, {f"text {text}" for text in texts[is_kept].tolist()})
    for place, text in zip(places, texts.tolist(), strict=True):  # it can be filled again
        if text != 4:
            for one in (table, fresh):
                one.append(place, f"text {text}", int(number_of[text]))
    radio = RadioRule(0.2, -math.inf, 8.0)
    for _ in range(20):
        here = make()
        found = [one.like([(0, 1.0), (5, 0.9)], here, (), APART_M, radio) for one in (table, fresh)]
        assert found[0] == found[1]


def test_a_table_after_removing_all_rows_is_empty(make):
    table = SignTable()
    table.keep(np.zeros(0, bool), np.zeros(0, np.int64), ())
    table.append(make(), "EXIT", 0)
    table.keep(np.zeros(1, bool), np.array([-1]), ())
    assert table.like([], make(), (), APART_M, RadioRule(0.2, -math.inf, 8.0)) == []
