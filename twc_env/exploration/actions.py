"""Velocity actions: their space, validation, and conversion to m/s and rad/s."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from struct import Struct
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray as Array

from twc_env.config import DynamicsConfig
from twc_env.errors import ActionError

TOLERANCE = 1e-6
_SINGLE = np.dtype(np.float32)
"""Data type of most actions."""


def velocity_space() -> spaces.Box:
    """(2,) forward speed and turn rate (left positive) as fractions of the maxima, in [-1, 1]."""
    return spaces.Box(-1.0, 1.0, (2,), np.float32)


def check_agents(actions: Any, agents: Sequence[str]) -> None:
    """Raises ActionError unless `actions` is a mapping with exactly one action per agent."""
    if not isinstance(actions, Mapping):
        raise ActionError(
            f"step() needs a dict with one action for each of {list(agents)}; got {type(actions).__name__} {actions!r}"
        )
    for agent in agents:
        if agent not in actions:
            raise ActionError(f"no action for {agent!r}: step() needs one for each of {list(agents)}")
    if len(actions) != len(agents):
        unknown = next(name for name in actions if name not in agents)
        raise ActionError(f"action for {unknown!r}, which is not in the episode: remove it; agents are {list(agents)}")


def action_array(action: Any) -> Array:
    """The action as an array; an empty one if it cannot be converted or has masked numbers, which say nothing."""
    try:
        return np.zeros(0) if np.ma.is_masked(action) else np.asarray(action)
    except Exception:  # arbitrary objects may raise anything
        return np.zeros(0)


def shown(action: Any) -> str:
    """What an error says of an action, and what to do with a tensor that is no array: one with a gradient, or on a
    GPU."""
    is_tensor = hasattr(action, "detach") and action_array(action).size == 0
    return f"{action!r}: pass action.detach().cpu().numpy()" if is_tensor else repr(action)


class Velocities:
    """Converts actions to commands, in one array that each call overwrites."""

    def __init__(self, config: DynamicsConfig | Sequence[DynamicsConfig], robots: int):
        """config: of all robots, or of each."""
        self._arguments = config, robots
        own = [config] * robots if isinstance(config, DynamicsConfig) else config
        self._maxima = [(each.speed_max_m_s, each.turn_rate_max_rad_s) for each in own]
        self._commands = np.empty((robots, 2))
        self._write = partial(Struct(f"{2 * robots}d").pack_into, self._commands.data.cast("B"), 0)

    def __reduce__(self):
        return type(self), self._arguments

    def decode(self, actions: Mapping[str, Array], agents: Sequence[str]) -> Array:
        """Commands (robots, 2) [m/s, rad/s] from one action per agent.

        Raises ActionError for missing or additional agents and for actions other than two finite numbers in [-1, 1].
        """
        commands: list[float] = []
        try:
            if type(actions) is not dict or len(actions) != len(agents):
                raise TypeError
            for agent, (speed_max_m_s, turn_rate_max_rad_s) in zip(agents, self._maxima, strict=True):
                action = actions[agent]
                if action.dtype is not _SINGLE and action.dtype.kind not in "fiu":
                    raise TypeError
                ahead, left = action.tolist()  # raises for most other shapes; the others fail in the next line
                if not ahead * ahead <= 1.0 >= left * left:  # True for NaN
                    raise ValueError
                commands += (ahead * speed_max_m_s, left * turn_rate_max_rad_s)
            self._write(*commands)
        except Exception:  # arbitrary objects may raise anything; the checks below accept or name the action
            self._commands[:] = one_by_one(actions, agents) * np.array(self._maxima)
        return self._commands


def one_by_one(actions: Mapping[str, Array], agents: Sequence[str]) -> Array:
    """Actions (robots, 2), clipped to [-1, 1] within `TOLERANCE`. Raises ActionError for the first invalid one."""
    check_agents(actions, agents)
    shares = np.empty((len(agents), 2))
    for row, agent in enumerate(agents):
        action = action_array(actions[agent])
        if action.shape != (2,) or action.dtype.kind not in "fiu":
            raise ActionError(
                f"action of {agent!r} must be 2 numbers (forward speed, turn rate) in [-1, 1]; "
                f"got {shown(actions[agent])}"
            )
        shares[row] = action
    is_fit = np.all(np.abs(shares) <= 1.0 + TOLERANCE, axis=1)  # False for NaN
    if not is_fit.all():
        agent = agents[int(np.argmin(is_fit))]
        raise ActionError(
            f"action of {agent!r} must be finite and in [-1, 1]; got {actions[agent]!r}: "
            "clip it, or use an agent whose output is squashed"
        )
    return np.clip(shares, -1.0, 1.0)
