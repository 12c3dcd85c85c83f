"""Compile the kernels of an environment, so that later processes on this machine read them from disk."""

from __future__ import annotations

import numpy as np

from twc_env.exploration.environment import ExplorationEnv
from twc_env.kernels import compilation
from twc_env.slam import warm_up

MAP, ROBOTS, STEPS, SEED = "gen:office:100:1", 3, 1000, 1
"""An episode in which robots meet early, so that places are recognised and maps are merged."""


def compile_all(total: int = compilation.EPISODE) -> int:
    """Compile for an episode and rare events of the engine; the number of functions compiled (0: all were there).
    `total` is the length of the bar."""
    announcer = compilation.announcer()
    announcer.total = total
    before = announcer.count
    warm_up.main()
    play()
    warm_up.reject_false_closures()
    return announcer.count - before


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
    env.result()
