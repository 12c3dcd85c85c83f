import gc
import importlib
import json
import logging
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest
from numba import njit
from numba.core.dispatcher import Dispatcher

from twc_env.exploration import compilation
from twc_env.exploration.compilation import Helper, _FirstCompilation, announce_compilation


def compiled(module: str):
    def add(a, b):
        return a + b

    add.__module__ = module
    return njit(add)(1, 2)


def test_the_first_kernel_of_this_package_that_is_compiled_is_announced_once(caplog):
    from numba.core import event

    listener = _FirstCompilation()
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
    listener, kernel = _FirstCompilation(), SimpleNamespace(data={"dispatcher": compiled_function("another.package")})
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
def helper(monkeypatch):
    started = []
    monkeypatch.setattr(
        compilation.subprocess, "Popen", lambda *a, **k: started.append(FakeProcess(*a, **k)) or started[-1]
    )
    monkeypatch.setattr(compilation, "core_count", lambda: 2)
    helper = Helper()
    helper.is_wanted = True
    return helper, started


def test_a_helper_is_called_when_everything_must_be_compiled_and_awaited_after_the_own_share(helper):
    helper, started = helper
    listener = _FirstCompilation(helper.start)

    class Event:
        data = {"dispatcher": compiled_function(compilation.FIRST_MODULE)}  # noqa: RUF012

    listener.on_start(Event)
    (process,) = started
    assert process.command[-1] == "twc_env.slam.warm_up"
    helper.join(lambda: process.events.append("own share"))
    helper.join(lambda: process.events.append("never"))
    assert process.events == ["own share", "waited"]


def test_the_first_module_has_kernels():
    module = importlib.import_module(compilation.FIRST_MODULE)
    assert any(isinstance(value, Dispatcher) for value in vars(module).values())


@pytest.mark.parametrize("lacking", ["engine", "core", "first module"])
def test_no_helper_is_called_without_need(helper, monkeypatch, lacking):
    helper, started = helper
    helper.is_wanted = lacking != "engine"
    monkeypatch.setattr(compilation, "core_count", lambda: 1 if lacking == "core" else 2)

    class Event:
        module = "twc_env.world.lidar" if lacking == "first module" else compilation.FIRST_MODULE
        data = {"dispatcher": compiled_function(module)}  # noqa: RUF012

    _FirstCompilation(helper.start).on_start(Event)
    assert not started


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
