"""Common behaviour of all recognisers, and their differences."""

import math
from dataclasses import replace

import numpy as np
import pytest

from twc_env.config import PlaceRecognitionConfig, override
from twc_env.records.messages import Fingerprint, SignObservation
from twc_env.slam.engine import CooperativeSlam
from twc_env.slam.places.place_recognition import make_recogniser
from twc_env.slam.places.signless_recognisers import SignlessRecogniser, least

NAMES = ("twc", "text", "wifi", "lidar", "fused")
MACS = (1, 2, 3, 4, 5)
LEVELS_DBM = np.array([-40.0, -50.0, -60.0, -70.0, -80.0])
RANGE_MAX_M = 10.0


def make(name, **rule):
    return make_recogniser(PlaceRecognitionConfig(recogniser=name, **rule), RANGE_MAX_M)


@pytest.fixture
def place(keyframe, scan, office):
    def build(robot, index=0, heading=0.0, text="A301 OPTICS LAB", rssi_dbm=LEVELS_DBM, walls=office, travel_m=0.0):
        c, s = math.cos(-heading), math.sin(-heading)
        signs = [SignObservation(text, np.array([2 * c, 2 * s]), math.pi - heading)] if text else []
        ranges = scan(walls, (0.0, 0.0, heading))
        return keyframe(robot, index, (0, 0, heading), travel_m, ranges, signs, MACS, rssi_dbm)

    return build


@pytest.mark.parametrize("name", NAMES)
def test_two_robots_at_one_place_give_a_candidate_with_their_relative_heading(place, name):
    recogniser = make(name)
    assert recogniser.name == name
    assert recogniser.propose(place(0)) == []
    (found,) = recogniser.propose(place(1, heading=0.6))
    assert (found.target, found.source, found.recogniser) == ((0, 0), (1, 0), name)
    assert found.guess == pytest.approx([0.0, 0.0, 0.6], abs=0.11)


@pytest.mark.parametrize("name", NAMES)
def test_skipped_robots_give_no_candidate_but_are_stored(place, name):
    recogniser = make(name)
    recogniser.propose(place(0))
    assert recogniser.propose(place(1), skipped_robots=(0,)) == []
    assert {c.target[0] for c in recogniser.propose(place(2))} == {0, 1}


@pytest.mark.parametrize("name", NAMES)
def test_a_robot_revisits_its_own_places_only_after_enough_travel(place, name):
    for travel_m, met in ((11.9, []), (12.0, [(0, 0)])):
        recogniser = make(name)
        recogniser.propose(place(0))
        assert [c.target for c in recogniser.propose(place(0, 1, travel_m=travel_m))] == met


@pytest.mark.parametrize("name", NAMES)
def test_one_place_scores_higher_than_two_different_ones(place, hall, name):
    recogniser = make(name)
    here, again = place(0), place(1, heading=0.6)
    elsewhere = place(2, text="QUIET PLEASE", rssi_dbm=LEVELS_DBM[::-1], walls=hall)
    for k in (here, again, elsewhere):
        recogniser.propose(k)
    assert recogniser.score(here, again) > recogniser.score(here, elsewhere)


@pytest.mark.parametrize("name", ["twc", "text", "fused"])
@pytest.mark.parametrize(("first", "second"), [("", ""), (" ", ""), ("", "A301 OPTICS LAB"), ("A301 OPTICS LAB", "")])
def test_readings_without_text_give_no_candidate_by_signs(place, name, first, second):
    recogniser, one, other = make(name), place(0), place(1)
    one.signs[0].text, other.signs[0].text = first, second
    recogniser.propose(one)
    assert recogniser.propose(other) == []


@pytest.mark.parametrize("name", ["wifi", "lidar"])
def test_some_recognisers_need_no_sign(place, name):
    recogniser = make(name)
    recogniser.propose(place(0, text=""))
    assert len(recogniser.propose(place(1, text=""))) == 1


def test_of_many_alike_places_the_lidar_recogniser_proposes_some_of_each_robot_and_of_each_part_of_its_path(place):
    recogniser, count = make("lidar", revisit_travel_m=1000.0), 30
    for index in range(count):
        for robot in range(3):
            recogniser.propose(place(robot, index, heading=index * math.pi / 30, travel_m=2.0 * index))
    found = [c.target for c in recogniser.propose(place(3))]
    assert len(found) == 5 and {robot for robot, _ in found} == {0, 1, 2}
    indices = sorted(index for _, index in found)
    assert indices[0] < count / 3 < count / 2 < indices[-1] and len(set(indices)) > 2


@pytest.mark.parametrize(
    "values", [[3.0, 1.0, 2.0, 1.5, 0.5], [1.0, 1.0, 1.0, 0.5, 0.5], [1.0, 1.0 + 1e-12, 1.0, 1.0, 1.0]]
)
def test_the_least_values_come_first_and_equal_ones_are_spread(values):
    robots = np.zeros(5, int)
    found = least(np.array(values), robots, 3)
    assert len(set(found.tolist())) == 3
    assert np.round(np.array(values)[found], 9).tolist() == sorted(np.round(values, 9))[:3]
    assert least(np.array(values), robots, 9).tolist() == np.argsort(np.round(values, 9), kind="stable").tolist()
    assert least(np.ones(5), np.array([0, 1, 0, 1, 0]), 2).tolist() == [2, 3]


def test_the_text_recogniser_does_not_use_radio(place):
    recogniser = make("text")
    recogniser.propose(place(0))
    assert len(recogniser.propose(place(1, rssi_dbm=LEVELS_DBM[::-1]))) == 1


def test_the_fused_recogniser_tolerates_a_misreading_that_the_hard_rule_rejects(place):
    counts = {}
    for name in ("twc", "fused"):
        recogniser = make(name)
        recogniser.propose(place(0))
        counts[name] = len(recogniser.propose(place(1, text="A3OI OPT1CS 1AB")))
    assert counts == {"twc": 0, "fused": 1}


def test_the_fused_recogniser_reports_log_odds_and_applies_its_threshold(place):
    recogniser = make("fused")
    recogniser.propose(place(0))
    (found,) = recogniser.propose(place(1))
    assert found.log_odds == pytest.approx(recogniser.score(place(0), place(1)))
    strict = make("fused", log_odds_min=50.0)
    strict.propose(place(0))
    assert strict.propose(place(1)) == []


@pytest.mark.parametrize("name", NAMES)
def test_the_engine_verifies_candidates_of_every_recogniser(recorded, name):
    config, frames, _ = recorded
    engine = CooperativeSlam(override(config, {"slam.place_recognition.recogniser": name}), config.robots)
    for step in frames[:250]:
        engine.update(step)
    engine.finish()
    assert {c.candidate.recogniser for c in engine.team.closures} <= {name, "proximity"}
    assert any(c.candidate.recogniser == name for c in engine.team.closures)


def test_a_carried_robot_is_compared_by_wifi_with_all_earlier_places_until_it_is_found_whatever_signs_it_reads(place):
    recogniser = SignlessRecogniser(PlaceRecognitionConfig(), 10.0, robot_count=1)
    assert recogniser.propose(place(0)) == []
    recogniser.add_robot()
    lost = [replace(place(1, k, text="QUIET PLEASE", travel_m=2.0 * k), time_s=60.0) for k in range(3)]
    nothing_heard = Fingerprint(np.zeros(0, np.int64), np.zeros(0))
    assert recogniser.propose(replace(lost[0], fingerprint=nothing_heard), is_lost=True) == []
    assert [c.target for c in recogniser.propose(lost[0], is_lost=True)] == [(0, 0)]
    assert [c.target for c in recogniser.propose(lost[1], is_lost=True)] == [(0, 0)]
    assert recogniser.propose(lost[2]) == []
