import pytest

from twc_env.errors import MapError
from twc_env.soak import map_fuzz
from twc_env.soak.map_fuzz import fuzz_maps


def test_mutated_files_are_rejected_in_one_line_or_valid():
    report = fuzz_maps(330, seed=7)
    assert report.escaped == []
    assert report.count == 330
    assert report.refused > 200
    assert report.loaded > 20
    assert report.slowest_s < map_fuzz.SECONDS_MAX


def test_equal_seeds_give_equal_mutations():
    first, second, third = (fuzz_maps(40, seed) for seed in (1, 1, 2))
    assert (first.refused, first.loaded) == (second.refused, second.loaded)
    assert first.count == third.count == 40


class OfTwoLines(MapError):
    """An error whose message has two lines; `TwcError` itself would join them."""

    def __str__(self):
        return "two\nlines"


@pytest.mark.parametrize("error", [ValueError("bad"), OfTwoLines(), RecursionError("deep")])
def test_the_fuzzer_detects_injected_faults(monkeypatch, error):
    def broken(path, calls=[]):  # noqa: B006
        if "mutated" in str(path):
            raise error

    monkeypatch.setattr(map_fuzz, "load_map", broken)
    report = fuzz_maps(5)
    assert len(report.escaped) == 5
