"""What an agent may command, and how its numbers become metres per second."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from twc_env.config import DynamicsConfig
from twc_env.errors import ActionError

Array = NDArray

TOLERANCE = 1e-6


def velocity_space() -> spaces.Box:
    """(2,) forward speed and turn rate (left is positive) as shares of the robot's maxima, in [-1, 1]."""
    return spaces.Box(-1.0, 1.0, (2,), np.float32)


def check_agents(actions: Any, agents: Sequence[str]) -> None:
    """Raises ActionError unless there is one action for each agent, and none for anybody else."""
    if type(actions) is dict and list(actions) == agents:  # as most send them
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
    speed_max_m_s, turn_rate_max_rad_s = config.speed_max_m_s, config.turn_rate_max_rad_s
    commands: list[float] = []
    try:
        for agent in agents:
            action = actions[agent]
            if action.dtype.kind not in "fiu":
                raise TypeError
            ahead, left = action.tolist()  # of another shape: not two, or no numbers
            if not (-1.0 <= ahead <= 1.0 and -1.0 <= left <= 1.0):
                raise ValueError
            commands += ahead * speed_max_m_s, left * turn_rate_max_rad_s
    except Exception:  # an object of the user's may raise anything; what does not fit is named below
        return _one_by_one(actions, agents) * (speed_max_m_s, turn_rate_max_rad_s)
    return np.array(commands, np.float64).reshape(-1, 2)


def _one_by_one(actions: Mapping[str, Array], agents: Sequence[str]) -> Array:
    """Shares (robots, 2), cut to [-1, 1] where rounding led beyond it; an error for the first that is no share."""
    shares = np.empty((len(agents), 2))
    for row, agent in enumerate(agents):
        action = action_array(actions[agent])
        if action.shape != (2,) or action.dtype.kind not in "fiu":
            raise ActionError(
                f"action of {agent!r} must be 2 numbers (forward speed, turn rate) in [-1, 1]; got {actions[agent]!r}"
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
