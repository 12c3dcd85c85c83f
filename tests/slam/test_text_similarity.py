import pytest
from hypothesis import given
from hypothesis import strategies as st

from twc_env.slam.text_similarity import AlikeTexts, normalise, text_similarity

texts = st.text("ABE3O0 I1", max_size=9)


def edit_distance(a: str, b: str) -> int:
    """The textbook table, cell by cell."""
    table = [[i + j if i * j == 0 else 0 for j in range(len(b) + 1)] for i in range(len(a) + 1)]
    for i in range(1, len(a) + 1):
        for j in range(1, len(b) + 1):
            change = table[i - 1][j - 1] + (a[i - 1] != b[j - 1])
            table[i][j] = min(table[i - 1][j] + 1, table[i][j - 1] + 1, change)
    return table[-1][-1]


@pytest.mark.parametrize(
    ("a", "b", "expected"),
    [
        ("EXIT", "EXIT", 1.0),
        ("EXIT", "EX1T", 0.75),
        ("A301", "A302", 0.75),
        ("ROOM A301", "ROOM A302", 8 / 9),
        ("FIRE HYDRANT", "FIRE HYDRAN", 11 / 12),
        ("ABC", "XYZ", 0.0),
        ("", "EXIT", 0.0),
        ("", "", 0.0),  # an empty text is like nothing, not even itself
    ],
)
def test_known_pairs_have_the_similarity_of_equation_five(a, b, expected):
    assert text_similarity(a, b) == pytest.approx(expected, abs=1e-12)


@given(texts, texts)
def test_similarity_is_one_minus_the_edit_distance_over_the_longer_length(a, b):
    longest = max(len(a), len(b))
    expected = (longest - edit_distance(a, b)) / longest if a and b else 0.0
    assert text_similarity(a, b) == pytest.approx(expected, abs=1e-12)


@given(texts, st.lists(texts, max_size=5, unique=True))
def test_one_against_many_gives_what_one_against_one_gives(text, others):
    many = AlikeTexts(-1.0)
    for other in others:
        many.number_of(other)
    expected = [text_similarity(text, other) for other in others]
    assert [s for _, s in many.alike(text)] == pytest.approx(expected, abs=1e-12)


def test_normalising_ignores_case_and_spaces():
    assert normalise("  fire \t cabinet\n") == "FIRE CABINET"
    assert normalise(" \t ") == ""


@given(texts)
def test_normalising_twice_changes_nothing(text):
    assert normalise(normalise(text)) == normalise(text)


def test_alike_texts_are_those_that_a_comparison_with_all_would_find():
    texts = ["ROOM 101", "ROOM 102", "TOILET", "", "ROOM 101", "R00M 101", "EXIT"]
    alike = AlikeTexts(0.8)
    for text in texts:
        alike.number_of(text)
    distinct = list(dict.fromkeys(texts))
    for text in [*distinct, "ROOM 10", "T0ILET"]:
        expected = {k: text_similarity(text, other) for k, other in enumerate(distinct)}
        assert dict(alike.alike(text)) == {k: pytest.approx(s) for k, s in expected.items() if s >= 0.8}


def test_texts_that_are_kept_are_numbered_anew_and_alike_as_before():
    texts, kept = ["ROOM 101", "ROOM 102", "TOILET", "R00M 101", "EXIT"], ["ROOM 102", "R00M 101", "EXIT"]
    alike, fresh = AlikeTexts(0.7), AlikeTexts(0.7)
    for text in texts:
        alike.number_of(text)
    for text in kept:
        fresh.number_of(text)
    assert alike.keep(set(kept)).tolist() == [-1, 0, -1, 1, 2]
    for text in [*texts, "ROOM 10"]:
        assert sorted(alike.alike(text)) == sorted(fresh.alike(text)) and alike.has(text) == fresh.has(text)


def test_a_similarity_that_equals_the_minimum_meets_it():
    alike = AlikeTexts(0.8)
    for text in ("A1013", "ENTRANCE 1"):
        alike.number_of(text)
    assert alike.alike("A1018") == [(0, pytest.approx(0.8))]
    assert alike.alike("ENTRANSE 2") == [(1, pytest.approx(0.8))]
