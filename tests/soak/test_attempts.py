"""Malformed input of every kind is refused in one line or valid; `make soak` makes more attempts."""

import importlib
import json
import os
import subprocess
import time
from pathlib import Path

import numpy as np
import pytest

from tests.soak import attempts
from tests.soak.__main__ import KINDS, main
from tests.soak.attempts import attempt_all
from tests.soak.malformed import graph_fuzz, map_fuzz
from twc_env.errors import MapError, TwcError

COUNTS = {
    "actions": (900, 850, 3),
    "maps": (220, 130, 10),
    "logs": (40, 10, 2),
    "bags": (32, 8, 0),
    "tables": (20, 3, 1),
    "settings": (240, 120, 5),
    "graphs": (40, 3, 10),
    "arrays": (90, 30, 5),
    "calls": (800, 400, 20),
    "bombs": (5, 4, 0),
}
"""Of each kind how many are tried, and how many must be refused and accepted at least."""


def attempted(kind, count, seed):
    module, _, function = KINDS[kind].generator.rpartition(".")
    return attempt_all(
        getattr(importlib.import_module(f"tests.soak.{module}"), function)(count, seed), KINDS[kind].error
    )


@pytest.mark.filterwarnings(  # rosbags leaves damaged files to the garbage collector
    "ignore::RuntimeWarning", "ignore::UserWarning", "ignore::pytest.PytestUnraisableExceptionWarning"
)
@pytest.mark.parametrize("kind", COUNTS)
def test_malformed_input_of_every_kind_is_refused_in_one_line_or_valid(kind, tmp_path, monkeypatch):
    if kind == "bags":
        pytest.importorskip("rosbags")
    monkeypatch.chdir(tmp_path)
    count, refused, accepted = COUNTS[kind]
    done = attempted(kind, count, 7)
    assert done.wrong == []
    assert done.tried == count == done.refused + done.accepted
    assert done.refused >= refused and done.accepted >= accepted


def test_equal_seeds_give_equal_attempts():
    first, second, third = ([what for what, _ in map_fuzz.mutated_maps(40, seed)] for seed in (1, 1, 2))
    assert first == second != third


def test_numbers_that_a_change_made_too_long_are_not_renumbered():
    raw = b"VERTEX_SE2 " + b"7" * 5000 + b" 1 2 0\nVERTEX_SE2 3 1 2 0"
    first, second = graph_fuzz._renumbered(raw, np.random.default_rng(0)).split(b"\n")
    assert first == raw.split(b"\n")[0] and second != raw.split(b"\n")[1]


class OfTwoLines(MapError):
    """An error whose message has two lines; `TwcError` itself would join them."""

    def __str__(self):
        return "two\nlines"


class OfTwoThousandLetters(MapError):
    """An error of one long line; `TwcError` itself would shorten it."""

    def __str__(self):
        return "a; " * 700


def raising(error):
    raise error


@pytest.mark.parametrize(
    ("work", "told"),
    [
        (lambda: raising(ValueError("bad")), "ValueError: bad"),
        (lambda: raising(RecursionError("deep")), "RecursionError"),
        (lambda: raising(OfTwoLines()), "several lines"),
        (lambda: raising(MapError("it failed")), "no remedy"),
        (lambda: raising(OfTwoThousandLetters()), "characters"),
        (lambda: Path("/etc/passwd").read_text(), "touched /etc/passwd"),
        (lambda: subprocess.run(["true"]), "touched subprocess.Popen"),
        (lambda: os.system("true"), "touched os.system"),
    ],
)
def test_what_is_wrong_is_found(work, told):
    done = attempt_all([("sound", lambda: None), ("bad", work)], TwcError)
    assert (done.tried, done.accepted + done.refused + len(done.wrong)) in ((2, 2), (2, 3))
    assert len(done.wrong) == 1 and told in done.wrong[0]


def test_what_takes_long_or_much_memory_is_found(monkeypatch):
    monkeypatch.setattr(attempts, "SECONDS_MAX", 0.05)
    monkeypatch.setattr(attempts, "MEMORY_MAX_MB", 50.0)

    def slow():
        begun = time.process_time()
        while time.process_time() < begun + 0.1:
            pass

    done = attempt_all([("slow", slow), ("large", lambda: bytearray(os.urandom(1) * 400_000_000))], TwcError)
    assert any("slow: took" in fault for fault in done.wrong) and "memory grew by" in done.wrong[-1]


def test_a_wait_for_another_process_that_compiles_is_no_hang_and_one_that_comes_again_is(monkeypatch):
    monkeypatch.setattr(attempts, "WALL_SECONDS_MAX", 0.1)
    waits = iter((0.2, 0.0, 0.2, 0.2))
    done = attempt_all([("once", lambda: time.sleep(next(waits))), ("again", lambda: time.sleep(next(waits)))])
    assert len(done.wrong) == 1 and done.wrong[0].startswith("again: took 0.0 s and waited 0 s, more than 2 or 0.1 s")


def test_the_command_writes_counts_and_ends_with_an_error_if_anything_is_wrong(tmp_path, monkeypatch, capsys):
    file = tmp_path / "a.json"
    assert main(["--maps", "20", "--graphs", "3", "--json", str(file)]) == 0
    found = json.loads(file.read_text())
    assert found["maps"]["tried"] == 20 and found["graphs"]["tried"] == 3
    assert all(own["wrong"] == 0 and own["refused"] + own["accepted"] == own["tried"] for own in found.values())
    assert "maps: 20 tried" in capsys.readouterr().out
    assert main(["--maps", "5", "--json", str(file)]) == 0  # what the file has of others stays
    again = json.loads(file.read_text())
    assert again["maps"]["tried"] == 5 and again["graphs"] == found["graphs"]
    monkeypatch.setattr(attempts, "SECONDS_MAX", 0.0)
    assert main(["--maps", "3"]) == 2
    assert "more than 0 or 30 s" in capsys.readouterr().err


@pytest.mark.parametrize("line", graph_fuzz._ODD_LINES)
def test_each_odd_line_of_a_graph_is_named_or_used(line, tmp_path):
    path = tmp_path / "a.g2o"
    path.write_text(graph_fuzz.ring_graph() + line + "\n")
    assert attempt_all([(line, lambda: graph_fuzz.optimise(path, "none"))], TwcError).wrong == []
