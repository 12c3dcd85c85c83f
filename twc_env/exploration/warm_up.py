"""Compile what an environment needs, the engine's kernels first: `python -m twc_env.exploration.warm_up`.

A first start calls this as its helper (`twc_env.exploration.compilation`).
"""

from __future__ import annotations

import gc
import os
from typing import Any

import numpy as np
from numba.core import event

from twc_env.exploration.compilation import FIRST_START, helpers_lock
from twc_env.exploration.environment import ExplorationEnv
from twc_env.slam import warm_up

MAP, ROBOTS, STEPS, SEED = "gen:office:100:1", 3, 1000, 1
"""An episode in which robots soon meet, so that places are recognised and maps merged."""


class _Orphan(event.Listener):
    """Ends this process where the one that called it is gone, before the next kernel is compiled."""

    def __init__(self) -> None:
        self._parent = os.getppid()

    def on_start(self, event: Any) -> None:
        """A compilation begins."""
        if os.getppid() != self._parent:
            os._exit(0)

    def on_end(self, event: Any) -> None:
        """A compilation ended."""


def play() -> None:
    """One whole episode in which robots go ahead and turn now and then."""
    env = ExplorationEnv(map=MAP, robots=ROBOTS, max_cycles=STEPS)
    random = np.random.default_rng(SEED)
    env.reset(seed=SEED)
    while env.agents:
        turns = random.uniform(-1, 1, len(env.agents))
        for _ in range(10):
            if env.agents:
                env.step({a: np.array([1.0, t], np.float32) for a, t in zip(env.agents, turns, strict=True)})


def main() -> None:
    """The engine's first steps, an episode, then what few of these need; nothing where another helper is at work."""
    FIRST_START.may_call = False
    lock = helpers_lock()
    if lock is not None and lock.take() is False:
        return
    event.register("numba:compile", _Orphan())
    gc.disable()  # of what numba makes nearly all lives until the end
    warm_up.main()
    play()
    warm_up.reject_false_closures()


if __name__ == "__main__":
    main()
