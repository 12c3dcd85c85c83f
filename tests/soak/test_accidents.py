"""A few accidents of those that `make soak` plays for every command."""

import os
import signal
import subprocess
import sys
import time

import pytest

from tests.soak import accidents
from tests.soak.accidents import look_at, meet

pytestmark = pytest.mark.skipif(os.name != "posix", reason="signals and limits of POSIX")


@pytest.mark.parametrize(("name", "kind"), [("compare", "no room"), ("record", "closed pipe"), ("record", "no folder")])
def test_after_an_accident_no_file_is_half_and_the_command_ends_well_once_more(name, kind, tmp_path):
    meet(name, kind, tmp_path, tmp_path / "none.npz", 0.0)


@pytest.mark.parametrize("file", ["a.json", "a.npz", "a.tum", "a.csv", ".part-1-a.json"])
def test_half_files_are_found(file, tmp_path):
    (tmp_path / file).write_text('{"a": ')
    with pytest.raises((AssertionError, ValueError)):
        look_at(tmp_path)


def test_a_traceback_and_a_run_that_fails_once_more_are_found(monkeypatch, tmp_path):
    log = tmp_path / "none.npz"
    monkeypatch.setitem(accidents.ACCIDENTS, "planted", lambda *_: (2, "Traceback (most recent call last)"))
    with pytest.raises(AssertionError, match="a traceback"):
        meet("record", "planted", tmp_path / "a", log, 0.0)
    monkeypatch.setitem(accidents.ACCIDENTS, "planted", lambda *_: (0, ""))
    with pytest.raises(AssertionError, match="once more it ends with status 2"):
        meet("replay", "planted", tmp_path / "b", log, 0.0)


@pytest.mark.skipif(not os.path.isdir("/proc/self"), reason="reads /proc")
def test_the_moment_of_a_signal_counts_the_processor_time_of_a_command_and_its_workers():
    work = "import sys, time\nwhile time.process_time() < 0.3: pass\ntime.sleep(60)"
    parent = f"import subprocess, sys\nsubprocess.run([sys.executable, '-c', {work!r}])"
    running = subprocess.Popen([sys.executable, "-c", parent], start_new_session=True)
    until = time.monotonic() + 60.0
    while (used_s := accidents._used_s(running.pid)) < 0.25 and time.monotonic() < until:
        time.sleep(0.05)
    os.killpg(running.pid, signal.SIGKILL)
    running.wait()
    assert 0.25 <= used_s < 3.0


def test_every_command_of_the_list_exists():
    from twc_env.__main__ import COMMANDS

    assert {words[0] for words in accidents.COMMANDS.values()} <= {str(name) for name in COMMANDS}
