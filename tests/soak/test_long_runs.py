import json
from types import SimpleNamespace

import pytest

from tests.soak import long_runs as soaking
from tests.soak.__main__ import main
from twc_env.exploration.environment import ExplorationEnv
from twc_env.running import command_line


def test_a_short_soak_changes_buildings_and_reports_memory(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(soaking, "EPISODE_STEPS", 12)
    path = tmp_path / "soak.json"
    assert main(["--steps", "40", "--set", "lidar.beam_count=36", "--json", str(path)]) == 0
    figures = json.loads(path.read_text())
    assert figures["steps"] == 48 and figures["episodes"] == figures["buildings"] == 4
    assert 50 < figures["memory_at_end_mb"] < 5000
    assert "memory_growth_mb" in capsys.readouterr().out


def test_memory_growth_is_detected():
    rows = [(k, 100.0 + k) for k in range(1, 101)]
    figures = soaking._figures(rows, 1, 1, 1.0)
    assert figures["memory_growth_mb"] > 40


def test_an_exception_names_the_episode_it_came_from(monkeypatch):
    monkeypatch.setattr(soaking, "EPISODE_STEPS", 3)

    def fail(self, actions):
        raise ZeroDivisionError("planted")

    monkeypatch.setattr(ExplorationEnv, "step", fail)
    with pytest.raises(ZeroDivisionError) as caught:
        soaking.soak(6, seed=7)
    assert "seed 7" in caught.value.__notes__[0]


def test_progress_is_logged_once_per_minute(monkeypatch, capsys):
    monkeypatch.setattr(soaking, "EPISODE_STEPS", 12)
    clock = iter(range(0, 10_000, 25))
    monkeypatch.setitem(command_line._progress, "logged_s", 0.0)
    monkeypatch.setattr(command_line, "time", SimpleNamespace(monotonic=lambda: float(next(clock))))
    assert main(["--steps", "120", "--set", "lidar.beam_count=36"]) == 0
    lines = [line for line in capsys.readouterr().err.splitlines() if "/120 steps" in line]
    assert 2 <= len(lines) <= 5 and all("\r" not in line for line in lines)
