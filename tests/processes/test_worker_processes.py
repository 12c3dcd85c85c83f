import os
import signal
import subprocess
import sys
import time

import pytest

from twc_env.errors import DataError
from twc_env.processes.worker_processes import in_processes

SCRIPT = """
import sys, time
from pathlib import Path
from twc_env.processes.worker_processes import in_processes

def work(part):
    Path(part).touch()
    time.sleep(100)

if __name__ == "__main__":
    try:
        list(in_processes(work, sys.argv[1:], 3))
    except KeyboardInterrupt:
        print("interrupted")
"""


def _square(value):
    if value == 3:
        raise ValueError("three")
    return value * value


def _leave(value):
    os._exit(1)


def test_every_part_is_done_once_in_any_order():
    assert dict(in_processes(_square, [0, 1, 2, 4, 5], 2)) == {0: 0, 1: 1, 2: 4, 3: 16, 4: 25}


def test_an_error_of_a_part_reaches_the_caller():
    with pytest.raises(ValueError, match="three"):
        list(in_processes(_square, [3, 1], 2))


def test_the_error_of_a_dead_worker_process_is_one_line():
    with pytest.raises(DataError, match="a worker process has died"):
        list(in_processes(_leave, [1, 2], 2))


def _start(script: str, folder, *arguments: str) -> subprocess.Popen:
    (folder / "script.py").write_text(script, encoding="utf-8")
    command = [sys.executable, str(folder / "script.py"), *arguments]
    return subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, start_new_session=True
    )


def _send(running: subprocess.Popen, end: signal.Signals) -> None:
    """SIGINT is sent to all processes, as by a terminal; other signals to one."""
    os.killpg(running.pid, end) if end == signal.SIGINT else running.send_signal(end)


@pytest.mark.parametrize("end", [signal.SIGINT, signal.SIGKILL, signal.SIGTERM])
def test_worker_processes_end_with_their_parent_however_it_ends(tmp_path, end):
    parts = [tmp_path / "a", tmp_path / "b"]
    with _start(SCRIPT, tmp_path, *map(str, parts)) as running:
        while not all(part.exists() for part in parts):
            assert running.poll() is None
            time.sleep(0.05)
        _send(running, end)
        said, _ = running.communicate(timeout=30)  # returns when all processes have closed standard output
    if end == signal.SIGINT:
        assert (running.returncode, said) == (0, "interrupted\n")
    else:
        assert running.returncode == -end and "Traceback" not in said


TEAMS = """
import sys
from twc_env.vector.teams import VectorTeams

if __name__ == "__main__":
    teams = VectorTeams(2, {"robots": 1, "lidar.beam_count": 16}, workers=2)
    try:
        teams.reset()
        print("playing", flush=True)
        while True:
            teams.step(teams.sample())
    except KeyboardInterrupt:
        print("interrupted")
"""


@pytest.mark.parametrize("end", [signal.SIGINT, signal.SIGKILL])
def test_workers_of_vector_teams_end_silently_with_their_parent(tmp_path, end):
    with _start(TEAMS, tmp_path) as running:
        said = []
        while not said or said[-1] != "playing\n":
            said.append(running.stdout.readline())
            assert said[-1]
        time.sleep(0.5)
        _send(running, end)
        rest, _ = running.communicate(timeout=30)
    words = [line for line in rest.splitlines() if not line.startswith("compiling kernels")]
    assert words == (["interrupted"] if end == signal.SIGINT else [])
