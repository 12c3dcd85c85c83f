"""The engine with missing or misleading input, against the same episodes without disturbance.

Episodes are those of `merging`: robots without a common frame walk through unseen buildings on partially overlapping
paths. Conditions: no signs are read; no WiFi is heard; no communication in the middle third of the episode; the last
robot fails half-way; the last robot's receiver reads 10 dB too high; every sign text occurs at two places or more;
laser scanners with 60 beams, with 5 cm of noise (`rough`), with 36 beams and 3 cm of noise (`cheap`); no scan matching
at all.

`pose_error_m` is the drift of robots since their last closure (root mean square along an axis), `pose_std_m` the
standard deviation that they reported for it; `heading_` likewise. `d_` columns are the mean difference to the
undisturbed run of the same building, with the standard deviation over buildings (`sd_`). `ate_m` aligns every group of
merged robots once. `lacked` lists what the engine's own report names in more episodes than normally (numbers as #).
"""

from __future__ import annotations

import argparse
import dataclasses
import math
import re
from collections import Counter
from functools import partial

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.exploration.environment import ExplorationEnv
from twc_env.maps import load_map
from twc_env.metrics import path_length_m
from twc_env.metrics.consistency import errors_since_closure
from twc_env.records.random_streams import random_stream
from twc_env.reproduce.runner import Runner, add_some
from twc_env.reproduce.twc.merging import STEPS_PER_M, begin_episode, first_buildings, overlapping_ways, step_walkers
from twc_env.running.options import count, natural
from twc_env.world.building.floorplan import Floorplan

CHOOSES = ("buildings", "conditions")
CONDITIONS = (
    "normal", "no signs", "no WiFi", "link cut", "robot lost", "odd device", "repeated names", "60 beams",
    "rough laser", "cheap laser", "no laser",
)  # fmt: skip
CRUISE_STEPS_PER_M = 14.0
"""Approximate steps of a walker per metre, for the times of failures."""
LACKS_SHOWN = 3
SAMPLE_STEPS = 10
"""Steps between two samples of pose errors and standard deviations."""
FIGURES = {"merged": "merged_share", "ate": "ate_m", "coverage": "coverage_correct"}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of this table."""
    parser.add_argument("--buildings", type=count, default=10, help="number of test-split buildings")
    parser.add_argument("--robots", type=count, default=3, help="number of robots")
    parser.add_argument("--seed", type=natural, default=0, help="noise seed")
    add_some(parser, "--conditions", CONDITIONS, "conditions")


def rows(options: argparse.Namespace, runner: Runner) -> list[dict]:
    """One row per condition; the normal run is always among them."""
    conditions = list(dict.fromkeys(["normal", *options.conditions]))
    play = partial(episode, options.robots, options.seed)
    runs = runner.grid(conditions, first_buildings(options.buildings), play, what="building")
    return [_row(condition, runs[condition], runs["normal"]) for condition in conditions]


def episode(robots: int, seed: int, condition: str, building: str) -> dict:
    """One building under one condition."""
    plan = load_map(building)
    ways = overlapping_ways(plan, robots)
    longest_m = max(path_length_m(way) for way in ways)
    changes = settings(condition, int(longest_m * CRUISE_STEPS_PER_M))
    if condition == "repeated names":
        plan = with_repeated_names(plan)
    base = {"map": building, "robots": robots, "max_cycles": int(longest_m * STEPS_PER_M) + 50}
    env = ExplorationEnv(config={**base, **changes}, floorplan=plan)
    walkers = begin_episode(env, ways, seed)
    lost = changes.get("failure.robots", 0)
    samples = []
    while env.agents and not all(walker.is_done for walker in walkers[: robots - lost]):
        step_walkers(env, walkers)
        if env.episode.steps % SAMPLE_STEPS == 0:
            samples.append(_sample(env))
    errors, stds = errors_since_closure(*(np.array(values) for values in zip(*samples, strict=True)))
    env.engine.finish()
    figures = env.result().figures
    return {
        "merged_share": figures["merged_robots"] / robots,
        "wrong_merges": figures["wrong_merges"],
        "ate_m": figures["team_ate_m"],
        "coverage_correct": figures["coverage_correct"],
        "lacked": figures["lacked"],
        "ways": len(errors),
        "error_squared": np.square(errors).sum(axis=0).tolist(),
        "std_squared": np.square(stds).sum(axis=0).tolist(),
    }


def _sample(env: ExplorationEnv) -> tuple[Array, Array, Array, list[float], list[int]]:
    """Of all robots: estimated and true poses, standard deviations, path since the last closure, version of the map."""
    beliefs = [env.belief(agent) for agent in env.possible_agents]
    return (
        np.array([belief.pose_map_robot for belief in beliefs]),
        env.episode.world.poses.copy(),
        np.array([belief.pose_std for belief in beliefs]),
        [belief.since_closure_m for belief in beliefs],
        [belief.map_version for belief in beliefs],
    )


def settings(condition: str, steps: int) -> dict:
    """Settings of a condition in an episode of about this many steps."""
    changes: dict[str, dict] = {
        "no signs": {"signs.range_max_m": 0.1},
        "no WiFi": {"radio.wifi": False},
        "link cut": {"failure.link_begin_step": steps // 3, "failure.link_end_step": 2 * steps // 3},
        "robot lost": {"failure.robots": 1, "failure.robots_step": steps // 2},
        "odd device": {"failure.device_offset_db": 10.0},
        "60 beams": {"lidar.beam_count": 60},
        "rough laser": {"lidar.range_noise_std_m": 0.05},
        "cheap laser": {"lidar.beam_count": 36, "lidar.range_noise_std_m": 0.03},
        "no laser": {"slam.cues.lidar": False},
    }
    return changes.get(condition, {})


def with_repeated_names(plan: Floorplan) -> Floorplan:
    """The plan with half as many sign texts, each at two or more random signs."""
    names = sorted({sign.text for sign in plan.signs})
    kept = names[: max(len(names) // 2, 1)]
    order = random_stream(0, "repeated names " + plan.name).permutation(len(plan.signs))
    signs = tuple(
        dataclasses.replace(sign, text=kept[int(place) % len(kept)])
        for sign, place in zip(plan.signs, order, strict=True)
    )
    return dataclasses.replace(plan, signs=signs)


def _row(condition: str, runs: list[dict], normal: list[dict]) -> dict:
    row: dict = {"condition": condition, "episodes": len(runs)}
    for key in ("merged_share", "ate_m", "coverage_correct"):
        row[key] = round(float(np.mean([run[key] for run in runs])), 4)
    row["wrong_merges"] = sum(run["wrong_merges"] for run in runs)
    row |= _uncertainty(runs)
    row["ate_worst_m"] = round(max(run["ate_m"] for run in runs), 4)
    for name, key in FIGURES.items():
        difference = np.array([run[key] - other[key] for run, other in zip(runs, normal, strict=True)])
        row[f"d_{name}"], row[f"sd_{name}"] = round(float(difference.mean()), 4), round(float(difference.std()), 4)
    here, there = (
        Counter(k for run in group for k in {_kind(line) for line in run["lacked"]}) for group in (runs, normal)
    )
    new = sorted(here, key=lambda kind: (there[kind] - here[kind], kind))[:LACKS_SHOWN]
    row["lacked"] = "; ".join(f"{kind} ({here[kind]} of {len(runs)}, normally {there[kind]})" for kind in new)
    return row


def _uncertainty(runs: list[dict]) -> dict:
    """Root mean squares of errors and reported standard deviations over all motions since a closure."""
    ways = max(sum(run["ways"] for run in runs), 1)
    out = {}
    for name in ("error", "std"):
        x, y, heading = np.sum([run[f"{name}_squared"] for run in runs], axis=0) / ways
        out[f"pose_{name}_m"] = round(math.sqrt(0.5 * (x + y)), 4)
        out[f"heading_{name}_deg"] = round(math.degrees(math.sqrt(heading)), 3)
    return out


def _kind(line: str) -> str:
    """A line of the engine's report without its numbers, for counting over episodes."""
    line = line.partition(": ")[0] if line.startswith("candidates refused") else line
    return re.sub(r"[+-]?\d+(\.\d+)?", "#", line)
