"""Commands that are interrupted from outside, that find no room, and what they leave behind."""

import json
import os
import signal
import subprocess
import sys
import time

import numpy as np
import pytest

from tests.soak.accidents import PROGRAM, ROOM
from twc_env.datasets.logs.frame_log import read_contacts, read_frame_log, read_truth_log

pytestmark = pytest.mark.skipif(os.name != "posix", reason="signals and limits of POSIX")

EXPLORE = ("explore", "--robots", "1", "--steps", "100000", "--no-pictures", "--set", "lidar.beam_count=60")
RECORD = ("record", "--robots", "1", "--steps", "100000", "--set", "lidar.beam_count=60")
SLOW = """
import sys, time
from twc_env.running.command_line import exit_status

def work():
    try:
        print("working", flush=True)
        time.sleep(60)
    except KeyboardInterrupt:
        print("saving", flush=True)
        time.sleep(60 if "slow" in sys.argv else 0)
        raise

sys.exit(exit_status(work))
"""


def at_work(*arguments: str) -> subprocess.Popen:
    """A command that works; Ctrl-C is not ignored, as it is in the background of a shell."""
    program = f"import signal; signal.signal(signal.SIGINT, signal.default_int_handler)\n{SLOW}"
    call = [sys.executable, "-c", program, *arguments]
    running = subprocess.Popen(call, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert running.stdout.readline() == "working\n"
    return running


@pytest.mark.parametrize(("end", "status"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_a_command_that_is_ended_from_outside_may_save_what_it_has(end, status):
    running = at_work()
    running.send_signal(end)
    said, errors = running.communicate(timeout=30)
    assert (running.returncode, said, errors) == (status, "saving\n", "interrupted\n")


def test_a_second_ctrl_c_ends_a_command_at_once_and_a_second_sigterm_does_not():
    for first in (signal.SIGINT, signal.SIGTERM):
        running = at_work("slow")
        running.send_signal(first)
        assert running.stdout.readline() == "saving\n"
        running.send_signal(signal.SIGTERM)
        time.sleep(0.3)
        assert running.poll() is None
        running.send_signal(signal.SIGINT)
        _, errors = running.communicate(timeout=5)
        assert (running.returncode, errors) == (130, "\ninterrupted again: ended at once\n")


@pytest.mark.parametrize(("command", "report"), [(EXPLORE, "report.json"), (RECORD, "truth.npz")])
def test_an_episode_ended_by_sigterm_is_saved_as_by_ctrl_c(command, report, tmp_path):
    program = (
        "import os, signal, sys, twc_env.commands.explore as explore, twc_env.commands.record as record\n"
        "from twc_env.__main__ import main\n"
        "end = lambda done, *_, **__: done == 30 and os.kill(os.getpid(), signal.SIGTERM)\n"
        "record.show_count = end\n"
        "explore.Bar.show = lambda _, done, *__: end(done)\n"
        "sys.exit(main(sys.argv[1:]))"
    )
    call = [sys.executable, "-c", program, *command, "--out", str(tmp_path)]
    done = subprocess.run(call, capture_output=True, text=True, timeout=120)
    assert done.returncode == 143, done.stderr
    assert "interrupted after 30 steps" in done.stderr and "Traceback" not in done.stderr
    assert (tmp_path / report).exists()
    _, steps = read_frame_log(tmp_path / "frames.npz")
    assert len(steps) == len(read_contacts(tmp_path / "frames.npz")) == 31
    if command is EXPLORE:
        assert json.loads((tmp_path / report).read_text())["steps"] == 30
    else:
        assert read_truth_log(tmp_path / report)[2].shape == (31, 1, 3)
    assert not list(tmp_path.glob(".part-*"))


@pytest.mark.parametrize("command", [EXPLORE, RECORD], ids=["explore", "record"])
def test_no_half_file_is_left_where_there_is_no_room(command, tmp_path):
    call = [sys.executable, "-B", "-c", PROGRAM.format(ROOM), *command, "--steps", "40", "--out", str(tmp_path)]
    done = subprocess.run(call, capture_output=True, text=True, timeout=120)
    assert done.returncode == 2, done.stderr
    last = done.stderr.splitlines()[-1]
    assert last.startswith("error: cannot write") and "File too large" in last
    assert not (tmp_path / "frames.npz").exists() and not (tmp_path / "report.json").exists()
    assert not list(tmp_path.glob(".part-*"))
    for path in tmp_path.rglob("*.tum"):
        assert np.loadtxt(path).shape == (41, 8)
