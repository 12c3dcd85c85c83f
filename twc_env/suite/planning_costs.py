"""What an episode of each scripted team costs, planning and environment apart."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import Any

from twc_env.config import EnvConfig, override
from twc_env.exploration.environment import ExplorationEnv
from twc_env.suite.player import UNSEEN, decided


def bench_teams(
    config: EnvConfig, teams: Sequence[str], episodes: int, report: Callable[[str], object]
) -> list[dict[str, Any]]:
    """Per team seconds of CPU time of an episode, mean over seeds 0, 1, ..., and its mean number of time steps.

    As in a benchmark, teams see no observations. A short episode before each loads the kernels.
    """
    rows = []
    for team in teams:
        _played(config, team, 0, 50)
        runs = [_played(config, team, seed, config.max_cycles) for seed in range(episodes)]
        planning_s, environment_s, steps = (sum(each) / episodes for each in zip(*runs, strict=True))
        rows.append({"team": team, "planning_s": planning_s, "environment_s": environment_s, "steps": steps})
        report(f"{team}: {planning_s:.2f} s planning, {environment_s:.2f} s environment")
    return rows


def _played(config: EnvConfig, team: str, seed: int, steps: int) -> tuple[float, float, int]:
    """CPU time [s] of the team's decisions and of the environment in an episode of at most so many steps; its steps."""
    from twc_env.agents.policy import begin, make_policy

    env, policy = ExplorationEnv(config=override(config, UNSEEN)), make_policy(team, config)
    env.reset(seed=seed)
    begin(policy, team, env, seed)
    planning_s, began_s = 0.0, time.process_time()
    while env.agents and env.episode.steps < steps:
        asked_s = time.process_time()
        actions = decided(env, policy)
        planning_s += time.process_time() - asked_s
        if actions is None:
            break
        env.step(actions)
    total_s, taken = time.process_time() - began_s, env.episode.steps
    env.close()
    return planning_s, total_s - planning_s, taken
