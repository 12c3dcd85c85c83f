"""Many environments at once, in several processes that exchange observations and actions through shared memory.

    from twc_env.vector import VectorTeams
    teams = VectorTeams(8, {"map": "twin-01"}, workers=2)
    observations = teams.reset(seed=0)                     # block -> (8, robots, ...)
    observations, rewards, ended, infos = teams.step(teams.sample())

An environment whose episode ended starts the next one in the same step: `observations` are the first of the new
episode, and the last of the old one is in `infos[k][robot]["final_observation"]`, its state in `"final_state"`. Results
depend on arguments and seeds, not on the number of workers. With `observation.kind = "flat"` the only block is "".
"""

from __future__ import annotations

import difflib
import multiprocessing
from collections.abc import Mapping, Sequence
from os import PathLike
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray as Array

from twc_env import errors
from twc_env.config import EnvConfig, to_dict
from twc_env.config.checks import whole_number
from twc_env.environment_group import EnvironmentGroup, WorkerProcess
from twc_env.errors import ConfigError, TwcError
from twc_env.exploration.environment import ExplorationEnv
from twc_env.maps import load_map
from twc_env.shared_arrays import FLAT, SharedArrays
from twc_env.world.splits import SPLITS, is_of_split, split_names


class VectorTeams:
    """`count` environments of one configuration, stepped together."""

    def __init__(
        self,
        count: int,
        config: EnvConfig | Mapping[str, Any] | None = None,
        workers: int = 0,
        buildings: str | Sequence[str] = (),
    ):
        """`workers`: processes that share the environments, of which this is the first; 0 is as 1. `buildings`: a split
        ("train") or names of maps; each new episode plays in one of them, drawn by its seed. Without any, all play on
        the config's own map.

        Raises ConfigError for an invalid count or number of workers, MapError for an unknown building, TwcError for an
        invalid configuration.
        """
        count, workers = whole_number("count", count, 1), whole_number("workers", workers, 0)
        if workers > count:
            raise ConfigError(f"{count} environments cannot be shared among {workers} workers: 0 to {count} workers")
        model = ExplorationEnv(config=config)
        self.config, self.count, self.robots = model.config, count, model.config.robots
        self.agents = tuple(model.possible_agents)
        self.observation_space, self.action_space = model.observation_space("robot_0"), model.action_space("robot_0")
        self.state_space = model.state_space
        names = _building_names(buildings)
        self._arrays = SharedArrays(count, self.robots, self.observation_space, self.action_space)
        self._context = multiprocessing.get_context("spawn")
        parts = [list(range(count))[k :: max(workers, 1)] for k in range(max(workers, 1))]
        task = (to_dict(self.config), names)
        others = [WorkerProcess(self._context, part, self._arrays, task) for part in parts[1:]]
        self._groups: list[EnvironmentGroup | WorkerProcess] = [
            EnvironmentGroup(parts[0], self._arrays, *task),
            *others,
        ]
        self._parts = parts

    def reset(self, seed: int = 0) -> dict[str, Array]:
        """Begin new episodes; environment k plays seeds seed + k, seed + k + count, and so on."""
        self._order("reset", whole_number("seed", seed, 0))
        return self._arrays.observations()

    def step(self, actions: Array) -> tuple[dict[str, Array], Array, Array, list[list[dict[str, Any]]]]:
        """One step of all environments.

        actions: (count, robots, ...). Returns observations as from `reset`, rewards (count, robots) float32, whether
        the episode has ended (count,) bool (always by its time limit), and infos[k][robot].
        """
        wanted = (self.count, self.robots, *(self.action_space.shape or ()))
        actions = np.asarray(actions)
        if actions.shape != wanted:
            raise errors.ActionError(
                f"actions must have shape {wanted}, one per environment and robot; got {actions.shape}"
            )
        self._check(actions)
        self._arrays.actions[:] = actions
        infos: list[list[dict[str, Any]]] = [[] for _ in range(self.count)]
        for part, answers in zip(self._parts, self._order("step"), strict=True):
            for k, info in zip(part, answers, strict=True):
                infos[k] = info
        return self._arrays.observations(), self._arrays.rewards.copy(), self._arrays.ended.copy(), infos

    def _check(self, actions: Array) -> None:
        """Reject invalid actions before any environment has moved."""
        space = self.action_space
        low, high = (0, space.n - 1) if isinstance(space, spaces.Discrete) else (-1.0, 1.0)
        if isinstance(space, spaces.Discrete) and actions.dtype.kind not in "iu":
            raise errors.ActionError(f"actions must be whole numbers from {low} to {high}; got {actions.dtype}")
        if not np.all((actions >= low - 1e-6) & (actions <= high + 1e-6)):  # also true for NaN
            k, robot = np.argwhere(~((actions >= low - 1e-6) & (actions <= high + 1e-6)))[0][:2]
            raise errors.ActionError(
                f"the action of robot {robot} in environment {k} must be finite and in [{low}, {high}]; "
                f"got {actions[k, robot].tolist()}"
            )

    def sample(self) -> Array:
        """Random actions for all robots, within the mask if there is one."""
        space = self.action_space
        if not isinstance(space, spaces.Discrete):
            return np.array([[space.sample() for _ in self.agents] for _ in range(self.count)])
        return np.array([[space.sample(mask.astype(np.int8)) for mask in row] for row in self.action_masks()])

    def action_masks(self) -> Array:
        """(count, robots, choices) bool: each robot's valid choices. Raises ConfigError unless
        `action.kind = "frontier"`."""
        if not isinstance(self.action_space, spaces.Discrete):
            raise ConfigError(
                f"only choices have masks: action.kind must be 'frontier'; it is {self.config.action.kind!r}"
            )
        blocks = self._arrays.blocks
        seen = blocks["action_mask"] if "action_mask" in blocks else blocks[FLAT]  # which ends with the mask
        return seen[..., -int(self.action_space.n) :] > 0

    def states(self) -> Array:
        """(count, 6 robots) float32: the `state()` of each environment now, for centralised critics; it holds truth."""
        states = np.empty((self.count, *(self.state_space.shape or ())), np.float32)
        for part, own in zip(self._parts, self._order("state"), strict=True):
            states[part] = own
        return states

    def close(self) -> None:
        """Stop the workers."""
        for group in self._groups:
            group.close()
        self._groups = []

    def _order(self, what: str, seed: int = 0) -> list[Any]:
        if not self._groups:
            raise TwcError("these environments are closed: create new ones")
        try:
            for group in reversed(self._groups):  # this process's own group last, as it runs at once
                group.send(what, seed)
            answers = [group.receive() for group in self._groups]
        except BaseException:  # interrupted: the next step must not read the results of this one
            self.close()
            raise
        for answer in answers:
            if isinstance(answer, Exception):
                raise answer
        return answers


def _building_names(buildings: str | Sequence[str]) -> tuple[str, ...]:
    """Names of maps that can be loaded, none or more; the name of a split stands for all of it."""
    if isinstance(buildings, str):
        if buildings in SPLITS:
            return split_names(buildings)
        if near := difflib.get_close_matches(buildings, SPLITS, n=1, cutoff=0.7):
            raise ConfigError(
                f"buildings are a split ({', '.join(SPLITS)}) or names of maps; did you mean {near[0]!r}?"
            )
        buildings = (buildings,)
    if not isinstance(buildings, Sequence) or not all(isinstance(name, (str, PathLike)) for name in buildings):
        raise ConfigError(f"buildings must be a split ({', '.join(SPLITS)}) or names of maps; got {buildings!r}")
    names = tuple(str(name) for name in buildings)
    unlike = {_recipe(name): name for name in reversed(names)}
    for name in unlike.values():
        load_map(name)
    return names


def _recipe(name: str) -> str:
    """Names that differ in nothing but a number that a building is drawn from have one: none of them can be missing."""
    recipe, _, number = name.rpartition(":")
    return name.partition("/")[0] if is_of_split(name) else recipe if number.isdecimal() else name
