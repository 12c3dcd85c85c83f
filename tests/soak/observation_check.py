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

BLOCKS = ("lidar", "map", "overview", "pose", "wifi", "signs", "team", "frontiers")
EPISODE_STEPS = 500
ACTIONS = (
    ("velocity", "synchronous"),
    ("waypoint", "synchronous"),
    ("waypoint", "asynchronous"),
    ("frontier", "synchronous"),
    ("frontier", "asynchronous"),
    ("frontier", "in-turn"),
)
"""Every kind and timing of action."""
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
        config = override(EnvConfig(), {**_SETTINGS, "action.kind": kind, "action.timing": timing})
        _check_kind(
            ExplorationEnv(config=config), share, seed, f"{kind}, {timing}", result, lambda: report(result.steps, steps)
        )
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
    space = env.observation_space(env.possible_agents[0])  # the same for all agents
    assert isinstance(space, spaces.Dict)
    for number, (agent, name, block) in enumerate(arrays):
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
