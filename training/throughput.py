"""How many decisions a training of `mappo` makes, and where its time goes."""

from __future__ import annotations

import time

import torch
from twc_env.training.mappo import Learner, Rollouts, Settings
from twc_env.training.run_folder import Task

from twc_env.running.process_memory import peak_mb


def throughput(task: Task, updates: int, settings: Settings) -> dict[str, float]:
    """Collect and learn for some updates in one process, after one that loads kernels and reaches all parts.

    Returns decisions per second of CPU time, which depends less on what else the machine does than wall time; the
    shares of environments, inference and update in it; time steps per second; and memory [MB].
    """
    torch.set_num_threads(1)  # as in training
    clock, inferred_s, rollouts = time.process_time, 0.0, Rollouts(task, settings)
    learner = Learner(rollouts.space, settings, task.config.dynamics.time_step_s)

    def policy(seen: dict) -> object:
        nonlocal inferred_s
        began = clock()
        logits = learner.logits(seen)
        inferred_s += clock() - began
        return logits

    decisions = time_steps = 0
    collected_s = learnt_s = 0.0
    try:
        rollouts.begin()
        for update in range(-1, updates):
            began, inferred_s_before = clock(), inferred_s
            sequences, _ = rollouts.collect(policy, update + 1)
            between = clock()
            learner.learn(sequences, rollouts.lasting(), update + 1, 1.0)
            if update < 0:
                inferred_s = 0.0
                continue
            collected_s += between - began - (inferred_s - inferred_s_before)
            learnt_s += clock() - between
            done = [each for own in sequences for each in own]
            decisions, time_steps = decisions + len(done), time_steps + sum(each.time_steps for each in done)
    finally:
        rollouts.close()
    total_s = collected_s + inferred_s + learnt_s
    return {
        "decisions_per_cpu_s": decisions / total_s,
        "robot_steps_per_cpu_s": time_steps / total_s,
        "environments_share": collected_s / total_s,
        "inference_share": inferred_s / total_s,
        "update_share": learnt_s / total_s,
        "memory_mb": peak_mb(),
    }
