"""Mixed teams that explore the twins of TWC-SLAM's scenes: whether they end in one map, and how exact it is.

Each robot has its own platform, size, speed, drift and scanner (`twc_env.config.TEAM_PRESETS`); `twc-slam` is the
paper's own team. Each robot drives to the nearest frontier, or to the next one after a decision that did not move it,
until the whole team shares one map without frontiers or the steps are over; the seed is that of starts and noise.
`merged_share` is the share of seeds in which all robots share one map at the end, `wrong` the number of pairs of robots
that shared a map at any time although their own paths place it more than 1 m or 10 degrees apart, summed over the
seeds; `ate_m` and `coverage_correct` are means over the seeds, `ate_max_m` is the worst.
"""

from __future__ import annotations

import argparse
import time

import numpy as np

from twc_env.config import TEAM_PRESETS, EnvConfig, override
from twc_env.exploration.environment import ExplorationEnv
from twc_env.reproduce.runner import Runner, add_seeds, add_some
from twc_env.running.options import count

CHOOSES = ("seeds", "buildings")
BUILDINGS = "twin-01", "twin-02"
MOVED_M = 0.3
"""A robot that a decision moved less than this chooses another goal next."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of this table."""
    add_seeds(parser, "0-9", "seeds of starts and noise")
    add_some(parser, "--buildings", BUILDINGS, "buildings")
    teams = f"{', '.join(TEAM_PRESETS)}, or robots such as handheld,wheeled,legged"
    parser.add_argument("--team", default="twc-slam", help=f"the team: {teams}")
    parser.add_argument("--steps", type=count, default=1500, help="maximum steps per episode")


def rows(options: argparse.Namespace, runner: Runner) -> list[dict]:
    """One row per building."""
    robots = override(EnvConfig(), {"team": options.team}).robots

    def explored(building: str, seed: int) -> dict:
        return _episode({"map": building, "team": options.team, "max_cycles": options.steps}, seed, robots)

    episodes = runner.grid(options.buildings, options.seeds, explored)
    return [_row(building, found, robots) for building, found in episodes.items()]


def _episode(settings: dict, seed: int, robots: int) -> dict:
    env = ExplorationEnv(config={"action.kind": "frontier", **settings})
    observations, _ = env.reset(seed=seed)
    begun, idle, tries, before = time.perf_counter(), 0, np.zeros(robots, int), np.full((robots, 2), np.inf)
    while env.agents and idle < 2:
        masks = [observations[agent]["action_mask"] for agent in env.agents]
        here = np.array([env.belief(agent).pose_odom[:2] for agent in env.agents])
        tries, before = np.where(np.hypot(*(here - before).T) < MOVED_M, tries + 1, 0), here
        has_frontier = any(mask[: env.config.action.frontier_slots].any() for mask in masks)
        is_merged = all(len(env.belief(agent).teammates) == robots - 1 for agent in env.agents)
        idle = idle + 1 if is_merged and not has_frontier else 0
        choices = [np.flatnonzero(mask) for mask in masks]  # frontiers first, the nearest one before the others
        goals = [int(valid[k % len(valid)]) for valid, k in zip(choices, tries.tolist(), strict=True)]
        observations, *_ = env.step(dict(zip(env.agents, goals, strict=True)))
    took_s, figures = time.perf_counter() - begun, env.result().figures
    return {
        "merged": figures["merged_robots"],
        "wrong_merges": figures["wrong_merges"],
        "ate_m": figures["team_ate_m"],
        "coverage_correct": figures["coverage_correct"],
        "steps_per_s": figures["steps"] / took_s,
    }


def _row(building: str, episodes: list[dict], robots: int) -> dict:
    errors_m = [found["ate_m"] for found in episodes]
    return {
        "building": building,
        "seeds": len(episodes),
        "merged_share": float(np.mean([found["merged"] == robots for found in episodes])),
        "wrong": sum(found["wrong_merges"] for found in episodes),
        "ate_m": round(float(np.mean(errors_m)), 4),
        "ate_max_m": round(max(errors_m), 4),
        "coverage_correct": round(float(np.mean([found["coverage_correct"] for found in episodes])), 4),
        "steps_per_s": round(float(np.mean([found["steps_per_s"] for found in episodes])), 1),
    }
