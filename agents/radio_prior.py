"""Does the map from radio shorten exploration? The same buildings and seeds with and without it, in pairs."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import twc_env
from agents.policy import make_policy
from twc_env.config import EnvConfig, digest, override

GOAL = 0.9
AGENTS = ("nearest-frontier", "radio-frontier")


@dataclass(frozen=True, slots=True)
class PairedResult:
    """Time to 90 % correct coverage, without and with the prior."""

    seconds: np.ndarray
    """(buildings, 2); the episode's length where the goal was not reached."""
    reached: np.ndarray
    """(buildings, 2) bool."""
    saved_s: float
    """Mean of without minus with."""
    interval_s: tuple[float, float]
    """95 % bootstrap interval of that mean."""


def compare(maps: list[str], steps: int, folder: Path, tell=lambda text: None) -> PairedResult:
    """Run both agents on every map, one robot, seed = place in the list; finished episodes are read back."""
    seconds, reached = np.zeros((len(maps), 2)), np.zeros((len(maps), 2), bool)
    for i, name in enumerate(maps):
        for j, agent in enumerate(AGENTS):
            tell(f"{2 * i + j}/{2 * len(maps)} {name} {agent}")
            seconds[i, j], reached[i, j] = _once(name, agent, i, steps, folder)
    saved = seconds[:, 0] - seconds[:, 1]
    draws = np.random.default_rng(0).integers(0, len(saved), (4000, len(saved)))
    low, high = np.quantile(saved[draws].mean(axis=1), [0.025, 0.975])
    return PairedResult(seconds, reached, float(saved.mean()), (float(low), float(high)))


def time_to_cover_s(config: EnvConfig, agent: str, seed: int) -> tuple[float, bool]:
    """Simulated time until `GOAL` of the floor is mapped rightly, and whether it was."""
    env = twc_env.parallel_env(config=config)
    policy = make_policy(agent, config)
    env.reset(seed=seed)
    policy.reset(seed, env.possible_agents)
    covered, steps = 0.0, 0
    while env.agents and covered < GOAL:
        beliefs = {name: env.belief(name) for name in env.agents}
        if policy.finished(beliefs):
            break
        _, rewards, *_ = env.step(policy.act(beliefs))
        covered += next(iter(rewards.values()))
        steps += 1
    is_reached = covered >= GOAL
    env.close()
    return (steps if is_reached else config.max_cycles) * config.dynamics.time_step_s, is_reached


def _once(name: str, agent: str, seed: int, steps: int, folder: Path) -> tuple[float, bool]:
    config = override(EnvConfig(), {"map": name, "robots": 1, "max_cycles": steps, "slam.k_visibility.enabled": True})
    path = folder / f"{name.replace('/', '-').replace(':', '-')}-{agent}-{seed}-{digest(config)}.json"
    if path.is_file():
        seconds, is_reached = json.loads(path.read_text())
        return seconds, is_reached
    result = time_to_cover_s(config, agent, seed)
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(result))
    return result
