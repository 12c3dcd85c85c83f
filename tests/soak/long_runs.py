"""Long runs with a new building in every episode and memory monitoring: `twc-env soak`."""

from __future__ import annotations

import gc
import time
from collections.abc import Callable
from typing import Any

import numpy as np

from twc_env.bench.rates import wander
from twc_env.config import EnvConfig, override
from twc_env.exploration.environment import ExplorationEnv
from twc_env.running.process_memory import resident_mb

WARM_UP_SHARE = 0.3
"""Share of all steps in which caches of buildings fill; memory growth is measured after it."""
EPISODE_STEPS = 500


def soak(
    steps: int,
    seed: int = 0,
    config: EnvConfig | None = None,
    report: Callable[[str, bool], None] = lambda line, is_last: None,
) -> dict:
    """Run `steps` time steps in buildings of the training split; returns memory before and after, and counts.

    An exception is re-raised with the seed of its episode in its notes.
    """
    config = override(config or EnvConfig(), {"max_cycles": EPISODE_STEPS})
    env = ExplorationEnv(config=config)
    done, episode, began = 0, seed, time.perf_counter()
    rows: list[tuple[int, float]] = []
    buildings: set[str] = set()
    while done < steps:
        try:
            done += _episode(env, episode)
        except Exception as error:
            error.add_note(f"in the episode of seed {episode}, split train: {env.floorplan.name}")
            raise
        buildings.add(env.floorplan.name)
        episode += 1
        gc.collect()
        rows.append((done, resident_mb()))
        took_s = time.perf_counter() - began
        report(f"{done}/{steps} steps, {len(buildings)} buildings, {rows[-1][1]:.0f} MB, {took_s:.0f} s", done >= steps)
    return _figures(rows, len(buildings), episode - seed, time.perf_counter() - began)


def _episode(env: ExplorationEnv, seed: int) -> int:
    observations, _ = env.reset(seed, {"split": "train"})
    for actions in wander(env, seed):
        observations, rewards, *_ = env.step(actions)
    assert all(np.isfinite(list(rewards.values())))
    assert all(env.observation_space(agent).contains(o) for agent, o in observations.items())
    return env.config.max_cycles


def _figures(rows: list[tuple[int, float]], buildings: int, episodes: int, seconds: float) -> dict[str, Any]:
    warm = [mb for done, mb in rows if done >= WARM_UP_SHARE * rows[-1][0]]
    late = max(1, len(warm) // 4)
    return {
        "steps": rows[-1][0],
        "episodes": episodes,
        "buildings": buildings,
        "memory_after_warm_up_mb": float(np.median(warm[:late])),
        "memory_at_end_mb": float(np.median(warm[-late:])),
        "memory_growth_mb": float(np.median(warm[-late:]) - np.median(warm[:late])),
        "memory_peak_mb": max(mb for _, mb in rows),
        "steps_per_s": rows[-1][0] / seconds,
    }
