import json

import pytest

from tests.soak import map_fuzz
from tests.soak.__main__ import main
from tests.soak.map_fuzz import fuzz_maps
from twc_env.errors import MapError


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


def test_the_command_counts_mutated_maps_and_says_what_is_slow(tmp_path, monkeypatch, capsys):
    assert main(["--maps", "40", "--json", str(tmp_path / "a.json")]) == 0
    assert json.loads((tmp_path / "a.json").read_text())["maps"]["count"] == 40
    assert "40 mutated files" in capsys.readouterr().out
    monkeypatch.setattr("tests.soak.map_fuzz.SECONDS_MAX", 0.0)
    assert main(["--maps", "3"]) == 2
    assert "more than 0 s" in capsys.readouterr().err
