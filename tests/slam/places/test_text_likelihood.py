import numpy as np

from twc_env.slam.places.text_likelihood import log_text_likelihood, log_unknown_text


def likelihood(reading, other, count=1, other_count=1):
    return float(log_text_likelihood(reading, [other], count, np.array([other_count]))[0])


def test_each_wrong_character_lowers_the_likelihood():
    values = [likelihood(text, "A301 OPTICS LAB") for text in ("A301 OPTICS LAB", "A3O1 OPTICS LAB", "A3O1 OPT1CS LAB")]
    assert values[0] > values[1] + 2 > values[2] + 4


def test_a_fragment_is_likelier_than_the_same_number_of_wrong_characters():
    assert likelihood("OPTIC", "A301 OPTICS LAB") > likelihood("QXZJV", "A301 OPTICS LAB") + 5


def test_texts_confirmed_by_two_readings_are_reliable_and_more_readings_add_nothing():
    assert likelihood("ROOM A301", "ROOM A302") > likelihood("ROOM A301", "ROOM A302", 2, 2) + 0.3
    assert likelihood("ROOM A301", "ROOM A301", 2, 2) > likelihood("ROOM A301", "ROOM A301")
    assert likelihood("ROOM A301", "ROOM A302", 5, 5) == likelihood("ROOM A301", "ROOM A302", 2, 2)


def test_a_long_unknown_text_is_harder_to_guess_than_a_short_one():
    assert log_unknown_text("A301 OPTICS LAB") < log_unknown_text("EXIT") < 0
