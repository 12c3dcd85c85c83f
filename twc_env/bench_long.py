"""One very long episode in one building: does a step take longer, the further the robots have gone?"""

from __future__ import annotations

import gc
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np

from twc_env.bench import wander
from twc_env.config import EnvConfig
from twc_env.exploration.environment import ExplorationEnv
from twc_env.process_memory import resident_mb

PARTS = 10


@dataclass(frozen=True, slots=True)
class Stretch:
    """A tenth of the episode."""

    steps: int
    """Since the episode began, at its end; so too the next four."""
    path_m: float
    """Of all robots together."""
    keyframes: int
    """That reached the mapper of robot 0 ..."""
    held: int
    """... and were not forgotten."""
    closures: int
    """Verified by it."""
    memory_mb: float
    """Of the whole process ..."""
    record_mb: float
    """... and of that what is noted of each step to judge the episode by: truth, odometry, contacts."""
    mean_ms: float
    """Processor time of a step; so too the others."""
    median_ms: float
    p99_ms: float
    worst_ms: float


def bench_long(config: EnvConfig, report: Callable[[str], None] = lambda _line: None) -> list[Stretch]:
    """Let a team wander for all of `config.max_cycles` steps; `report` gets a line after each stretch."""
    env = ExplorationEnv(config=config)
    env.reset(seed=0)
    ends = {config.max_cycles * part // PARTS for part in range(1, PARTS + 1)}
    took_s: list[float] = []
    stretches: list[Stretch] = []
    with only_new_garbage():
        for step, actions in enumerate(wander(env, 0), start=1):
            began = time.process_time()
            env.step(actions)
            if env.agents:  # the last step works off what still waits, which no other has to
                took_s.append(time.process_time() - began)
            if step in ends:
                stretches.append(_stretch(env, step, took_s))
                report(f"{step}/{config.max_cycles} steps, {stretches[-1].mean_ms:.2f} ms a step")
                took_s.clear()
    return stretches


@contextmanager
def only_new_garbage() -> Iterator[None]:
    """Python looks for garbage among what is made from now on.

    To look through all that libraries made when they were loaded, too, takes longer than any step, every now and then.
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
