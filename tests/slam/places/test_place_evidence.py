import math

import numpy as np
import pytest

from twc_env.records.messages import SignObservation
from twc_env.slam.places.place_evidence import NO_EVIDENCE, PlaceMemory

MACS = (1, 2, 3, 4, 5)
NEAR_DBM = (-40.0, -50.0, -60.0, -70.0, -80.0)
FAR_DBM = (-80.0, -70.0, -60.0, -50.0, -40.0)
RANGE_MAX_M = 10.0


def sign(text, position=(2.0, 0.0), facing=math.pi):
    return SignObservation(text, np.array(position, float), facing)


@pytest.fixture
def seen(keyframe):
    """A keyframe at x [m] along a path that read one sign 2 m ahead."""

    def make(robot, index, text, x=0.0, rssi_dbm=NEAR_DBM, facing=math.pi):
        return keyframe(
            robot, index, (x, 0.0, 0.0), travel_m=abs(x), signs=[sign(text, facing=facing)], macs=MACS,
            rssi_dbm=rssi_dbm, ranges_m=np.full(90, RANGE_MAX_M),
        )  # fmt: skip

    return make


def weigh(memory, target, source):
    return memory.weigh((target, target.signs[0]), (source, source.signs[0]))


def remember(*keyframes):
    memory = PlaceMemory(RANGE_MAX_M)
    for k in keyframes:
        memory.observe(k)
    return memory


def test_signs_on_both_sides_of_a_wall_are_two_places_even_with_equal_numbers(seen):
    outside = [seen(0, k, "ROOM 3023", x=0.1 * k, facing=-math.pi / 2) for k in range(3)]
    inside = [seen(0, 3 + k, "PLAN 3023", x=0.1 * k, facing=math.pi / 2) for k in range(3)]
    memory = remember(*outside, *inside)
    assert [place.consensus for place in memory.signs[0]] == ["ROOM3023", "PLAN3023"]


def test_signs_on_both_sides_of_a_wall_stay_two_places_despite_a_wrong_facing(seen):
    outside = [seen(0, k, "A301 OPTICS LAB", x=0.1 * k, facing=-math.pi / 2) for k in range(3)]
    turned = seen(0, 3, "A301 OPTICS LAB PLAN", x=0.3, facing=-0.4)
    inside = [seen(0, 4 + k, "A301 OPTICS LAB PLAN", x=0.4 + 0.1 * k, facing=math.pi / 2) for k in range(4)]
    memory = remember(*outside, turned, *inside)
    assert [place.consensus for place in memory.signs[0]] == ["A301OPTICSLAB", "A301OPTICSLABPLAN"]


def test_a_fragment_of_a_text_does_not_join_signs_on_both_sides_of_a_wall(seen):
    inside = [seen(0, k, "A303 SERVER ROOM PLAN", x=0.1 * k, facing=math.pi / 2) for k in range(3)]
    cut = seen(0, 3, "A303 SERVER ROO", x=0.3, facing=math.pi / 2)
    outside = [seen(0, 4 + k, "A303 SERVER ROOM", x=0.4 + 0.1 * k, facing=-math.pi / 2) for k in range(2)]
    memory = remember(*inside, cut, *outside)
    assert [place.consensus for place in memory.signs[0]] == ["A303SERVERROOMPLAN", "A303SERVERROOM"]


def test_spaces_are_ignored_in_texts(seen):
    (place,) = remember(seen(0, 0, "ROOM 3023"), seen(0, 1, "ROOM3023")).signs[0]
    assert (place.consensus, place.support) == ("ROOM3023", 2)


def test_a_unique_text_is_evidence_for_one_place_and_a_different_one_against(seen):
    one, other, unlike = seen(0, 0, "A301 OPTICS LAB"), seen(1, 0, "A301 OPTICS LAB"), seen(2, 0, "A304 LIBRARY")
    memory = remember(one, other, unlike)
    assert weigh(memory, one, other).total > 3
    assert weigh(memory, one, unlike).total < 0 > weigh(memory, one, unlike).text + 3


def test_a_repeated_text_alone_is_no_evidence(seen):
    here, there, other = seen(0, 0, "EXIT"), seen(0, 1, "EXIT", x=15.0), seen(1, 0, "EXIT")
    unique = remember(here, other)
    repeated = remember(here, there, other)
    assert weigh(unique, here, other).text > 2
    assert weigh(repeated, here, other).text < 0.5


def test_a_repeated_text_with_another_fingerprint_does_not_reduce_the_evidence(seen):
    here, there, other = seen(0, 0, "EXIT"), seen(0, 1, "EXIT", x=15.0, rssi_dbm=FAR_DBM), seen(1, 0, "EXIT")
    memory = remember(here, there, other)
    assert weigh(memory, here, other).total > 3
    assert weigh(memory, there, other).total < -3


def test_complete_readings_of_one_pass_outvote_a_fragment(seen):
    readings = [seen(0, k, text, x=0.1 * k) for k, text in enumerate(("OPTI", "A301 OPTICS LAB", "A301 OPTICS LAB"))]
    for k in readings:  # the sign itself stays where it is
        k.signs[0].position_m[0] -= k.pose_odom[0]
    memory = remember(*readings)
    (place,) = memory.signs[0]
    assert (place.consensus, place.support) == ("A301OPTICSLAB", 2)
    assert memory.place_of((readings[0], readings[0].signs[0])) is place


def test_signs_with_opposite_facings_are_two_places(seen):
    memory = remember(seen(0, 0, "EXIT"), seen(0, 1, "EXIT", x=1.5, facing=0.0))
    assert len(memory.signs[0]) == 2


def test_a_different_neighbouring_sign_is_evidence_against_one_place(keyframe):
    def room(robot, label):
        signs = [sign("FIRE CABINET"), sign(label, (2.0, 2.5))]
        return keyframe(robot, signs=signs, macs=MACS, rssi_dbm=NEAR_DBM, ranges_m=np.full(90, RANGE_MAX_M))

    one, alike, same = room(0, "A301 OPTICS LAB"), room(1, "A302 CERAMICS"), room(2, "A301 OPTICS LAB")
    memory = remember(one, alike, same)
    assert weigh(memory, one, alike).neighbours < -1 < 0.5 < weigh(memory, one, same).neighbours


def test_radio_along_the_path_to_a_sign_is_evidence_for_or_against_one_place(keyframe):
    def path(robot, end_dbm):
        """Past a sign with equal text and fingerprint for all robots; the fingerprints before and after may differ."""
        ways = [(x, NEAR_DBM if x == 4 else end_dbm) for x in (1.9, 4, 6.1)]  # too near for radio statistics
        return [
            keyframe(
                robot, k, (x, 0.0, 0.0), travel_m=float(x), macs=MACS, rssi_dbm=rssi_dbm,
                signs=[sign("EXIT")] if x == 4 else [], ranges_m=np.full(90, RANGE_MAX_M),
            )
            for k, (x, rssi_dbm) in enumerate(ways)
        ]  # fmt: skip

    one, same, other = path(0, NEAR_DBM), path(1, NEAR_DBM), path(2, FAR_DBM)
    memory = remember(*one, *same, *other)
    there, elsewhere = weigh(memory, one[1], same[1]), weigh(memory, one[1], other[1])
    assert there.sequence > 1 and elsewhere.sequence < -1
    assert there.radio == elsewhere.radio
    assert there.total == pytest.approx(there.text + there.radio + there.geometry + there.neighbours + there.sequence)


def test_an_empty_text_is_no_evidence_for_one_place(seen):
    blank, other, named = seen(0, 0, ""), seen(1, 0, " "), seen(2, 0, "A301 OPTICS LAB")
    memory = remember(blank, other, named)
    assert -0.2 < weigh(memory, blank, other).text < 0
    assert -0.2 < weigh(memory, blank, named).text < 0
    assert memory.like_text(memory.signs[1][0], 0) == memory.like_text(memory.signs[2][0], 0) == []


def test_a_neighbouring_sign_without_text_is_no_evidence(keyframe):
    def room(robot, label):
        signs = [sign("FIRE CABINET"), sign(label, (2.0, 2.5))]
        return keyframe(robot, signs=signs, macs=MACS, rssi_dbm=NEAR_DBM, ranges_m=np.full(90, RANGE_MAX_M))

    one, blank = room(0, "A301 OPTICS LAB"), room(1, "")
    assert weigh(remember(one, blank), one, blank).neighbours == 0.0


def test_empty_readings_do_not_outvote_a_text(seen):
    readings = [seen(0, k, text) for k, text in enumerate(("", "", "", "", "A301 LAB", "", "A301 LAB", ""))]
    (place,) = remember(*readings).signs[0]
    assert (place.consensus, place.support) == ("A301LAB", 2)


def test_unknown_places_give_no_evidence(seen):
    known, unknown = seen(0, 0, "EXIT"), seen(1, 0, "EXIT")
    assert weigh(remember(known), known, unknown) is NO_EVIDENCE
