"""Mixed teams that explore the twins of TWC-SLAM's scenes: whether they end in one map, and how exact it is.

Each robot has its own platform, size, speed, drift and scanner (`twc_env.config.TEAM_PRESETS`); `twc-slam` is the
paper's own team. It explores as in the table `reality`, with a seed for starts and noise. `merged_share` is the share
of seeds in which all robots share one map at the end, `wrong` the number of pairs of robots that shared a map at any
time although their own paths place it more than 1 m or 10 degrees apart, summed over the seeds; `ate_m` and
`coverage_correct` are means over the seeds, `ate_max_m` is the worst.
"""

from __future__ import annotations

import argparse

import numpy as np

from twc_env.config import TEAM_PRESETS, EnvConfig, override
from twc_env.reproduce.runner import Runner, add_seeds, add_some
from twc_env.reproduce.twc.reality import episode
from twc_env.running.options import count

CHOOSES = ("seeds", "buildings")
BUILDINGS = "twin-01", "twin-02"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of this table."""
    add_seeds(parser, "10", "seeds of starts and noise")
    add_some(parser, "--buildings", BUILDINGS, "buildings")
    teams = f"{', '.join(TEAM_PRESETS)}, or robots such as handheld,wheeled,legged"
    parser.add_argument("--team", default="twc-slam", help=f"the team: {teams}")
    parser.add_argument("--steps", type=count, default=1500, help="maximum steps per episode")


def rows(options: argparse.Namespace, runner: Runner) -> list[dict]:
    """One row per building."""
    robots = override(EnvConfig(), {"team": options.team}).robots

    def explored(building: str, seed: int) -> dict:
        return episode({"map": building, "team": options.team}, seed, 0, robots, options.steps)

    episodes = runner.grid(options.buildings, options.seeds, explored)
    return [_row(building, found, robots) for building, found in episodes.items()]


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
