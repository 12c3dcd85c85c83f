"""Long runs over all tasks, effects and kinds of action, with the memory, step time and open files of the process.

Every combination of task, effect and kind of action is played once before one is played again (`combination`).
"""

from __future__ import annotations

import gc
import multiprocessing
import os
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from tests.soak.attempts import append_row, kept_rows
from tests.soak.observation_check import ACTIONS, random_actions
from twc_env.bench.rates import wander
from twc_env.config import EnvConfig, override
from twc_env.config.lidar_presets import LIDAR_PRESETS
from twc_env.datasets.lasting_maps import save_map
from twc_env.errors import ConfigError
from twc_env.exploration.environment import ExplorationEnv
from twc_env.processes.process_memory import resident_mb
from twc_env.tasks import TASKS, task_config
from twc_env.vector.teams import VectorTeams

EPISODE_STEPS = 500
WARM_UP_SHARE = 0.3
"""Share of a process's episodes in which caches of buildings fill; memory growth is measured after it."""
COLLECTED_EVERY = 10
"""After one episode in so many, reference cycles are looked for: that takes as long as a tenth of an episode."""
WORKERS_EVERY, WORKER_STEPS = 50, 10
"""One episode in so many is also begun in two worker processes, which must be gone afterwards."""
MIXED = ("handheld", "wheeled", "legged", "turtlebot-burger")
EFFECTS: dict[str, dict[str, Any]] = {
    "none": {},
    "people": {"people.count": 12},
    "carried robots": {"failure.kidnaps_per_min": 2.0},
    "scanners": {},  # each preset in turn
    "mixed teams": {"observation.equal_shapes": True},
    "late starts, lost frames": {"failure.start_spread_s": 15.0, "failure.frame_loss_probability": 0.1},
    "priors": {},  # the second half of the episode begins with the map of the first
    "failures, radio": {
        "failure.robots": 1,
        "failure.robots_step": 250,
        "failure.link_begin_step": 100,
        "failure.link_end_step": 200,
        "radio.cells.count": 12,
        "slam.radio_slam.online": True,
        "slam.k_visibility.enabled": True,
    },
}
Row = dict[str, Any]


def soak(
    steps: int,
    seed: int = 0,
    settings: dict[str, Any] | None = None,
    file: Path | None = None,
    report: Callable[[str, bool], None] = lambda line, is_last: None,
) -> dict:
    """Play episodes until there are `steps` time steps; returns counts, and memory and step times.

    Each episode is a line in `file`, after whose last line a run goes on. An episode that raises is counted as wrong,
    with its number: `soak(1, number)` plays it again.
    """
    rows = [] if file is None else kept_rows(file)
    process = 1 + max((row["process"] for row in rows), default=0)
    number = max((row["number"] + 1 for row in rows), default=seed)
    done = sum(row["steps"] for row in rows)
    while done < steps:
        rows.append({"process": process, **_played(number, settings or {})})
        done += rows[-1]["steps"]
        number += 1
        if file is not None:
            append_row(file, rows[-1])
        report(f"{done}/{steps} steps, {len(rows)} episodes, {rows[-1]['memory_mb']:.0f} MB", done >= steps)
    return _figures(rows)


def _played(number: int, settings: dict[str, Any]) -> Row:
    """One episode, with what the process holds after it."""
    task, effect, (kind, timing) = combination(number)
    row: Row = {"number": number, "task": task, "effect": effect, "actions": f"{kind}, {timing}", "steps": 0}
    began = time.process_time()
    try:
        config = override(_config(number), settings)
        row["steps"] = _episode(config, number, effect == "priors")
        if number % WORKERS_EVERY == WORKERS_EVERY - 1:
            _in_workers(config, number)
    except ConfigError as error:
        row["refused"] = str(error)
        row["steps"] = row["steps"] or 1
    except Exception as error:
        row["wrong"] = f"{type(error).__name__}: {error}"
        row["steps"] = row["steps"] or 1
    row["cpu_s"] = time.process_time() - began
    if number % COLLECTED_EVERY == 0:
        gc.collect()
    left = multiprocessing.active_children()
    row |= {"memory_mb": resident_mb(), "files": len(_listed("/proc/self/fd")), "children": len(left)}
    row["shared"] = sum(path.stat().st_uid == os.getuid() for path in map(Path, _listed("/dev/shm")) if path.exists())
    return row


def _listed(folder: str) -> list[str]:
    return [f"{folder}/{name}" for name in os.listdir(folder)] if os.path.isdir(folder) else []


def combination(number: int) -> tuple[str, str, tuple[str, str]]:
    """Task, effect, and kind and timing of actions of an episode: all of them in turn, and every combination once."""
    rounds, task = divmod(number, len(TASKS))
    further, effect = divmod(rounds, len(EFFECTS))
    return (
        tuple(TASKS)[task],
        tuple(EFFECTS)[(task + effect) % len(EFFECTS)],
        ACTIONS[(task + effect + further) % len(ACTIONS)],
    )


def _config(number: int) -> EnvConfig:
    """The settings of an episode."""
    task, effect, (kind, timing) = combination(number)
    config = task_config(task)
    chosen = {
        **EFFECTS[effect],
        "action.kind": kind,
        "action.timing": timing,
        "action.decision_max_s": 2.0,
        "max_cycles": EPISODE_STEPS,
    }
    if effect == "scanners":
        chosen["lidar.preset"] = tuple(LIDAR_PRESETS)[number // len(EFFECTS) % len(LIDAR_PRESETS)]
    if effect == "mixed teams":
        chosen["robot"] = [MIXED[robot % len(MIXED)] for robot in range(config.robots)]
    return override(config, chosen)


def _episode(config: EnvConfig, seed: int, has_prior: bool) -> int:
    """Play one episode; returns its time steps."""
    env = ExplorationEnv(config=override(config, {"max_cycles": EPISODE_STEPS // 2}) if has_prior else config)
    played = _play(env, seed, {})
    if has_prior:
        with tempfile.TemporaryDirectory() as folder:
            prior = str(Path(folder) / "prior.npz")
            save_map(Path(prior), env.engine)
            played += _play(env, seed, {"prior": prior})
    env.close()
    return played


def _play(env: ExplorationEnv, seed: int, options: dict[str, str]) -> int:
    observations, infos = env.reset(seed, options)
    moves = wander(env, seed) if env.config.action.kind == "velocity" else None
    random = np.random.default_rng(seed)
    rewards: dict[str, float] = {}
    while env.agents:
        actions = random_actions(env, infos, random) if moves is None else next(moves)
        observations, rewards, _, _, infos = env.step(actions)
    assert all(np.isfinite(list(rewards.values()))), "a reward is not finite"
    for agent, observation in observations.items():
        assert env.observation_space(agent).contains(observation), f"the observation of {agent} left its space"
    return int(env.result().figures["steps"])


def _in_workers(config: EnvConfig, seed: int) -> None:
    with VectorTeams(2, config, workers=2) as teams:
        teams.reset(seed)
        for _ in range(WORKER_STEPS):
            teams.step(teams.sample())
    left = multiprocessing.active_children()
    assert not left, f"worker processes are left: {left}"


def _figures(rows: Sequence[Row]) -> dict[str, Any]:
    """Counts over all episodes; memory, files and step times of the process that played most of them."""
    wrong = [
        f"episode {row['number']} ({row['task']}, {row['effect']}, {row['actions']}): {row['wrong']}"
        for row in rows
        if "wrong" in row
    ]
    refused = [row for row in rows if "refused" in row]
    processes = [row["process"] for row in rows]
    ours = [row for row in rows if row["process"] == max(processes, key=processes.count)]
    warm = ours[int(WARM_UP_SHARE * len(ours)) :]
    late = max(1, len(warm) // 4)
    figures: dict[str, Any] = {
        "tried": len(rows),
        "refused": len(refused),
        "accepted": len(rows) - len(refused) - len(wrong),
        "wrong": len(wrong),
        "faults": wrong[:20],
        "reasons": sorted({row["refused"] for row in refused})[:20],
        "steps": sum(row["steps"] for row in rows),
        "combinations": len({(row["task"], row["effect"], row["actions"]) for row in rows}),
        "processes": len(set(processes)),
        "episodes_of_the_longest_process": len(ours),
        "memory_peak_mb": max(row["memory_mb"] for row in ours),
    }
    for name, part in (("after_warm_up", warm[:late]), ("at_end", warm[-late:])):
        figures[f"memory_{name}_mb"] = float(np.median([row["memory_mb"] for row in part]))
        figures[f"files_{name}"] = float(np.median([row["files"] for row in part]))
        figures[f"shared_memory_{name}"] = float(np.median([row["shared"] for row in part]))
    figures["children_left"] = max(row["children"] for row in rows)
    figures["memory_growth_mb"] = figures["memory_at_end_mb"] - figures["memory_after_warm_up_mb"]
    figures["step_time_growth"] = _step_time_growth(warm)
    figures["cpu_ms_per_step"] = 1e3 * sum(row["cpu_s"] for row in rows) / figures["steps"]
    return figures


def _step_time_growth(rows: Sequence[Row]) -> float:
    """CPU time per step in the second half of episodes over that in the first, median over tasks; NaN for too few."""
    half, ratios = len(rows) // 2, []
    for task in TASKS:
        parts = [
            [row["cpu_s"] / row["steps"] for row in part if row["task"] == task and row["steps"] > 1]
            for part in (rows[:half], rows[half:])
        ]
        if all(parts):
            ratios.append(float(np.median(parts[1]) / np.median(parts[0])))
    return float(np.median(ratios)) if ratios else float("nan")
