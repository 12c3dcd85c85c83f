import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from twc_env.config import PlaceRecognitionConfig
from twc_env.records.geometry import between, inverse, transform_points, wrap_angle
from twc_env.records.messages import SignObservation
from twc_env.slam.places.place_recognition import ProposalFilter
from twc_env.slam.places.text_wifi_recogniser import TextWifiRecogniser

MACS = (1, 2, 3, 4, 5)
LEVELS_DBM = (-40.0, -50.0, -60.0, -70.0, -80.0)


def sign(text="EXIT", position=(2.0, 0.0), facing=math.pi) -> SignObservation:
    return SignObservation(text, np.array(position, float), facing)


@pytest.fixture
def place(keyframe):
    """A keyframe with one sign reading and five transmitters."""

    def make(robot=0, index=0, text="EXIT", macs=MACS, rssi_dbm=LEVELS_DBM, **rest):
        return keyframe(robot, index, signs=[sign(text)], macs=macs, rssi_dbm=rssi_dbm, **rest)

    return make


def candidates(first, second, **rule):
    recogniser = TextWifiRecogniser(PlaceRecognitionConfig(**rule))
    assert recogniser.propose(first) == []
    return recogniser.propose(second)


def test_similar_text_and_radio_give_a_candidate(place):
    (found,) = candidates(place(0, 4), place(1, 7))
    assert (found.target, found.source, found.recogniser) == ((0, 4), (1, 7), "twc")
    assert (found.text_similarity, found.mac_similarity, found.rssi_similarity) == (1.0, 1.0, 1.0)


@pytest.mark.parametrize(
    ("other", "rule", "count"),
    [
        ({"text": "EX1T"}, {"text_similarity_min": 0.75}, 1),
        ({"text": "EX1T"}, {"text_similarity_min": 0.7501}, 0),
        ({"macs": MACS[:4], "rssi_dbm": LEVELS_DBM[:4]}, {"mac_similarity_min": 0.8}, 1),
        ({"macs": MACS[:4], "rssi_dbm": LEVELS_DBM[:4]}, {"mac_similarity_min": 0.8001}, 0),
        ({}, {"mac_similarity_min": 1.0}, 1),
        ({"rssi_dbm": np.array(LEVELS_DBM) - 6.25}, {"rssi_similarity_min": 0.8}, 1),
        ({"rssi_dbm": np.array(LEVELS_DBM) - 6.26}, {"rssi_similarity_min": 0.8}, 0),
    ],
)
def test_values_at_a_threshold_pass(place, other, rule, count):
    assert len(candidates(place(0), place(1, **other), **rule)) == count


@pytest.mark.parametrize(
    "change",
    [{"text": "A301 OPTICS"}, {"macs": (6, 7, 8, 9, 10)}, {"rssi_dbm": LEVELS_DBM[::-1]}, {"macs": (), "rssi_dbm": ()}],
)
def test_each_cue_alone_can_reject(place, change):
    assert candidates(place(0), place(1, **change)) == []


def test_nothing_is_compared_without_a_sign(keyframe, place):
    blank = keyframe(1, macs=MACS, rssi_dbm=LEVELS_DBM)
    assert candidates(place(0), blank) == []
    assert candidates(blank, place(0)) == []


def test_a_keyframe_is_never_its_own_candidate(keyframe):
    twice = keyframe(0, signs=[sign(), sign()], macs=MACS, rssi_dbm=LEVELS_DBM)
    rule = PlaceRecognitionConfig(revisit_travel_m=0.0)
    assert TextWifiRecogniser(rule).propose(twice) == []


def test_the_more_similar_of_two_texts_is_used(keyframe):
    first = keyframe(0, signs=[sign("ROOM A301"), sign("ROOM A302", (0.0, 3.0))], macs=MACS, rssi_dbm=LEVELS_DBM)
    second = keyframe(1, signs=[sign("ROOM A302", (0.0, 1.0))], macs=MACS, rssi_dbm=LEVELS_DBM)
    (found,) = candidates(first, second)
    assert found.text_similarity == 1.0
    assert found.guess == pytest.approx(np.array([0.0, 2.0, 0.0]), abs=1e-12)


def test_each_earlier_place_gives_one_candidate(place):
    recogniser = TextWifiRecogniser(PlaceRecognitionConfig())
    for index in range(3):
        assert recogniser.propose(place(0, index, travel_m=3.0 * index)) == []
    found = recogniser.propose(place(1, 0))
    assert sorted(c.target for c in found) == [(0, 0), (0, 1), (0, 2)]


def test_a_text_read_at_consecutive_keyframes_is_stored_once(place):
    recogniser = TextWifiRecogniser(PlaceRecognitionConfig())
    for index in range(3):
        recogniser.propose(place(0, index, travel_m=0.2 * index))
    assert [c.target for c in recogniser.propose(place(1, 0))] == [(0, 0)]


def test_a_reading_on_no_known_wall_does_not_hide_the_next_one(keyframe, place):
    recogniser = TextWifiRecogniser(PlaceRecognitionConfig())
    recogniser.propose(keyframe(0, 0, signs=[sign(facing=math.nan)], macs=MACS, rssi_dbm=LEVELS_DBM))
    recogniser.propose(place(0, 1, travel_m=0.3))
    assert [c.target for c in recogniser.propose(place(1, 0))] == [(0, 1)]


def test_the_printed_rule_accepts_large_and_rejects_small_distances(place):
    far = place(1, rssi_dbm=np.array(LEVELS_DBM) - 20.0)
    near = place(1)
    (found,) = candidates(place(0), far, rssi_mode="paper", rssi_similarity_min=1.0)
    assert found.rssi_similarity == pytest.approx(20.0 * math.sqrt(5))
    assert candidates(place(0), near, rssi_mode="paper", rssi_similarity_min=1.0) == []
    assert candidates(place(0), far, rssi_similarity_min=1.0) == []
    assert len(candidates(place(0), near, rssi_similarity_min=1.0)) == 1


def test_the_printed_rule_needs_a_shared_transmitter(place):
    apart = place(1, macs=(7, 8, 9, 10, 11))
    rule = {"rssi_mode": "paper", "mac_similarity_min": 0.0, "rssi_similarity_min": 0.0}
    assert candidates(place(0), apart, **rule) == []
    assert len(candidates(place(0), place(1), **rule)) == 1


def test_case_and_spaces_matter_only_if_configured(place):
    loud, quiet = place(0, text="FIRE  CABINET "), place(1, text="fire cabinet")
    assert len(candidates(loud, quiet, text_similarity_min=1.0)) == 1
    assert candidates(loud, quiet, text_similarity_min=1.0, normalise_text=False) == []


def test_blank_texts_match_nothing(place):
    assert candidates(place(0, text="  "), place(1, text="  "), text_similarity_min=0.1) == []
    assert candidates(place(0, text=""), place(1, text="EXIT"), text_similarity_min=0.1) == []


def test_a_sign_on_no_known_wall_gives_no_guess_and_no_candidate(keyframe, place):
    adrift = keyframe(1, signs=[sign(facing=math.nan)], macs=MACS, rssi_dbm=LEVELS_DBM)
    assert candidates(place(0), adrift) == []
    assert candidates(adrift, place(0)) == []


poses = st.tuples(st.floats(-5, 5), st.floats(-5, 5), st.floats(-3.1, 3.1)).map(np.array)


@given(poses, poses, poses)
def test_two_views_of_one_sign_give_the_exact_pose_between_them(keyframe, first, second, wall):
    views = []
    for robot, pose in enumerate((first, second)):
        position = transform_points(inverse(pose), wall[None, :2])[0]
        seen = sign(position=position, facing=float(wrap_angle(wall[2] - pose[2])))
        views.append(keyframe(robot, signs=[seen], macs=MACS, rssi_dbm=LEVELS_DBM))
    (found,) = candidates(*views)
    assert between(between(first, second), found.guess) == pytest.approx(np.zeros(3), abs=1e-9)


def test_a_place_is_proposed_again_only_after_further_travel(keyframe):
    tried = ProposalFilter()

    def at(robot, travel_m):
        return keyframe(robot, travel_m=travel_m)

    assert tried.is_new(at(0, 5.0), at(1, 8.0), 2.0)
    assert not tried.is_new(at(0, 6.9), at(1, 8.0), 2.0)
    assert not tried.is_new(at(1, 9.5), at(0, 5.5), 2.0)
    assert tried.is_new(at(0, 5.0), at(1, 10.0), 2.0)
    assert tried.is_new(at(0, 7.0), at(1, 8.0), 2.0)
    assert tried.is_new(at(0, 5.0), at(2, 8.0), 2.0)


def test_earlier_places_are_compared_again_once_a_device_offset_is_known(place):
    recogniser = TextWifiRecogniser(PlaceRecognitionConfig())
    names, offset_db, found = ("A101", "A102", "A103"), 12.0, []
    for k, name in enumerate(names):
        levels = np.roll(LEVELS_DBM, k)
        own = place(0, k, name, rssi_dbm=levels)
        loud = place(1, k, name, rssi_dbm=levels + offset_db, travel_m=30.0 * k)
        assert recogniser.propose(own) == []
        found.append(recogniser.propose(loud))
    assert found[:2] == [[], []]
    assert [(c.target, c.source) for c in found[2]] == [((0, k), (1, k)) for k in range(3)]
    assert all(c.rssi_similarity == 1.0 for c in found[2])


def test_skipped_robots_are_not_compared_again_after_a_new_device_offset(place):
    recogniser = TextWifiRecogniser(PlaceRecognitionConfig())
    for k, name in enumerate(("A101", "A102", "A103")):
        recogniser.propose(place(0, k, name))
        found = recogniser.propose(place(1, k, name, rssi_dbm=np.add(LEVELS_DBM, 12.0), travel_m=30.0 * k), (0,))
        assert found == []


def test_transmitters_below_the_sensitivity_of_a_receiver_do_not_count_as_missing(place):
    recogniser = TextWifiRecogniser(PlaceRecognitionConfig())
    far = (*MACS, 6, 7, 8)
    for k, name in enumerate(("A101", "A102", "A103", "A104")):
        recogniser.propose(place(0, k, name))
        loud = np.array([*LEVELS_DBM, -85.0, -86.0, -87.0]) + 12.0  # robot 0 cannot receive the last three
        found = recogniser.propose(place(1, k, name, macs=far, rssi_dbm=loud, travel_m=30.0 * k))
    assert [(c.target, c.mac_similarity) for c in found] == [((0, 3), 1.0)]
    near = np.array([*LEVELS_DBM, -50.0, -50.0, -50.0]) + 12.0  # robot 0 would receive these
    assert recogniser.propose(place(1, 9, "A104", macs=far, rssi_dbm=near, travel_m=200.0)) == []


@pytest.mark.parametrize(("time_s", "count"), [(30.0, 1), (5.0, 0)])
def test_a_robot_without_radio_for_long_is_recognised_by_signs_alone(place, time_s, count):
    recogniser = TextWifiRecogniser(PlaceRecognitionConfig())
    deaf = replace(place(0, macs=(), rssi_dbm=()), time_s=time_s)
    assert recogniser.propose(deaf) == []
    assert len(recogniser.propose(replace(place(1), time_s=time_s))) == count
    recogniser.propose(replace(place(0, 1, travel_m=9.0), time_s=time_s + 1.0))  # the first readings of robot 0
    assert [c.target for c in recogniser.propose(replace(place(2), time_s=time_s + 2.0))] == [(1, 0), (0, 1)]


def test_skipped_pairs_give_no_candidate_but_are_stored(place):
    recogniser, asked = TextWifiRecogniser(PlaceRecognitionConfig()), []
    recogniser.is_wanted = lambda target, source: bool(asked.append((target.key, source.key)))
    recogniser.propose(place(0, 0))
    assert recogniser.propose(place(1, 0)) == [] and asked == [((0, 0), (1, 0))]
    recogniser.is_wanted = None
    assert {c.target for c in recogniser.propose(place(2, 0))} == {(0, 0), (1, 0)}
