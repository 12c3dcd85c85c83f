"""Step times along one very long episode in one building."""

from __future__ import annotations

import gc
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np

from twc_env.bench.rates import wander
from twc_env.config import EnvConfig
from twc_env.exploration.environment import ExplorationEnv
from twc_env.processes.process_memory import resident_mb

PARTS = 10


@dataclass(frozen=True, slots=True)
class Stretch:
    """A tenth of the episode."""

    steps: int
    """Since the start of the episode, at the end of the stretch; likewise the next four."""
    path_m: float
    """Summed over all robots."""
    keyframes: int
    """Keyframes that reached the mapper of robot 0 ..."""
    held: int
    """... and those that it still holds."""
    closures: int
    """Closures that it verified."""
    memory_mb: float
    """Memory of the process ..."""
    record_mb: float
    """... and the part of it that records each step for scoring: truth, odometry, contacts."""
    mean_ms: float
    """CPU time of a step; likewise the others."""
    median_ms: float
    p99_ms: float
    worst_ms: float


def bench_long(config: EnvConfig, report: Callable[[str], None] = lambda _line: None) -> list[Stretch]:
    """Run a team of Wanderers for `config.max_cycles` steps; `report` gets a line after each stretch."""
    env = ExplorationEnv(config=config)
    env.reset(seed=0)
    ends = {config.max_cycles * part // PARTS for part in range(1, PARTS + 1)}
    took_s: list[float] = []
    stretches: list[Stretch] = []
    with only_new_garbage():
        for step, actions in enumerate(wander(env, 0), start=1):
            began = time.process_time()
            env.step(actions)
            if env.agents:  # the last step also processes the whole backlog
                took_s.append(time.process_time() - began)
            if step in ends:
                stretches.append(_stretch(env, step, took_s))
                report(f"{step}/{config.max_cycles} steps, {stretches[-1].mean_ms:.2f} ms a step")
                took_s.clear()
    return stretches


@contextmanager
def only_new_garbage() -> Iterator[None]:
    """Limit garbage collection to objects that are created in this context.

    A collection over all objects of the loaded libraries takes longer than any step.
    """
    gc.collect()
    gc.freeze()
    try:
        yield
    finally:
        gc.unfreeze()


def _stretch(env: ExplorationEnv, steps: int, took_s: Sequence[float]) -> Stretch:
    record, mapper = env.episode.record, env.episode.engine.mapper_of(0)
    true = record.true_poses[:, :, :2]
    took_ms = 1e3 * np.array(took_s or [np.nan])
    return Stretch(
        steps,
        float(np.linalg.norm(np.diff(true, axis=0), axis=2).sum()),
        sum(len(mapper.keyframe_steps(robot)) for robot in range(true.shape[1])),
        len(mapper.nodes[0]),
        mapper.closures_verified,
        resident_mb(),
        record.bytes_held / 1e6,
        float(took_ms.mean()),
        *np.quantile(took_ms, (0.5, 0.99, 1.0)).tolist(),
    )
