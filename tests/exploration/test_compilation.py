import gc
import json
import logging
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import numba
import pytest
from numba import njit

from twc_env.exploration import compilation
from twc_env.exploration.compilation import FirstStart, _Announcer, announce_compilation
from twc_env.running.file_lock import FileLock
from twc_env.slam import warm_up
from twc_env.slam.pose_graph import robust_back_end as robust_backend


def function_of(module: str):
    def add(a, b):
        return a + b

    add.__module__ = module
    return njit(add)


def test_the_first_compilation_of_a_kernel_of_this_package_is_logged_once(caplog):
    from numba.core import event

    listener = _Announcer()
    event.register("numba:compile", listener)
    try:
        with caplog.at_level(logging.WARNING, "twc_env"):
            function_of("another.package")(1, 2)
            assert not caplog.records
            function_of("twc_env.world.sensors.lidar")(1, 2)
            function_of("twc_env.world.sensors.lidar")(1, 2)
    finally:
        event.unregister("numba:compile", listener)
    # The announcer of another environment in this process may also have logged it.
    assert 1 <= len(caplog.records) <= 2
    assert all("first use" in record.message for record in caplog.records)


def test_the_log_message_promises_cache_files_only_if_they_can_be_written(monkeypatch):
    for place, version, expected in (
        ("/", "0.68.1", "read them from disk"),
        (None, "0.68.1", "name a folder in NUMBA_CACHE_DIR"),
        (None, "0.61.2", "0.62 to 0.68"),
    ):
        monkeypatch.setattr(compilation, "look_up", SimpleNamespace(_cache=SimpleNamespace(cache_path=place)))
        monkeypatch.setattr(numba, "__version__", version)
        assert expected in compilation._what_of_later_starts()


def test_the_announcer_is_registered_once_per_process():
    announce_compilation()
    before = announce_compilation.cache_info().misses
    announce_compilation()
    assert announce_compilation.cache_info().misses == before


@pytest.mark.parametrize("collects", [True, False])
def test_garbage_collection_is_off_during_compilation(collects):
    listener, kernel = _Announcer(), SimpleNamespace(data={"dispatcher": function_of("another.package")})
    before, seen = gc.isenabled(), []
    (gc.enable if collects else gc.disable)()
    try:
        for happen in (listener.on_start, listener.on_start, listener.on_end, listener.on_end):
            happen(kernel)
            seen.append(gc.isenabled())
    finally:
        (gc.enable if before else gc.disable)()
    assert seen == [False, False, False, collects]


class FakeProcess:
    """Records calls; runs until it is killed."""

    def __init__(self, command, **settings):
        self.command, self.events = command, []

    def poll(self):
        return -9 if "killed" in self.events else None

    def kill(self):
        self.events.append("killed")

    def wait(self, timeout=None):
        self.events.append("waited")


@pytest.fixture
def started(monkeypatch, tmp_path):
    """The processes that were started, with two cores and no helper of another process."""
    processes = []
    monkeypatch.setattr(
        compilation.subprocess, "Popen", lambda *a, **k: processes.append(FakeProcess(*a, **k)) or processes[-1]
    )
    monkeypatch.setattr(compilation, "core_count", lambda: 2)
    monkeypatch.setattr(compilation, "helpers_lock", lambda: FileLock(tmp_path / "helper.lock"))
    monkeypatch.setattr(compilation.atexit, "register", lambda _function: None)
    return processes


def first_start() -> FirstStart:
    start = FirstStart()
    start.is_engine_wanted = True
    return start


def test_a_process_that_must_compile_starts_one_helper_and_kills_it_once(started):
    start = first_start()
    assert not start.is_helped
    start.prepare()
    start.prepare()
    (process,) = started
    assert process.command[-1] == "twc_env.exploration.warm_up"
    assert start.is_helped
    start.dismiss()
    start.dismiss()
    assert process.events == ["killed", "waited"]
    assert not start.is_helped


def test_a_forked_process_does_not_kill_the_helper(started):
    start = first_start()
    start.prepare()
    start._owner = -1  # as after a fork
    start.dismiss()
    assert not start.is_helped
    assert started[0].events == []


def test_the_announcer_prepares_for_kernels_of_this_package_only():
    calls = []
    announcer = _Announcer(lambda: calls.append("prepared"))
    for module in ("another.package", "twc_env.world.sensors.lidar"):
        announcer.on_start(SimpleNamespace(data={"dispatcher": function_of(module)}))
        announcer.on_end(None)
        calls.append(module)
    assert calls == ["another.package", "prepared", "twc_env.world.sensors.lidar"]


@pytest.mark.parametrize("lacking", ["engine", "core", "right"])
def test_no_helper_is_started_without_engine_second_core_or_permission(started, monkeypatch, lacking):
    start = first_start()
    start.is_engine_wanted, start.may_call = lacking != "engine", lacking != "right"
    monkeypatch.setattr(compilation, "core_count", lambda: 1 if lacking == "core" else 2)
    start.prepare()
    assert not started


def test_the_helper_is_started_once_an_engine_is_needed(started):
    start = FirstStart()
    start.prepare()
    start.is_engine_wanted = True
    start.prepare()
    assert len(started) == 1


@pytest.mark.skipif(sys.platform == "win32", reason="no such locks there")
def test_of_concurrent_processes_only_one_starts_a_helper(started):
    lock = compilation.helpers_lock()
    assert lock.take()
    first_start().prepare()
    assert not started
    lock.release()
    first_start().prepare()
    assert len(started) == 1


@pytest.mark.parametrize("is_worker", [False, True])
def test_if_locks_fail_all_but_worker_processes_start_a_helper(started, monkeypatch, tmp_path, is_worker):
    monkeypatch.setattr(compilation.multiprocessing, "parent_process", lambda: object() if is_worker else None)
    monkeypatch.setattr(compilation, "helpers_lock", lambda: FileLock(tmp_path / "no such folder" / "helper.lock"))
    first_start().prepare()
    assert len(started) == (0 if is_worker else 1)


def test_no_helper_is_started_without_a_cache_folder(started, monkeypatch):
    monkeypatch.setattr(compilation, "helpers_lock", lambda: None)
    first_start().prepare()
    assert not started


def test_failure_to_start_a_helper_is_ignored(started, monkeypatch):
    def refuse(*_arguments, **_settings):
        raise OSError

    monkeypatch.setattr(compilation.subprocess, "Popen", refuse)
    start = first_start()
    start.prepare()
    start.dismiss()
    assert not start.is_helped


COVERAGE = """
import json, sys, numpy as np
from numba.core.dispatcher import Dispatcher
import twc_env
from twc_env.exploration import compilation
from twc_env.slam import warm_up

compilation.core_count = lambda: 1  # no helper: only kernels that the first step needs are compiled

def signatures():
    return {
        f"{name}.{key} {signature}"
        for name, module in list(sys.modules.items()) if name.startswith("twc_env.slam")
        for key, value in vars(module).items()
        if isinstance(value, Dispatcher)
        for signature in value.signatures
    }

warm_up.main()
before = signatures()
env = twc_env.parallel_env(map="twin-02")
env.reset(seed=0)
env.step(dict.fromkeys(env.agents, np.zeros(2, np.float32)))
print(json.dumps([sorted(before), sorted(signatures() - before)]))
"""


def test_the_helper_compiles_every_kernel_of_the_engine_that_the_first_step_needs():
    found = subprocess.run([sys.executable, "-c", COVERAGE], capture_output=True, text=True, check=True, cwd=ROOT)
    before, lacking = json.loads(found.stdout)
    compiled = {".".join(signature.partition(" ")[0].split(".")[-2:]) for signature in before}
    assert compiled >= {"tracking._track", "scan_integration.integrate_many", "keyframe_taking._take"}
    assert lacking == []


ROOT = Path(__file__).parents[2]


def test_the_helper_rejects_enough_closures_to_compile_all_kernels_of_the_robust_back_end():
    found = warm_up.reject_false_closures()
    assert len(found.rejections) > robust_backend.FEW_REFUSED  # fewer do not use all kernels
    assert not found.accepted[-warm_up.FALSE :].any() and found.accepted[: -warm_up.FALSE].all()
