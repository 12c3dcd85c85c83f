import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from twc_env.slam.places.text_similarity import SimilarTexts, normalise, text_similarity

texts = st.text("ABE3O0 I1", max_size=12)


def edit_distance(a: str, b: str) -> int:
    """Edit distance by the textbook table."""
    table = [[i + j if i * j == 0 else 0 for j in range(len(b) + 1)] for i in range(len(a) + 1)]
    for i in range(1, len(a) + 1):
        for j in range(1, len(b) + 1):
            change = table[i - 1][j - 1] + (a[i - 1] != b[j - 1])
            table[i][j] = min(table[i - 1][j] + 1, table[i][j - 1] + 1, change)
    return table[-1][-1]


@given(texts, texts)
def test_similarity_is_one_minus_the_edit_distance_over_the_longer_length(a, b):
    longest = max(len(a), len(b))
    expected = (longest - edit_distance(a, b)) / longest if a and b else 0.0
    assert text_similarity(a, b) == pytest.approx(expected, abs=1e-12)


@given(texts, st.lists(texts, max_size=5), st.sampled_from([-1.0, 0.505, 0.757]))
@example("EXIT", ["EXAM", "EXIT", ""], 0.505)
def test_similar_texts_equal_those_of_an_exhaustive_comparison(text, others, minimum):
    alike = SimilarTexts(minimum)
    for other in others:
        alike.number_of(other)
    expected = [(k, text_similarity(text, other)) for k, other in enumerate(dict.fromkeys(others))]
    assert dict(alike.alike(text)) == {k: pytest.approx(s) for k, s in expected if s >= minimum}


def test_normalising_ignores_case_and_spaces():
    assert normalise("  fire \t cabinet\n") == "FIRE CABINET"
    assert normalise(" \t ") == ""


def test_accents_are_compared_as_read_whether_composed_or_not():
    assert normalise("cafe\u0301") == normalise("caf\u00e9") == "CAF\u00c9"


@given(texts)
def test_normalising_twice_changes_nothing(text):
    assert normalise(normalise(text)) == normalise(text)


def test_remaining_texts_are_renumbered_with_unchanged_similarities():
    texts, kept = ["ROOM 101", "ROOM 102", "TOILET", "R00M 101", "EXIT"], ["ROOM 102", "R00M 101", "EXIT"]
    alike, fresh = SimilarTexts(0.7), SimilarTexts(0.7)
    for text in texts:
        alike.number_of(text)
    for text in kept:
        fresh.number_of(text)
    assert alike.keep(set(kept)).tolist() == [-1, 0, -1, 1, 2]
    for text in [*texts, "ROOM 10"]:
        assert sorted(alike.alike(text)) == sorted(fresh.alike(text)) and alike.has(text) == fresh.has(text)


def test_a_similarity_equal_to_the_minimum_passes():
    alike = SimilarTexts(0.8)
    for text in ("A1013", "ENTRANCE 1"):
        alike.number_of(text)
    assert alike.alike("A1018") == [(0, pytest.approx(0.8))]
    assert alike.alike("ENTRANSE 2") == [(1, pytest.approx(0.8))]
