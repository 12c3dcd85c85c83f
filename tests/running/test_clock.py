from types import SimpleNamespace

import pytest

from twc_env.kernels.compile_events import LOCK
from twc_env.running.clock import Clock


def test_the_clock_stands_still_while_numba_holds_its_lock_also_if_it_takes_it_twice(monkeypatch):
    event, passed = pytest.importorskip("numba.core.event"), SimpleNamespace(s=0.0)
    # a time of its own: other processes may keep this one, or numba's lock, waiting
    monkeypatch.setattr("twc_env.running.clock.time", SimpleNamespace(perf_counter=lambda: passed.s))
    with Clock() as clock:
        passed.s += 1.0
        assert clock.now_s() == 1.0
        with event.trigger_event(LOCK):
            passed.s += 2.0
            with event.trigger_event(LOCK):
                passed.s += 4.0
            passed.s += 8.0
        assert clock.now_s() == 1.0
        passed.s += 16.0
        assert clock.now_s() == 17.0
    with event.trigger_event(LOCK):
        passed.s += 32.0
    assert clock.now_s() == 49.0  # nobody tells it any more
