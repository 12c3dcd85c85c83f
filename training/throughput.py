"""How many decisions a training of `mappo` makes, and where its time goes."""

from __future__ import annotations

import time
from contextlib import closing

import torch
from twc_env.training.mappo import Learner, Rollouts, Settings
from twc_env.training.run_folder import Task

from twc_env.processes.process_memory import peak_mb


def throughput(task: Task, updates: int, settings: Settings, ray: str | None = None) -> dict[str, float]:
    """Collect and learn for some updates, after one that loads kernels and reaches all parts.

    Returns decisions per second, and shares of environments, inference and update. With one process also decisions and
    robots' time steps per second of CPU time, which depends less on what else the machine does, and memory [MB]; the
    shares are those of CPU time then. ray: address of a Ray cluster whose workers play.
    """
    torch.set_num_threads(1)  # as in training
    is_alone = ray is None and settings.workers <= 1
    with closing(Rollouts(task, settings, ray)) as rollouts:
        learner = Learner(rollouts.space, settings, task.config.dynamics.time_step_s)
        rollouts.begin()
        rollouts.clock = time.process_time if is_alone else time.perf_counter
        _play(rollouts, learner, range(1))
        began_s = time.perf_counter()
        parts, decisions, time_steps = _play(rollouts, learner, range(1, updates + 1))
        wall_s, total_s = time.perf_counter() - began_s, sum(parts.values())
    figures = {"decisions_per_s": decisions / wall_s}
    if is_alone:
        figures |= {
            "decisions_per_cpu_s": decisions / total_s, "robot_steps_per_cpu_s": time_steps / total_s,
            "memory_mb": peak_mb(),
        }  # fmt: skip
    return figures | {f"{name}_share": part_s / total_s for name, part_s in parts.items()}


def _play(rollouts: Rollouts, learner: Learner, updates: range) -> tuple[dict[str, float], int, int]:
    """Seconds by part, decisions, and their time steps."""
    parts, decisions, time_steps = dict.fromkeys(("environments", "inference", "update"), 0.0), 0, 0
    for update in updates:
        began = rollouts.clock()
        sequences, _ = rollouts.collect(learner.logits, update)
        between = rollouts.clock()
        learner.learn(sequences, rollouts.lasting(), update, 1.0)
        parts["inference"] += rollouts.inferred_s
        parts["environments"] += between - began - rollouts.inferred_s
        parts["update"] += rollouts.clock() - between
        done = [each for own in sequences for each in own]
        decisions, time_steps = decisions + len(done), time_steps + sum(each.time_steps for each in done)
    return parts, decisions, time_steps
