import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace

import pytest

from tests.soak import long_runs
from tests.soak.__main__ import main
from tests.soak.attempts import kept_rows
from twc_env.exploration.environment import ExplorationEnv
from twc_env.running import terminal
from twc_env.tasks import TASKS

SMALL = ("--set", "lidar.beam_count=36")


@pytest.fixture(autouse=True)
def short(monkeypatch):
    monkeypatch.setattr(long_runs, "EPISODE_STEPS", 12)


def test_a_run_that_was_interrupted_goes_on_and_reports_what_the_process_holds(tmp_path, capsys):
    path, rows = tmp_path / "soak.json", tmp_path / "rows.jsonl"
    assert main(["--steps", "20", *SMALL, "--resume", str(rows)]) == 0
    rows.write_text(rows.read_text() + '{"number": 2, "cut')  # by a kill
    assert main(["--steps", "40", *SMALL, "--resume", str(rows), "--json", str(path)]) == 0
    figures = json.loads(path.read_text())["steps"]
    assert (figures["steps"], figures["tried"], figures["accepted"], figures["wrong"]) == (48, 4, 4, 0)
    assert figures["combinations"] == 4 and figures["processes"] == 2
    assert 50 < figures["memory_at_end_mb"] < 5000 and figures["children_left"] == 0
    assert "memory_growth_mb" in capsys.readouterr().out
    assert [row["number"] for row in kept_rows(rows)] == [0, 1, 2, 3]  # none was written into the line that was cut off


def test_every_task_is_played_with_every_effect_and_kind_of_action():
    count = len(TASKS) * len(long_runs.EFFECTS) * len(long_runs.ACTIONS)
    assert len({long_runs.combination(k) for k in range(count)}) == count
    configs = [long_runs._config(k) for k in range(100) if long_runs.combination(k)[1] in ("scanners", "mixed teams")]
    assert len({config.lidar for config in configs}) > 5 and any(config.robot for config in configs)


@pytest.mark.parametrize("number", [*range(8), 49])
def test_every_effect_is_played_and_workers_end(number):
    row = long_runs._played(number, {"lidar.beam_count": 36} if number not in (3, 4) else {})
    assert "wrong" not in row and "refused" not in row and row["steps"] == 12 and row["children"] == 0


def test_memory_growth_and_slower_steps_are_detected():
    rows = [
        {
            **{"number": k, "task": tuple(TASKS)[k % 17], "effect": "none", "actions": "velocity", "steps": 100},
            **{"process": 1, "memory_mb": 100.0 + k, "files": 6, "children": 0, "shared": 0, "cpu_s": 1.0 + k},
        }
        for k in range(100)
    ]
    figures = long_runs._figures(rows)
    assert figures["memory_growth_mb"] > 40 and figures["step_time_growth"] > 1.2


def test_an_exception_is_counted_with_the_episode_it_came_from(monkeypatch, capsys):
    def fail(self, actions):
        raise ZeroDivisionError("planted")

    monkeypatch.setattr(ExplorationEnv, "step", fail)
    assert main(["--steps", "1", "--seed", "7"]) == 2
    assert "episode 7 (twc/ExploreKnownStarts-v0" in (told := capsys.readouterr().err) and "planted" in told


def test_progress_is_logged_once_per_minute(monkeypatch, capsys):
    clock = iter(range(0, 10_000, 25))
    monkeypatch.setitem(terminal._progress, "logged_s", 0.0)
    monkeypatch.setattr(terminal, "time", SimpleNamespace(monotonic=lambda: float(next(clock))))
    assert main(["--steps", "120", *SMALL]) == 0
    lines = [line for line in capsys.readouterr().err.splitlines() if "/120 steps" in line]
    assert 2 <= len(lines) <= 5 and all("\r" not in line for line in lines)


PARENT = """
import sys, time
from twc_env.vector.teams import VectorTeams
from twc_env.processes.worker_processes import in_processes

if __name__ == "__main__":
    if sys.argv[1] == "teams":
        teams = VectorTeams(3, {"lidar.beam_count": 36}, workers=3)
        teams.reset(0)
        print("working", flush=True)
        time.sleep(60)
    for _ in in_processes(time.sleep, [0.1, 60, 60], 2):
        print("working", flush=True)
"""


def descendants(process: int) -> list[int]:
    children = Path(f"/proc/{process}/task/{process}/children")
    own = [int(text) for text in children.read_text().split()] if children.exists() else []
    return own + [other for child in own for other in descendants(child)]


@pytest.mark.skipif(not Path("/proc/self/task").exists(), reason="reads /proc")
@pytest.mark.parametrize("kind", ["teams", "parts"])
def test_no_worker_outlives_a_parent_that_is_killed(kind, tmp_path):
    script = tmp_path / "parent.py"
    script.write_text(PARENT)
    parent = subprocess.Popen([sys.executable, str(script), kind], stdout=subprocess.PIPE, text=True)
    assert parent.stdout.readline() == "working\n"
    workers = descendants(parent.pid)
    assert len(workers) >= 2
    parent.send_signal(signal.SIGKILL)
    parent.wait()
    parent.stdout.close()
    until = time.monotonic() + 20.0
    while any(os.path.exists(f"/proc/{worker}") and not is_zombie(worker) for worker in workers):
        assert time.monotonic() < until, "workers outlive their parent"
        time.sleep(0.1)


def is_zombie(process: int) -> bool:
    try:
        return Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0] == "Z"
    except OSError:
        return True
