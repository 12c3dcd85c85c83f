"""A few accidents of those that `make soak` plays for every command."""

import os
import signal
import subprocess
import sys
import time

import pytest

from tests.soak import accidents
from tests.soak.accidents import look_at, meet
from tests.soak.attempts import attempt_all

pytestmark = pytest.mark.skipif(os.name != "posix", reason="signals and limits of POSIX")


@pytest.mark.parametrize(
    ("name", "kind"), [("compare", "no room"), ("record", "closed pipe"), ("record", "read-only folder")]
)
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


def test_a_file_that_was_said_to_be_written_and_is_not_there_is_found(monkeypatch, tmp_path):
    told = f"written: {tmp_path}/out/map.png, {tmp_path}/out/report.json.\nerror: cannot read {tmp_path}/out/none\n"
    named = ["map.png", "report.json"]
    assert accidents.written(told, tmp_path / "out") == [tmp_path / "out" / name for name in named]
    monkeypatch.setitem(accidents.ACCIDENTS, "planted", lambda *_: (0, told))
    with pytest.raises(AssertionError, match=r"said to be written, and not there: .*map\.png"):
        meet("record", "planted", tmp_path, tmp_path / "none.npz", 0.0)


def test_a_run_that_was_interrupted_goes_on_with_the_pairs_that_its_file_lacks(monkeypatch, tmp_path):
    met = []

    def one(name, kind, *_):
        met.append((name, kind))
        assert (name, kind) != ("record", "kill -9"), "planted"
        if len(met) == 4:
            raise KeyboardInterrupt

    monkeypatch.setattr(accidents, "meet", one)
    monkeypatch.setattr(accidents, "_undisturbed_s", lambda *_: 1.0)
    monkeypatch.setattr(accidents, "_started", lambda *_: None)
    monkeypatch.setattr(accidents, "_finished", lambda *_: (0, ""))
    file = tmp_path / "rows.jsonl"
    with pytest.raises(KeyboardInterrupt):
        attempt_all(accidents.accidents(6, 0, file), is_watched=False)
    done = attempt_all(accidents.accidents(6, 0, file), is_watched=False)
    assert (done.tried, done.accepted, len(met)) == (6, 5, 7)
    assert len(done.wrong) == 1 and done.wrong[0].startswith("record, kill -9: AssertionError: ")
    attempt_all(accidents.accidents(2, 1, file), is_watched=False)
    assert len(met) == 9  # of another seed


def test_every_pair_of_a_command_and_an_accident_is_tried_once():
    every = accidents.pairs()
    assert len(set(every)) == len(every) and len(every) in (74, 74 - 11)  # without torch nothing is trained
    assert {kind for _, kind in every} == set(accidents.ACCIDENTS)


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
