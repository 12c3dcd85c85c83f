import math

import numpy as np
import pytest

from twc_env.records.geometry import between, inverse
from twc_env.slam.places.scan_descriptor import SECTORS, compare, describe, ring_key, scan_agreement

RANGE_MAX_M = 10.0


@pytest.mark.parametrize("sectors", [0, 7, 25, -20])
def test_a_rotated_scan_matches_and_gives_the_rotation(scan, office, sectors):
    turn = sectors * 2 * math.pi / SECTORS
    here, turned = (describe(scan(office, (0.3, 0.1, heading)), RANGE_MAX_M) for heading in (0.0, turn))
    similarity, found = compare(here, turned)
    assert similarity > 0.9
    assert math.remainder(found - turn, 2 * math.pi) == pytest.approx(0.0, abs=2 * math.pi / SECTORS)


@pytest.mark.parametrize("beams", [8, 24, 36, 50])
def test_a_scan_of_few_beams_that_turned_by_some_beams_is_the_same(beams):
    ranges = np.random.default_rng(beams).uniform(1.0, 9.0, beams)
    for turned in range(beams):
        similarity, found = compare(*(describe(r, RANGE_MAX_M) for r in (ranges, np.roll(ranges, -turned))))
        assert similarity == pytest.approx(1.0)
        assert math.remainder(found - turned * 2 * math.pi / beams, 2 * math.pi) == pytest.approx(0.0, abs=1e-9)


def test_a_scan_is_more_similar_to_itself_than_to_another_room(scan, office, hall):
    here, there = (describe(scan(walls, (0.0, 0.0, 0.0)), RANGE_MAX_M) for walls in (office, hall))
    assert compare(here, here) == (pytest.approx(1.0), 0.0)
    assert compare(here, there)[0] < 0.75


def test_the_search_key_is_invariant_to_rotations_only(scan, office, hall):
    keys = [
        ring_key(describe(scan(walls, (0.2, 0.0, heading)), RANGE_MAX_M))
        for walls, heading in ((office, 0.0), (office, 12 * 2 * math.pi / SECTORS), (hall, 0.0))
    ]
    assert np.abs(keys[0] - keys[1]).max() < 0.02
    assert np.abs(keys[0] - keys[2]).max() > 0.1


def test_open_beams_and_teammates_are_ignored():
    ranges = np.full(180, RANGE_MAX_M)
    ranges[::2] = -2.0
    assert not describe(ranges, RANGE_MAX_M).any()
    assert compare(describe(ranges, RANGE_MAX_M), describe(ranges, RANGE_MAX_M)) == (0.0, 0.0)


def test_scans_of_one_room_agree_at_the_true_pose_and_contradict_at_a_wrong_one(scan, office):
    first, second = np.array([0.0, -0.5, 0.2]), np.array([1.2, 0.3, -1.0])
    a, b = scan(office, first), scan(office, second)
    met, through = scan_agreement(a, b, between(first, second), RANGE_MAX_M)
    assert met > 0.9 and through < 0.05
    wrong = between(first, second) + [1.0, 0.0, 0.0]
    wrongly = scan_agreement(a, b, wrong, RANGE_MAX_M)
    assert wrongly[0] < met - 0.2
    assert scan_agreement(b, a, inverse(wrong), RANGE_MAX_M) == pytest.approx(wrongly)


def test_scans_without_a_common_wall_decide_nothing():
    nothing = np.full(90, RANGE_MAX_M)
    assert scan_agreement(nothing, nothing, np.zeros(3), RANGE_MAX_M) == (0.0, 0.0)
