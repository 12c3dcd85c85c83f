import math

import numpy as np
import pytest

from twc_env.messages import Fingerprint, SignObservation
from twc_env.slam.place_evidence import (
    NO_EVIDENCE,
    PlaceMemory,
    RadioStatistics,
    log_text_likelihood,
    log_unknown_text,
    radio_difference_db,
)

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
    return memory.weigh(target, target.signs[0], source, source.signs[0])


def remember(*keyframes):
    memory = PlaceMemory(RANGE_MAX_M)
    for k in keyframes:
        memory.observe(k)
    return memory


def likelihood(reading, other, count=1, other_count=1):
    return float(log_text_likelihood(reading, [other], count, np.array([other_count]))[0])


def test_each_wrong_character_makes_a_text_less_likely():
    values = [likelihood(text, "A301 OPTICS LAB") for text in ("A301 OPTICS LAB", "A3O1 OPTICS LAB", "A3O1 OPT1CS LAB")]
    assert values[0] > values[1] + 2 > values[2] + 4


def test_a_fragment_is_likelier_than_as_many_wrong_characters():
    assert likelihood("OPTIC", "A301 OPTICS LAB") > likelihood("QXZJV", "A301 OPTICS LAB") + 5


def test_texts_that_two_readings_agree_on_are_seldom_misread_and_more_readings_prove_no_more():
    assert likelihood("ROOM A301", "ROOM A302") > likelihood("ROOM A301", "ROOM A302", 2, 2) + 0.3
    assert likelihood("ROOM A301", "ROOM A301", 2, 2) > likelihood("ROOM A301", "ROOM A301")
    assert likelihood("ROOM A301", "ROOM A302", 5, 5) == likelihood("ROOM A301", "ROOM A302", 2, 2)


def test_signs_back_to_back_on_one_wall_are_two_even_if_they_bear_one_number(seen):
    outside = [seen(0, k, "ROOM 3023", x=0.1 * k, facing=-math.pi / 2) for k in range(3)]
    inside = [seen(0, 3 + k, "PLAN 3023", x=0.1 * k, facing=math.pi / 2) for k in range(3)]
    memory = remember(*outside, *inside)
    assert [place.consensus for place in memory.signs[0]] == ["ROOM3023", "PLAN3023"]


def test_a_lost_space_is_no_mistake(seen):
    (place,) = remember(seen(0, 0, "ROOM 3023"), seen(0, 1, "ROOM3023")).signs[0]
    assert (place.consensus, place.support) == ("ROOM3023", 2)


def test_a_long_unknown_text_is_harder_to_guess_than_a_short_one():
    assert log_unknown_text("A301 OPTICS LAB") < log_unknown_text("EXIT") < 0


def test_the_radio_difference_has_a_closed_form_and_ignores_a_common_offset():
    a = Fingerprint(np.array([1, 2]), np.array([-40.0, -50.0]))
    b = Fingerprint(np.array([1, 2]), np.array([-46.0, -52.0]))
    assert radio_difference_db(a, b) == pytest.approx(2.0)
    louder = Fingerprint(a.macs, a.rssi_dbm + 10.0)
    assert radio_difference_db(louder, b) == pytest.approx(2.0)


def test_a_transmitter_heard_on_one_side_only_counts_as_far_away():
    a = Fingerprint(np.array([1, 2]), np.array([-40.0, -50.0]))
    b = Fingerprint(np.array([1]), np.array([-40.0]))
    assert radio_difference_db(a, b) == pytest.approx(20.0)  # differences 0 and 40
    assert radio_difference_db(a, b) == radio_difference_db(b, a)
    assert math.isnan(radio_difference_db(a, Fingerprint(np.zeros(0, int), np.zeros(0))))


def test_the_radio_ratio_falls_with_the_difference_and_changes_sign_between_what_was_learned():
    statistics = RadioStatistics()
    random = np.random.default_rng(0)
    for _ in range(300):
        statistics.learn(float(random.lognormal(np.log(3.0), 0.3)), True)
        statistics.learn(float(random.lognormal(np.log(12.0), 0.3)), False)
    ratios = [statistics.log_ratio(d) for d in (2.0, 4.0, 6.0, 9.0, 15.0)]
    assert ratios == sorted(ratios, reverse=True)
    assert ratios[1] > 1 > -1 > ratios[3]
    assert statistics.log_ratio(6.0) == pytest.approx(0.0, abs=0.6)
    assert statistics.log_ratio(math.nan) == 0.0


def test_a_text_nobody_else_has_speaks_for_one_place_and_an_unlike_one_against(seen):
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


def test_a_repeated_text_that_is_elsewhere_by_its_radio_does_no_harm(seen):
    here, there, other = seen(0, 0, "EXIT"), seen(0, 1, "EXIT", x=15.0, rssi_dbm=FAR_DBM), seen(1, 0, "EXIT")
    memory = remember(here, there, other)
    assert weigh(memory, here, other).total > 3
    assert weigh(memory, there, other).total < -3


def test_readings_of_one_pass_outvote_a_fragment(seen):
    readings = [seen(0, k, text, x=0.1 * k) for k, text in enumerate(("OPTI", "A301 OPTICS LAB", "A301 OPTICS LAB"))]
    for k in readings:  # the sign itself stays where it is
        k.signs[0].position_m[0] -= k.pose_odom[0]
    memory = remember(*readings)
    (place,) = memory.signs[0]
    assert (place.consensus, place.support) == ("A301OPTICSLAB", 2)
    assert memory.place_of(readings[0], readings[0].signs[0]) is place


def test_signs_that_face_away_from_each_other_are_two(seen):
    memory = remember(seen(0, 0, "EXIT"), seen(0, 1, "EXIT", x=1.5, facing=0.0))
    assert len(memory.signs[0]) == 2


def test_a_sign_on_the_wrong_neighbour_speaks_against_one_place(keyframe):
    def room(robot, label):
        signs = [sign("FIRE CABINET"), sign(label, (2.0, 2.5))]
        return keyframe(robot, signs=signs, macs=MACS, rssi_dbm=NEAR_DBM, ranges_m=np.full(90, RANGE_MAX_M))

    one, alike, same = room(0, "A301 OPTICS LAB"), room(1, "A302 CERAMICS"), room(2, "A301 OPTICS LAB")
    memory = remember(one, alike, same)
    assert weigh(memory, one, alike).neighbours < -1 < 0.5 < weigh(memory, one, same).neighbours


def test_what_was_never_seen_gives_no_evidence(seen):
    known, unknown = seen(0, 0, "EXIT"), seen(1, 0, "EXIT")
    assert weigh(remember(known), known, unknown) is NO_EVIDENCE
