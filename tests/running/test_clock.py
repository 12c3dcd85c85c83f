import time

import pytest

from twc_env.kernels.compile_events import LOCK
from twc_env.running.clock import Clock

NAP_S = 0.05


def test_the_clock_stands_still_while_numba_holds_its_lock_also_if_it_takes_it_twice():
    event = pytest.importorskip("numba.core.event")
    with Clock() as clock:
        begin_s = clock.now_s()
        with event.trigger_event(LOCK):
            time.sleep(NAP_S)
            with event.trigger_event(LOCK):
                time.sleep(NAP_S)
        assert clock.now_s() - begin_s < NAP_S
        time.sleep(NAP_S)
        assert clock.now_s() - begin_s >= NAP_S
    held_s = clock.now_s()
    with event.trigger_event(LOCK):
        time.sleep(NAP_S)
    assert clock.now_s() - held_s >= NAP_S  # nobody tells it any more
