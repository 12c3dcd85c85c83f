"""Malformed actions: NaN, wrong shapes and types, unknown agents. Each must be rejected without side effects."""

from __future__ import annotations

import pickle
from collections.abc import Iterator
from functools import partial
from typing import Any

import numpy as np

from tests.soak.attempts import Attempt
from twc_env.config import EnvConfig, override
from twc_env.exploration.environment import ExplorationEnv
from twc_env.records.random_streams import random_stream

KINDS = ("velocity", "waypoint", "frontier")
GOOD: dict[str, Any] = {"velocity": (0.5, 0.1), "waypoint": (0.3, 0.0), "frontier": 0}
CHECK_EVERY = 500
"""Number of malformed actions between two valid steps, after which both teams must observe the same."""
SMALL = {"robots": 2, "max_cycles": 10**6, "lidar.beam_count": 36, "action.decision_max_s": 0.5}


def broken_steps(count: int, seed: int = 0) -> Iterator[Attempt]:
    """Send `count` malformed actions to teams of every kind of action; equal seeds send the same ones.

    A reference team receives only the actions that were accepted. Both must get the same observations and rewards.
    """
    for number, kind in enumerate(KINDS):
        yield from _broken_steps_of(kind, count // len(KINDS) + (number < count % len(KINDS)), seed)


def _broken_steps_of(kind: str, count: int, seed: int) -> Iterator[Attempt]:
    config = override(EnvConfig(), {**SMALL, "action.kind": kind})
    attacked, spared = ExplorationEnv(config=config), ExplorationEnv(config=config)
    for env in (attacked, spared):
        env.reset(seed=seed)
    random = random_stream(seed, f"action-fuzz-{kind}")

    def both(actions: Any) -> None:
        ours = attacked.step(actions)  # raises ActionError, and then the other team does not step
        assert pickle.dumps(ours) == pickle.dumps(spared.step(actions)), f"rejected {kind} actions changed the episode"

    def good() -> dict[str, Any]:
        return dict.fromkeys(attacked.agents, np.array(GOOD[kind]))

    both(good())  # kernels compile before the clock runs
    for number in range(count):
        actions = broken_actions(attacked, kind, random)
        if number % CHECK_EVERY == CHECK_EVERY - 1 or number == count - 1:
            yield f"{kind} #{number}: sound", lambda: both(good())
        else:
            yield f"{kind} #{number}: {actions!r:.200}", partial(both, actions)


def broken_actions(env: ExplorationEnv, kind: str, random: np.random.Generator) -> Any:
    """A mapping of actions with one fault, or a value that is not a mapping."""
    actions: dict[Any, Any] = {agent: np.array(GOOD[kind]) for agent in env.agents}
    victim = env.agents[int(random.integers(len(env.agents)))]
    fault = int(random.integers(12))
    if fault == 0:
        del actions[victim]
    elif fault == 1:
        actions[f"robot_{int(random.integers(2, 99))}"] = actions.pop(victim)
    elif fault == 2:
        return _NO_MAPPINGS[int(random.integers(len(_NO_MAPPINGS)))]
    elif fault == 3:
        return {}
    elif fault < 8:
        actions[victim] = ODD_ACTIONS[int(random.integers(len(ODD_ACTIONS)))]
    else:
        shape = tuple(random.integers(0, 4, int(random.integers(0, 4))).tolist())
        kinds = ("f8", "f4", "f2", "i8", "u1", "c16", "U3", "O", "?")
        values = random.normal(0.0, 10.0 ** random.integers(-3, 39), shape)
        with np.errstate(all="ignore"):
            actions[victim] = values.astype(kinds[int(random.integers(len(kinds)))])
    return actions


class _Hostile:
    """An object that cannot be converted to an array."""

    def __array__(self, *arguments: Any, **options: Any) -> Any:
        raise RuntimeError("no array")

    def __repr__(self) -> str:
        return "_Hostile()"


_NO_MAPPINGS: tuple = (None, 0, 1.5, "robot_0", b"robot_1", (), [], [0.5, 0.1], np.zeros(2), object(), {1: [0, 0]}, {})
ODD_ACTIONS: tuple = (
    None, "left", b"x", float("nan"), float("inf"), -float("inf"), 2.0, -1, 99, True, 0.5, 10**30, 1j, {}, set(), (),
    [], [0.1], [float("nan"), 0.0], [0.0, float("inf")], [[0, 1]], [5.0, 0.0], [0.0, -1.1], ["a", "b"], [None, None],
    [0.1, 0.2, 0.3], [[0.1], [0.2, 0.3]], np.zeros(0), np.zeros(3), np.zeros((2, 1)), np.array([1j, 0]), object(),
    np.array(["a", "b"]), np.array([object(), 1]), np.datetime64("2020-01-01"), np.array([1e300, 0]), len, _Hostile(),
)  # fmt: skip
