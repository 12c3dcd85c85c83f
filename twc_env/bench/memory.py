"""Memory of an environment of each task of a suite."""

from __future__ import annotations

import gc
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from typing import Any

import numpy as np

from twc_env.config import EnvConfig, override
from twc_env.exploration.environment import ExplorationEnv
from twc_env.processes.process_memory import resident_mb
from twc_env.tasks import task_config

CHOICES: dict[str, object] = {
    "action.kind": "frontier", "action.timing": "asynchronous", "observation.frontier_period_s": 60.0
}  # fmt: skip
ENVIRONMENTS = 3


def bench_memory(tasks: Sequence[str], report: Callable[[str], object]) -> list[dict[str, Any]]:
    """Per task the growth of resident memory per environment [MB], while `ENVIRONMENTS` of them are near the end of an
    episode of random choices, beside one that has loaded kernels. Each task is measured in a process of its own."""
    rows = []
    with ProcessPoolExecutor(1, get_context("spawn"), max_tasks_per_child=1) as pool:
        for task in tasks:
            rows.append({"task": task, "mb_per_environment": pool.submit(_growth_mb, task_config(task)).result()})
            report(f"{task}: {rows[-1]['mb_per_environment']:.1f} MB")
    return rows


def _growth_mb(config: EnvConfig) -> float:
    chosen = override(config, CHOICES)
    return growth_mb(lambda seed: _played(chosen, seed), ENVIRONMENTS)


def growth_mb(made: Callable[[int], object], number: int) -> float:
    """Growth of resident memory [MB] by each of the objects made of 1, 2, ..., while all of them and that of 0 live."""
    held = [made(0)]
    gc.collect()
    before = resident_mb()
    held += [made(k) for k in range(1, 1 + number)]
    gc.collect()
    return (resident_mb() - before) / number


def _played(config: EnvConfig, seed: int) -> ExplorationEnv:
    """An environment near the end of the episode of a seed."""
    env, random = ExplorationEnv(config=config), np.random.default_rng(seed)
    seen, _ = env.reset(seed)
    gone = 0
    while env.agents and gone < 0.9 * config.max_cycles:
        choices = {agent: int(random.choice(np.flatnonzero(o["action_mask"]))) for agent, o in seen.items()}
        seen, _, _, _, infos = env.step(choices)
        gone += infos["robot_0"]["time_steps"]
    return env
