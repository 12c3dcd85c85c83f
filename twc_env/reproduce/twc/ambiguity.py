"""Merging where the evidence is ambiguous: the engine must abstain rather than merge wrongly.

Teams that drive to the nearest frontier (`--agent`) in buildings of several kinds, from random starts without a common
frame. `--split validation` has other buildings, on which the engine's tests were chosen.

- corridor: bare, 40 to 160 m long, 1.2 to 3 m wide: nothing but its ends tells places apart
- laser: 400 m2 of all kinds; laser scans are the only cue: no signs, no WiFi
- wings: the same rooms with the same signs again and again, and nothing else (`alike_wings`)
- wings, WiFi: the same with one access point per wing
- bare: offices and warehouses of 1,500 m2 without signs, three tenths of the access points (`twc/ExploreBare-v1`)
- degraded: 2,000 m2; 5 m scanners of 72 beams with 3 cm of noise, a tenth lost, glass, skid-steer odometry
- radio: 800 m2 without scan matching (`twc/ExploreRadio-v1`)
- mall: eight robots in 5,000 m2 (`twc/ExploreMall-v1`)

`right`: teams that share one map at the end and never held a wrong one. `wrong`: teams in which at any time two robots
shared a map that their own paths place more than 1 m or 10 degrees apart; `wrong_at_end` those in which they still do.
`wrong_share_at_most` is the upper end of its 95 % interval (`metrics.shares`).
`abstained`: all others, whose robots stay in several maps, each of them right. `merged_share` is the mean share of the
robots in the largest map at the end, `undone` the number of merges that the engine undid.
"""

from __future__ import annotations

import argparse
from functools import partial

import numpy as np

from twc_env.config import EnvConfig, override
from twc_env.exploration.environment import ExplorationEnv
from twc_env.metrics.shares import share_interval
from twc_env.records.random_streams import random_stream
from twc_env.reproduce.runner import Runner, add_some
from twc_env.reproduce.twc.alike_wings import alike_wings
from twc_env.reproduce.twc.bare_places import Corridor
from twc_env.running.options import count, natural
from twc_env.suite.player import drive
from twc_env.tasks import task_config
from twc_env.world.building.floorplan import Floorplan
from twc_env.world.building.splits import split_names

PACKAGES = ("twc_env.agents",)
CHOOSES = ("teams", "kinds")
CORRIDOR_WIDTHS_M, CORRIDOR_LENGTHS_M = (1.2, 2.0, 3.0), (40.0, 160.0)
FAMILIES = {
    "laser": "gen:office+ring+ward+mall+warehouse:400",
    "bare": "gen:office+warehouse:1500",
    "degraded": "gen:office+ward+ring:2000",
    "radio": "gen:office+ward+ring:800",
    "mall": "gen:mall:5000",
}
"""The families of the generated buildings."""
TASKS = {"bare": "twc/ExploreBare-v1", "radio": "twc/ExploreRadio-v1", "mall": "twc/ExploreMall-v1"}
"""The kinds that have the settings of a task."""
SETTINGS: dict[str, dict] = {
    "corridor": {"max_cycles": 2000},
    "laser": {"max_cycles": 1500, "slam.cues.text": False, "slam.cues.wifi": False},
    "wings": {"max_cycles": 1500},
    "wings, WiFi": {"max_cycles": 1500},
    "degraded": {
        "robots": 4,
        "max_cycles": 2000,
        "lidar.range_max_m": 5.0,
        "lidar.beam_count": 72,
        "lidar.range_noise_std_m": 0.03,
        "lidar.dropout_probability": 0.1,
        "lidar.glass_return_probability": 0.3,
        "odometry.platform": "skid-steer",
    },
}
"""The settings of the others."""
KINDS = (*SETTINGS, *TASKS)
SEEDS = {"validation": 4_000_000, "test": 5_000_000, "fresh": 7_000_000}
"""Added to the number of a team for the seeds of corridors and wings, which have no splits of their own."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of this table."""
    parser.add_argument("--teams", type=count, default=8, help="number of teams of each kind, in as many buildings")
    parser.add_argument("--first", type=natural, default=0, help="number of the first building in its split")
    parser.add_argument("--split", choices=tuple(SEEDS), default="test", help="which buildings")
    parser.add_argument("--agent", default="nearest-frontier", help="the scripted team")
    parser.add_argument("--jobs", type=count, default=2, help="number of worker processes")
    add_some(parser, "--kinds", KINDS, "kinds")


def rows(options: argparse.Namespace, runner: Runner) -> list[dict]:
    """One row per kind, and one for all together."""
    numbers = range(options.first, options.first + options.teams)
    for kind in options.kinds:
        building(kind, options.split, numbers[-1])  # too many of them fail before the first episode
    found = runner.grid(options.kinds, numbers, partial(episode, options.split, options.agent), options.jobs)
    every = [run for runs in found.values() for run in runs]
    return [*(_row(kind, runs) for kind, runs in found.items()), _row("all", every)]


def building(kind: str, split: str, number: int) -> tuple[EnvConfig, Floorplan | None]:
    """The settings of a team of one kind, and its building unless they name it."""
    if kind in FAMILIES:
        config = task_config(TASKS[kind]) if kind in TASKS else override(EnvConfig(), SETTINGS[kind])
        name = f"{FAMILIES[kind]}:{split}/{number:04d}"
        if number >= len(split_names(split, FAMILIES[kind])):
            name = f"{FAMILIES[kind]}:{SEEDS[split] + number}"
        return override(config, {"map": name}), None
    config, seed = override(EnvConfig(), SETTINGS[kind]), SEEDS[split] + number
    if kind == "corridor":
        draw = random_stream(seed, "bare corridor")
        width_m = CORRIDOR_WIDTHS_M[int(draw.integers(len(CORRIDOR_WIDTHS_M)))]
        return config, Corridor(round(float(draw.uniform(*CORRIDOR_LENGTHS_M)), 1), width_m).plan()
    return config, alike_wings(seed, has_wifi=kind == "wings, WiFi")


def episode(split: str, agent: str, kind: str, number: int) -> dict:
    """One team."""
    return team_figures(*building(kind, split, number), agent, number)


def team_figures(config: EnvConfig, plan: Floorplan | None, agent: str, seed: int) -> dict:
    """What became of the maps of one team. plan: None for the building that the settings name."""
    env = ExplorationEnv(config=config, floorplan=plan)
    drive(env, agent, seed)
    figures = env.result().figures
    wrong_now = sum(len(score.wrong_pairs) for score in env.episode.map_scores())
    undone = sum(mapper.merges_undone for mapper in env.engine.mappers)
    env.close()
    return {
        "robots": config.robots,
        "merged": figures["merged_robots"],
        "wrong_pairs": figures["wrong_merges"],
        "wrong_pairs_at_end": wrong_now,
        "undone": undone,
        "ate_m": figures["team_ate_m"],
        "odometry_ate_m": figures["odometry_ate_m"],
        "wall_iou": figures["wall_iou"],
    }


def _row(kind: str, runs: list[dict]) -> dict:
    wrong = sum(run["wrong_pairs"] > 0 for run in runs)
    right = sum(run["wrong_pairs"] == 0 and run["merged"] == run["robots"] for run in runs)
    return {
        "kind": kind,
        "teams": len(runs),
        "merged_share": round(float(np.mean([run["merged"] / run["robots"] for run in runs])), 3),
        "right": right,
        "wrong": wrong,
        "wrong_share_at_most": round(share_interval(wrong, len(runs))[1], 3),
        "abstained": len(runs) - right - wrong,
        "wrong_at_end": sum(run["wrong_pairs_at_end"] > 0 for run in runs),
        "wrong_pairs": sum(run["wrong_pairs"] for run in runs),
        "undone": sum(run["undone"] for run in runs),
        "ate_m": round(float(np.mean([run["ate_m"] for run in runs])), 4),
    }
