import contextlib
import gc
import json
import logging
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest
from numba import njit

from twc_env.exploration import compilation
from twc_env.exploration.compilation import FirstStart, _Announcer, announce_compilation


def compiled(module: str):
    def add(a, b):
        return a + b

    add.__module__ = module
    return njit(add)(1, 2)


def test_the_first_kernel_of_this_package_that_is_compiled_is_announced_once(caplog):
    from numba.core import event

    listener = _Announcer()
    event.register("numba:compile", listener)
    try:
        with caplog.at_level(logging.WARNING, "twc_env"):
            compiled("another.package")
            assert not caplog.records
            compiled("twc_env.world.lidar")
            compiled("twc_env.world.lidar")
    finally:
        event.unregister("numba:compile", listener)
    # Another environment of this process may have spoken up already, or may do so now.
    assert 1 <= len(caplog.records) <= 2
    assert all("first use" in record.message for record in caplog.records)


def test_environments_ask_for_it_once_per_process():
    announce_compilation()
    before = announce_compilation.cache_info().misses
    announce_compilation()
    assert announce_compilation.cache_info().misses == before


@pytest.mark.parametrize("collects", [True, False])
def test_nobody_looks_for_garbage_while_kernels_are_compiled(collects):
    listener, kernel = _Announcer(), SimpleNamespace(data={"dispatcher": compiled_function("another.package")})
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
    """Notes what is asked of it."""

    def __init__(self, command, **settings):
        self.command, self.events = command, []

    def wait(self, timeout=None):
        self.events.append("waited")


@pytest.fixture
def started(monkeypatch):
    """The processes that were started; there are two cores."""
    processes = []
    monkeypatch.setattr(
        compilation.subprocess, "Popen", lambda *a, **k: processes.append(FakeProcess(*a, **k)) or processes[-1]
    )
    monkeypatch.setattr(compilation, "core_count", lambda: 2)
    return processes


def first_start() -> FirstStart:
    start = FirstStart()
    start.is_engine_wanted = True
    return start


def test_a_reset_that_must_compile_calls_a_helper_once_and_awaits_it_after_the_own_share(started, tmp_path):
    start = first_start()
    with start:
        start.prepare(str(tmp_path))
        start.prepare(str(tmp_path))
        (process,) = started
        assert process.command[-1] == "twc_env.slam.warm_up"
        start.join(lambda: process.events.append("own share"))
        start.join(lambda: process.events.append("never"))
    assert process.events == ["own share", "waited"]


def test_the_announcer_says_where_the_kernel_will_stand():
    folders = []
    dispatcher = compiled_function("twc_env.world.lidar")
    dispatcher.enable_caching()
    announcer = _Announcer(folders.append)
    announcer.on_start(SimpleNamespace(data={"dispatcher": dispatcher}))
    announcer.on_end(None)
    assert folders == [dispatcher._cache.cache_path]


@pytest.mark.parametrize("lacking", ["engine", "core", "reset"])
def test_no_helper_is_called_without_need(started, monkeypatch, tmp_path, lacking):
    start = first_start()
    start.is_engine_wanted = lacking != "engine"
    monkeypatch.setattr(compilation, "core_count", lambda: 1 if lacking == "core" else 2)
    with contextlib.nullcontext() if lacking == "reset" else start:
        start.prepare(str(tmp_path))
    assert not started


@pytest.mark.skipif(sys.platform == "win32", reason="no such locks there")
def test_of_processes_that_start_at_once_one_compiles_and_the_others_wait_for_it(started, monkeypatch, tmp_path):
    first, second = first_start(), first_start()
    naps = []

    def nap(_seconds):
        naps.append(len(started))
        if len(naps) == 2:
            first.__exit__()

    monkeypatch.setattr(compilation.time, "sleep", nap)
    with second:
        with first:
            first.prepare(str(tmp_path))
            second.prepare(str(tmp_path))
        assert naps == [1, 1]
        with first_start() as _, (third := first_start()):
            third.prepare(str(tmp_path))
            assert len(started) == 2, "who has waited keeps nobody else waiting"


def test_nobody_waits_for_ever(started, monkeypatch, tmp_path):
    clock = iter(range(0, 10_000, 50))
    monkeypatch.setattr(compilation.time, "monotonic", lambda: next(clock))
    monkeypatch.setattr(compilation.time, "sleep", lambda _seconds: None)
    first, second = first_start(), first_start()
    with first, second:
        first.prepare(str(tmp_path))
        second.prepare(str(tmp_path))
    assert len(started) == 1


def test_a_folder_that_cannot_be_locked_keeps_nobody_from_compiling(started, tmp_path):
    (tmp_path / "file").write_text("")
    for folder in (None, str(tmp_path / "file")):
        start = first_start()
        with start:
            start.prepare(folder)
    assert len(started) == 2


def compiled_function(module: str):
    def add(a, b):
        return a + b

    add.__module__ = module
    return njit(add)


COVERAGE = """
import json, sys, numpy as np
from numba import njit
from numba.core.dispatcher import Dispatcher
import twc_env
from twc_env.exploration import compilation
from twc_env.slam import warm_up
from twc_env.world import misreading, world

compilation.core_count = lambda: 1  # nobody helps: what is counted is what the first step needs

for module in (misreading, world):  # what the world packs is not the engine's
    module.pack = njit(module.pack.py_func)

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
    assert len(before) > 10
    assert lacking == []


ROOT = Path(__file__).parents[2]
