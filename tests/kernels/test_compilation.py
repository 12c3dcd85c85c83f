"""What happens while kernels are compiled."""

import gc
import logging
import sys
import threading
from types import SimpleNamespace

import pytest

from twc_env.kernels import compilation
from twc_env.kernels.compilation import Announcer
from twc_env.processes.file_lock import FileLock
from twc_env.slam import warm_up
from twc_env.slam.pose_graph import robust_back_end


def compilation_of(module):
    return SimpleNamespace(data={"dispatcher": SimpleNamespace(py_func=SimpleNamespace(__module__=module))})


OURS, OTHER = compilation_of("twc_env.world.sensors.lidar"), compilation_of("another.package")


def test_the_first_compilation_of_a_kernel_of_this_package_is_logged_once(caplog):
    announcer = Announcer()
    with caplog.at_level(logging.WARNING, "twc_env"):
        for event, count in ((OTHER, 0), (OURS, 1), (OURS, 1)):
            announcer.on_start(event)
            announcer.on_end(event)
            assert len(caplog.records) == count
    assert "compiling" in caplog.records[0].message
    assert announcer.count == 3


@pytest.mark.parametrize(
    ("is_empty", "total", "told"),
    [(True, 180, "half a minute"), (True, compilation.EVERYTHING, "some minutes"), (False, 180, "further kernels")],
)
def test_how_long_it_takes_is_announced_where_nothing_is_compiled_yet(monkeypatch, caplog, is_empty, total, told):
    monkeypatch.setattr(compilation, "is_empty", lambda: is_empty)
    announcer = Announcer()
    announcer.total = total
    announcer.on_start(OURS)
    announcer.on_end(OURS)
    assert told in caplog.records[0].message and ("minute" in caplog.records[0].message) == is_empty


@pytest.mark.parametrize("kept", [True, False])
def test_the_message_promises_later_starts_only_what_holds(monkeypatch, kept, tmp_path):
    monkeypatch.setattr(compilation, "is_kept", lambda: kept)
    monkeypatch.setattr(compilation, "cache_folder", lambda: tmp_path)
    assert (str(tmp_path) if kept else "NUMBA_CACHE_DIR") in compilation._of_later_starts()


def test_a_terminal_shows_a_bar_that_makes_way_after_each_kernel(monkeypatch, capsys):
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True, raising=False)
    announcer = Announcer()
    announcer.total = 2
    for _ in range(3):
        announcer.on_start(OURS)
        assert announcer._bar is not None
        announcer.on_start(OTHER)
        announcer.on_end(OTHER)
        announcer.on_end(OURS)
        assert announcer._bar is None
    assert announcer.total == announcer.count == 6  # more than expected: the bar grows
    assert "compiling" in capsys.readouterr().err


def test_a_process_that_waits_for_each_kernel_says_so_once(monkeypatch, caplog, tmp_path):
    monkeypatch.setattr(compilation, "cache_folder", lambda: tmp_path)
    monkeypatch.setattr(compilation, "SILENT_S", 0.0)
    held, waiting = FileLock(tmp_path / "compiling.lock"), compilation.OneProcess()
    with caplog.at_level(logging.WARNING, "twc_env"):
        for _ in range(2):
            assert held.await_it(1.0)
            threading.Timer(0.2, held.release).start()
            waiting.on_start(OURS)
            waiting.on_end(OURS)
    assert [record.message.startswith("waiting") for record in caplog.records] == [True]


@pytest.mark.parametrize("collects", [True, False])
def test_garbage_collection_is_off_during_compilation(collects):
    announcer, before, seen = Announcer(), gc.isenabled(), []
    (gc.enable if collects else gc.disable)()
    try:
        for happen in (announcer.on_start, announcer.on_start, announcer.on_end, announcer.on_end):
            happen(OTHER)
            seen.append(gc.isenabled())
    finally:
        (gc.enable if before else gc.disable)()
    assert seen == [False, False, False, collects]


def test_an_environment_announces_once_per_process():
    assert compilation.announcer() is compilation.announcer()


def test_the_warm_up_rejects_enough_closures_to_compile_all_kernels_of_the_robust_back_end():
    found = warm_up.reject_false_closures()
    assert len(found.rejections) > robust_back_end.FEW_REFUSED  # fewer do not use all kernels
    assert not found.accepted[-warm_up.FALSE :].any() and found.accepted[: -warm_up.FALSE].all()
