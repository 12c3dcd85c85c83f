"""What an agent may command, and how its numbers become metres per second."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from twc_env.config import DynamicsConfig
from twc_env.errors import ActionError
from twc_env.kernels import borrowing_kernel

Array = NDArray

TOLERANCE = 1e-6


def velocity_space() -> spaces.Box:
    """(2,) forward speed and turn rate (left is positive) as shares of the robot's maxima, in [-1, 1]."""
    return spaces.Box(-1.0, 1.0, (2,), np.float32)


def check_agents(actions: Any, agents: Sequence[str]) -> None:
    """Raises ActionError unless there is one action for each agent, and none for anybody else."""
    if type(actions) is dict and len(actions) == len(agents) and all(map(actions.__contains__, agents)):
        return
    if not isinstance(actions, Mapping):
        raise ActionError(
            f"step() needs a dict with one action for each of {list(agents)}; got {type(actions).__name__} {actions!r}"
        )
    for agent in agents:
        if agent not in actions:
            raise ActionError(f"no action for {agent!r}: step() needs one for each of {list(agents)}")
    if len(actions) != len(agents):
        unknown = next(name for name in actions if name not in agents)
        raise ActionError(
            f"action for {unknown!r}, which is not in the episode: leave it out; there are {list(agents)}"
        )


def action_array(action: Any) -> Array:
    """An action as an array, an empty one where it is nothing of that kind."""
    try:
        return np.asarray(action)
    except Exception:  # an object of the user's may raise anything
        return np.zeros(0)


def decode_velocity(actions: Mapping[str, Array], agents: Sequence[str], config: DynamicsConfig) -> Array:
    """Commands (robots, 2) [m/s, rad/s] from one action per agent.

    Raises ActionError when an agent has no action, or an action is not two finite numbers in [-1, 1].
    """
    commands = np.empty((len(agents), 2))
    try:
        for row, agent in enumerate(agents):
            action = actions[agent]
            if action.shape != (2,) or action.dtype.kind not in "fiu":
                raise TypeError
            commands[row] = action
    except Exception:  # an object of the user's may raise anything; what does not fit is named below
        commands = _one_by_one(actions, agents)
    if not _scale(commands, config.speed_max_m_s, config.turn_rate_max_rad_s):
        commands = np.array([actions[agent] for agent in agents], np.float64)
        row = int(np.argmax(~np.all(np.abs(commands) <= 1.0 + TOLERANCE, axis=1)))
        raise ActionError(
            f"action of {agents[row]!r} must be finite and in [-1, 1]; got {actions[agents[row]]!r}: "
            "clip it, or use an agent whose output is squashed"
        )
    return commands


def _one_by_one(actions: Mapping[str, Array], agents: Sequence[str]) -> Array:
    """The same with a message for the first action that does not fit."""
    commands = np.empty((len(agents), 2))
    for row, agent in enumerate(agents):
        action = action_array(actions[agent])
        if action.shape != (2,) or action.dtype.kind not in "fiu":
            raise ActionError(
                f"action of {agent!r} must be 2 numbers (forward speed, turn rate) in [-1, 1]; got {actions[agent]!r}"
            )
        commands[row] = action
    return commands


@borrowing_kernel
def _scale(commands, speed_max, turn_rate_max):
    """Shares (n, 2) -> commands, in place, cut to the maxima; False when one of them is no share."""
    for i in range(commands.shape[0]):
        for k in range(2):
            if not abs(commands[i, k]) <= 1.0 + TOLERANCE:  # also true for NaN
                return False
        commands[i, 0] = min(max(commands[i, 0], -1.0), 1.0) * speed_max
        commands[i, 1] = min(max(commands[i, 1], -1.0), 1.0) * turn_rate_max
    return True
