"""Compile the kernels of an environment, the engine's first: `twc-env.exploration.warm_up`.

This is the helper process of a first start (`twc_env.exploration.compilation`).
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
"""An episode in which robots meet early, so that places are recognised and maps are merged."""


class _Orphan(event.Listener):
    """Ends this process before it compiles another kernel if the process that started it has ended."""

    def __init__(self) -> None:
        self._parent = os.getppid()

    def on_start(self, event: Any) -> None:
        """Called by numba at the start of a compilation."""
        if os.getppid() != self._parent:
            os._exit(0)

    def on_end(self, event: Any) -> None:
        """Called by numba at the end of a compilation."""


def play() -> None:
    """Run one episode: robots drive ahead at full speed, with a new random turn rate every 10 steps."""
    env = ExplorationEnv(map=MAP, robots=ROBOTS, max_cycles=STEPS)
    random = np.random.default_rng(SEED)
    env.reset(seed=SEED)
    while env.agents:
        turns = random.uniform(-1, 1, len(env.agents))
        for _ in range(10):
            if env.agents:
                env.step({a: np.array([1.0, t], np.float32) for a, t in zip(env.agents, turns, strict=True)})


def main() -> None:
    """Compile for the engine's first steps, an episode, and rare events; do nothing if another helper is running."""
    FIRST_START.may_call = False
    lock = helpers_lock()
    if lock is not None and lock.take() is False:
        return
    event.register("numba:compile", _Orphan())
    gc.disable()  # nearly all objects that numba creates live until the end
    warm_up.main()
    play()
    warm_up.reject_false_closures()


if __name__ == "__main__":
    main()
