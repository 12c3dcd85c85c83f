import numpy as np

from twc_env.slam.text_likelihood import log_text_likelihood, log_unknown_text


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


def test_a_long_unknown_text_is_harder_to_guess_than_a_short_one():
    assert log_unknown_text("A301 OPTICS LAB") < log_unknown_text("EXIT") < 0
