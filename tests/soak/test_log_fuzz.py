import json

import pytest

from tests.soak import log_fuzz
from tests.soak.__main__ import main
from tests.soak.log_fuzz import fuzz_logs

pytest.importorskip("rosbags")


def test_damaged_logs_are_rejected_in_one_line_or_replayed():
    report = fuzz_logs(36, seed=5)
    assert report.escaped == []
    assert report.count == 36
    assert report.refused > 8
    assert report.loaded > 2


def test_the_fuzzer_of_logs_detects_injected_faults(monkeypatch):
    def broken(*arguments):
        raise KeyError("two\nlines")

    monkeypatch.setattr(log_fuzz, "read_input", broken)
    monkeypatch.setattr(log_fuzz, "_sound", lambda log: (None, None))
    monkeypatch.setattr(log_fuzz, "run", lambda source, config: None)
    assert len(fuzz_logs(3).escaped) == 3


def test_the_command_counts_damaged_logs(tmp_path, capsys):
    assert main(["--logs", "9", "--json", str(tmp_path / "a.json")]) == 0
    assert json.loads((tmp_path / "a.json").read_text())["logs"]["count"] == 9
    assert "9 damaged logs" in capsys.readouterr().out
