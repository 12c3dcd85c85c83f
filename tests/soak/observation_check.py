"""Check observations over long random episodes: inside their spaces, never constant, no shared memory."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from gymnasium import spaces

from twc_env.config import EnvConfig, override
from twc_env.exploration.environment import ExplorationEnv
from twc_env.records.random_streams import random_stream

BLOCKS = ("lidar", "map", "overview", "pose", "wifi", "signs", "team", "frontiers", "gains", "other_maps")
EPISODE_STEPS = 500
ACTIONS = (
    ("velocity", "synchronous"),
    ("waypoint", "synchronous"),
    ("waypoint", "asynchronous"),
    ("frontier", "synchronous"),
    ("frontier", "asynchronous"),
    ("frontier", "in-turn"),
)
"""Every kind and timing of action; every second one is played with all effects of reality."""
EFFECTS = {
    "world": "ward",
    "team": ["wheeled", "handheld", {"preset": "turtlebot-burger", "lidar.delay_s": 0.05}],
    "odometry.bumps_per_m": 0.5,
    "odometry.variation": 1.0,
    "radio.power_change_std_db": 5.0,
    "link.topology": "peer",
    "failure.kidnaps_per_min": 2.0,
    "failure.frame_loss_probability": 0.2,
    "failure.clock_offset_std_s": 100.0,
    "failure.clock_skew_std_ppm": 50.0,
    "failure.start_spread_s": 5.0,
}
"""Of the world, of a mixed team, of its clocks and frames."""
_SETTINGS = {
    **{f"observation.{name}": True for name in BLOCKS},
    "slam.k_visibility.enabled": True,
    "action.decision_max_s": 2.0,
    "link.loss_probability": 0.1,  # otherwise `team` stays constant until robots share a map
    "max_cycles": EPISODE_STEPS,
}


@dataclass(slots=True)
class ObservationReport:
    """What was checked, and the faults found."""

    steps: int = 0
    blocks: int = 0
    too_short: list[str] = field(default_factory=list)
    """Kinds of action that played no whole episode; a block that never changed is no fault there."""
    faults: list[str] = field(default_factory=list)
    """Each fault is listed once per block and kind of action."""


def check_observations(
    steps: int, seed: int = 0, report: Callable[[int, int], None] = lambda done, total: None
) -> ObservationReport:
    """Run `steps` random steps, divided among the kinds of action, with all blocks on, in changing buildings."""
    result = ObservationReport()
    for number, (kind, timing) in enumerate(ACTIONS):
        share = steps // len(ACTIONS) + (number < steps % len(ACTIONS))
        settings = {**_SETTINGS, "action.kind": kind, "action.timing": timing, **(EFFECTS if number % 2 else {})}
        env = ExplorationEnv(config=override(EnvConfig(), settings))
        _check_kind(env, share, seed, f"{kind}, {timing}", result, lambda: report(result.steps, steps))
    return result


def _check_kind(
    env: ExplorationEnv, steps: int, seed: int, what: str, result: ObservationReport, report: Callable[[], None]
) -> None:
    """A block must change within the first whole episode: a sign may take some hundred steps to come into view."""
    random = random_stream(seed, "observation-check")
    changed: set[str] = set()
    names: set[str] = set()
    episode = seed
    for step in range(steps):
        if not env.agents:
            before, infos = env.reset(episode, {"split": "train"})
            episode += 1
        observations, _, _, _, infos = env.step(random_actions(env, infos, random))
        names |= {name for observation in observations.values() for name in observation}
        changed |= _look(env, before, observations, what, result)
        before = observations
        result.steps += 1
        if step % 50 == 49:
            report()
    if env.agents and episode - seed < 2:
        result.too_short.append(what)
        return
    for name in sorted(names - changed):
        _note(result, f"{name} never changed ({what})")


def random_actions(env: ExplorationEnv, infos: dict[str, dict[str, Any]], random: np.random.Generator) -> dict:
    """For each agent an action drawn uniformly from those that its mask or space allows."""
    actions: dict[str, Any] = {}
    for agent in env.agents:
        space = env.action_space(agent)
        if isinstance(space, spaces.Discrete):
            actions[agent] = int(random.choice(np.flatnonzero(infos[agent]["action_mask"])))
        else:
            actions[agent] = random.uniform(-1, 1, 2).astype(np.float32)
    return actions


def _look(env: ExplorationEnv, before: dict, now: dict, what: str, result: ObservationReport) -> set[str]:
    """Record the faults of one step; returns the names of the blocks that changed."""
    changed = set()
    arrays = [(agent, name, block) for agent, observation in now.items() for name, block in observation.items()]
    old = [block for observation in before.values() for block in observation.values()]
    for number, (agent, name, block) in enumerate(arrays):
        space = env.observation_space(agent)
        assert isinstance(space, spaces.Dict)
        result.blocks += 1
        if not space[name].contains(block):
            _note(result, f"{name} left its space ({what})")
        if not np.array_equal(block, before[agent][name]):
            changed.add(name)
        others = [other for _, _, other in arrays[number + 1 :]] + old
        if any(np.may_share_memory(block, other) and np.shares_memory(block, other) for other in others):
            _note(result, f"{name} shares memory with another block ({what})")
    return changed


def _note(result: ObservationReport, fault: str) -> None:
    if fault not in result.faults:
        result.faults.append(fault)
