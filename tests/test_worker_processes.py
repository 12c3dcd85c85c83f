import os
import signal
import subprocess
import sys
import time

import pytest

from twc_env.errors import DataError
from twc_env.worker_processes import in_processes

SCRIPT = """
import sys, time
from pathlib import Path
from twc_env.worker_processes import in_processes

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


def test_every_part_is_done_once_whatever_the_order():
    assert dict(in_processes(_square, [0, 1, 2, 4, 5], 2)) == {0: 0, 1: 1, 2: 4, 3: 16, 4: 25}


def test_an_error_of_a_part_reaches_the_caller():
    with pytest.raises(ValueError, match="three"):
        list(in_processes(_square, [3, 1], 2))


def test_a_process_that_died_is_one_line():
    with pytest.raises(DataError, match="a worker process has died"):
        list(in_processes(_leave, [1, 2], 2))


def test_ctrl_c_at_a_terminal_ends_all_processes_without_tracebacks(tmp_path):
    script, parts = tmp_path / "script.py", [tmp_path / "a", tmp_path / "b"]
    script.write_text(SCRIPT, encoding="utf-8")
    command = [sys.executable, str(script), *map(str, parts)]
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, start_new_session=True
    ) as running:
        while not all(part.exists() for part in parts):
            assert running.poll() is None
            time.sleep(0.05)
        os.killpg(running.pid, signal.SIGINT)
        said, _ = running.communicate(timeout=30)  # ends when all have closed what they print to
    assert said == "interrupted\n"
