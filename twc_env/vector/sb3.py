"""A stable-baselines3 VecEnv over whole teams: one policy controls every robot (parameter sharing).

    from stable_baselines3 import PPO
    from twc_env.vector.sb3 import TeamVecEnv
    model = PPO("MultiInputPolicy", TeamVecEnv(4, {"action.kind": "frontier"}, buildings="train"))

Each robot of each environment is one row. Needs stable-baselines3 (extra `train`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray as Array

try:
    from stable_baselines3.common.vec_env import VecEnv
except ImportError as error:
    raise ImportError("twc_env.vector.sb3 needs stable-baselines3: pip install 'twc_env[train]'") from error

from twc_env.config import EnvConfig
from twc_env.config.checks import whole_number
from twc_env.errors import ActionError
from twc_env.exploration.actions import action_array
from twc_env.vector.shared_arrays import FLAT
from twc_env.vector.teams import VectorTeams


class TeamVecEnv(VecEnv):
    """Row k * robots + r is robot r of environment k; same arguments as `VectorTeams`.

    When an episode ends, `terminal_observation` is set, and `info["TimeLimit.truncated"]` is True unless it was
    terminated (`episode.ends_at_coverage`).
    `info["episode"]` has return and length, so VecMonitor is not needed.
    """

    def __init__(
        self,
        count: int,
        config: EnvConfig | Mapping[str, Any] | None = None,
        workers: int = 0,
        buildings: str | Sequence[str] = (),
        seed: int = 0,
        ray: str | None = None,
        task: str | None = None,
    ):
        self.teams = VectorTeams(count, config, workers, buildings, ray, task)
        self.robots = self.teams.robots
        self._next_seed = whole_number("seed", seed, 0)
        self.render_mode = None
        super().__init__(count * self.robots, self.teams.observation_space, self.teams.action_space)
        self._actions = np.zeros(0)
        self._returns = np.zeros(self.num_envs)
        self._lengths = np.zeros(self.num_envs, np.int64)

    def reset(self) -> dict[str, Array] | Array:
        """Begin new episodes; a seed from `seed()` or the constructor is used once, then subsequent ones.

        Returns observations with one row per robot of all teams, or one array per block.
        """
        seeds = [s for s in self._seeds if s is not None]
        first = seeds[0] if seeds else self._next_seed
        self._next_seed = first + 1_000_003
        self._reset_seeds()
        self._returns[:], self._lengths[:] = 0.0, 0
        return self._rows(self.teams.reset(first))

    def step_async(self, actions: Array) -> None:
        """Store the actions for `step_wait`. Raises ActionError if their number is wrong."""
        given, actions = actions, action_array(actions)
        wanted = (self.num_envs, *(self.action_space.shape or ()))
        if actions.shape != wanted:
            got = actions.shape if isinstance(given, np.ndarray) else f"{type(given).__name__} {given!r:.80}"
            raise ActionError(f"actions must have shape {wanted}, one row per robot; got {got}")
        self._actions = actions.reshape(self.teams.count, self.robots, *actions.shape[1:])

    def step_wait(self):
        """Observations, rewards, dones and infos, one row per robot."""
        observations, rewards, ended, infos = self.teams.step(self._actions)
        paid, done = rewards.reshape(-1), np.repeat(ended, self.robots)
        self._returns += paid
        self._lengths += 1
        flat = [info for team in infos for info in team]
        for row in np.flatnonzero(done).tolist():
            flat[row]["terminal_observation"] = flat[row].pop("final_observation")
            flat[row]["TimeLimit.truncated"] = not flat[row].pop("is_terminated")
            flat[row]["episode"] = {"r": float(self._returns[row]), "l": int(self._lengths[row]), "t": 0.0}
            self._returns[row], self._lengths[row] = 0.0, 0
        return self._rows(observations), paid, done, flat

    def close(self) -> None:
        """Stop the workers."""
        self.teams.close()

    def _rows(self, observations: dict[str, Array]) -> dict[str, Array] | Array:
        rows = {name: block.reshape(self.num_envs, *block.shape[2:]) for name, block in observations.items()}
        return rows.get(FLAT, rows)

    def get_attr(self, attr_name: str, indices=None) -> list[Any]:
        """An attribute of this object, once per requested row: rows are not environments of their own."""
        return [getattr(self, attr_name) for _ in self._get_indices(indices)]

    def set_attr(self, attr_name: str, value: Any, indices=None) -> None:
        """Not supported: a row has no attributes of its own. Raises AttributeError."""
        raise AttributeError(f"rows of a TeamVecEnv have no attributes to set; got {attr_name!r}")

    def set_options(self, options: Any = None) -> None:
        """Not supported: episodes differ by `buildings` and seeds only. Raises AttributeError for any option."""
        if any(options if isinstance(options, (list, tuple)) else (options,)):
            raise AttributeError(f"episodes of a TeamVecEnv take no options; got {options!r}: choose `buildings`")

    def action_masks(self) -> Array:
        """(rows, choices) bool: each robot's valid choices. Raises ConfigError unless `action.kind = "frontier"`."""
        masks = self.teams.action_masks()
        return masks.reshape(self.num_envs, masks.shape[-1])

    def env_method(self, method_name: str, *args, indices=None, **kwargs) -> list[Any]:
        """`action_masks` row by row, as required by MaskablePPO of sb3-contrib.

        Raises AttributeError for any other method: environments live in worker processes.
        """
        if method_name == "action_masks":
            masks = self.action_masks()
            return [masks[row] for row in self._get_indices(indices)]
        raise AttributeError(f"environments of a TeamVecEnv cannot be called; got {method_name!r}")

    def env_is_wrapped(self, wrapper_class: type, indices=None) -> list[bool]:
        """True for Monitor only, since episodes are counted as stable-baselines3's Monitor does."""
        from stable_baselines3.common.monitor import Monitor

        return [wrapper_class is Monitor for _ in self._get_indices(indices)]
