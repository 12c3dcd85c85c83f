"""Many environments at once, in worker processes that exchange observations and actions through shared memory.

    from twc_env.vector.teams import VectorTeams
    teams = VectorTeams(8, {"map": "twin-01"}, workers=2)
    observations = teams.reset(seed=0)                     # block -> (8, robots, ...)
    observations, rewards, ended, infos = teams.step(teams.sample())

`step` waits for the slowest environment. `send` and `recv` do not: environments continue as soon as they have actions.

    teams.send(actions, range(8))
    while True:
        ids, observations, rewards, ended, infos = teams.recv(4)   # the first four that are ready
        teams.send(policy(observations), ids)

An environment whose episode ended starts the next one in the same step: `observations` are the first of the new
episode, and the last of the old one is in `infos[i][robot]["final_observation"]`, its state in `"final_state"`. What an
environment returns depends on its seed and its actions only, not on the number of workers or on other environments.
With `observation.kind = "flat"` the only block is "".
"""

from __future__ import annotations

import contextlib
import difflib
import multiprocessing
import operator
import os
import weakref
from collections import deque
from collections.abc import Iterable, Iterator, Mapping, Sequence
from os import PathLike
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray as Array

from twc_env.config import EnvConfig, robot_configs, to_dict
from twc_env.config.checks import refuse_arguments, whole_number
from twc_env.errors import ActionError, ConfigError, DataError, TwcError
from twc_env.exploration.actions import action_array
from twc_env.exploration.environment import ExplorationEnv
from twc_env.maps import load_map
from twc_env.records.one_thread import OneThread
from twc_env.vector.environment_group import RESET, STATE, STEP, EnvironmentGroup, Infos
from twc_env.vector.episode_actions import EpisodeActions
from twc_env.vector.ray_pool import RayPool
from twc_env.vector.shared_arrays import FLAT, SharedArrays
from twc_env.vector.worker_pool import WorkerPool
from twc_env.world.building.splits import SPLITS, family_of, is_of_split, split_names

Runner = EnvironmentGroup | WorkerPool | RayPool
"""What executes the environments."""


class VectorTeams:
    """`count` environments of one configuration, stepped together (`step`) or each on its own (`send`, `recv`).

    `close` ends the worker processes, as does the end of a `with` block or of the last reference to this object.
    """

    def __init__(
        self,
        count: int,
        config: EnvConfig | Mapping[str, Any] | None = None,
        workers: int = 0,
        buildings: str | Sequence[str] = (),
        ray: str | None = None,
        task: str | None = None,
        **unknown: Any,
    ):
        """`workers`: processes that share the environments, of which this is the first; 0 is as 1. `buildings`: a split
        ("train") or names of maps; each new episode plays in one of them, drawn by its seed. Without any, all play on
        the config's own map, or each in one of its set (`gen:office:300:train`), drawn by the seed. `ray`: address of a
        Ray cluster, or "auto", whose actors are the workers; 0 is one per core. `task`: id of a standard task, of which
        `config` then overrides settings.

        Raises ConfigError for an invalid count or number of workers, or for workers of a process that may have none,
        MapError for an unknown building, TwcError for an invalid configuration, DataError without that cluster.
        """
        refuse_arguments(unknown, VectorTeams)
        count, workers = whole_number("count", count, 1), whole_number("workers", workers, 0)
        if workers > count:
            raise ConfigError(f"{count} environments cannot be shared among {workers} workers: 0 to {count} workers")
        if workers > 1 and ray is None and multiprocessing.current_process().daemon:
            raise ConfigError(
                f"workers={workers}: this process is itself a worker (such as a DataLoader's) and may start none; use 0"
            )
        model = ExplorationEnv(config=config, task=task)
        self.config, self.count, self.robots = model.config, count, model.config.robots
        self.agents = tuple(model.possible_agents)
        self.observation_space, self.action_space = model.observation_space("robot_0"), model.action_space("robot_0")
        if any(model.observation_space(agent) != self.observation_space for agent in self.agents):
            beams = ", ".join(str(own.lidar.beam_count) for own in robot_configs(self.config))
            raise ConfigError(
                f"the robots' scanners have {beams} beams, and one array cannot hold their observations: set "
                "observation.equal_shapes = true"
            )
        self.state_space = model.state_space
        names = _building_names(buildings, family_of(self.config.map))
        shape = count, self.robots, self.observation_space, self.action_space, self.state_space
        try:
            self._arrays = SharedArrays(*shape)
        except (OverflowError, MemoryError, OSError) as error:
            raise ConfigError(f"count={count}: so many environments do not fit into memory; take fewer") from error
        self._all, actions = range(count), self._arrays.actions
        self._episodes = EpisodeActions(count, actions.shape[1:], actions.dtype)
        played = to_dict(self.config), names
        self._runner: Runner | None
        if ray is not None:
            self._runner = RayPool(workers, shape, self._arrays, self._episodes, ray)
            self._runner.start(*played)
            workers = self._runner.workers
        elif workers > 1:
            self._runner = WorkerPool(count, workers, self._arrays, *played)
        else:
            self._runner = EnvironmentGroup(self._all, self._arrays, *played)
        self.workers = max(workers, 1)
        """Processes that share the environments."""
        weakref.finalize(self, _close_unless_forked, self._runner, os.getpid()).atexit = False
        self._alone = OneThread("VectorTeams")
        self._pending: set[int] = set()
        """Environments with a step that was not yet received."""
        self._early: deque[tuple[int, Infos | TwcError]] = deque()
        """Results of theirs that came while another command was waited for."""

    def reset(self, seed: int | Sequence[int] = 0) -> dict[str, Array]:
        """Begin new episodes; environment k plays seeds seed + k, seed + k + count, and so on.

        With one seed per environment, k plays seed[k], seed[k] + count, and so on. The first seed also decides what
        `sample` draws. Results of steps that were sent and not yet received are dropped. Returns the observations, each
        block with axes (environments, robots, ...). Raises ConfigError for anything else than whole numbers.
        """
        seeds = self._first_seeds(seed)
        if self._pending:
            with self._running() as runner:
                for _ in runner.results(len(self._pending) - len(self._early)):
                    pass
            self._pending.clear()
            self._early.clear()
        self.action_space.seed(seeds[0])
        for k, each in enumerate(seeds):
            self._episodes.begin(k, each)
        self._execute(RESET, self._all, seeds)
        return self._observations()

    def _observations(self) -> dict[str, Array]:
        return {name: block.copy() for name, block in self._arrays.observations.items()}

    def snapshot(self) -> dict[str, Array]:
        """Arrays from which `restore` plays on exactly: seeds of the present episodes, and their actions so far.

        Raises TwcError before the first `reset`, and while a step was not yet received.
        """
        if self._pending or None in self._episodes.seeds:
            raise TwcError("only episodes that have begun, without pending steps, have a snapshot: reset() or recv()")
        ended = self._arrays.ended.tolist()
        seeds = [
            int(seed or 0) + self.count * has_ended for seed, has_ended in zip(self._episodes.seeds, ended, strict=True)
        ]
        actions = {f"actions.{k}": self._episodes.of(k)[: 0 if ended[k] else None] for k in self._all}
        return {"seeds": np.array(seeds, np.int64), **actions}

    def restore(self, arrays: Mapping[str, Array]) -> dict[str, Array]:
        """Play the episodes of a `snapshot` again up to where they were; returns observations as `reset` does.

        Takes the time of these steps. arrays: of as many environments with the same settings, which is for the caller
        to see to: others play the same seeds and actions. Raises DataError for arrays of other numbers of environments
        or robots, or of other actions; the present episodes are unchanged then.
        """
        for name in ("seeds", *(f"actions.{k}" for k in self._all)):
            if name not in arrays:
                raise DataError(f"no snapshot of {self.count} environments: {name!r} is missing; snapshot() has it")
        played, step = [arrays[f"actions.{k}"] for k in self._all], 0
        wanted = self._arrays.actions[0]
        if len(arrays["seeds"]) != self.count:
            raise DataError(f"no snapshot of these {self.count} environments: it has {len(arrays['seeds'])} seeds")
        for k, own in enumerate(played):
            if (own.shape[1:], own.dtype) != (wanted.shape, wanted.dtype):
                raise DataError(
                    f"no snapshot of these {self.count} environments: its actions.{k} are {own.dtype} of shape "
                    f"{own.shape}, here they are {wanted.dtype} of shape {(len(own), *wanted.shape)}"
                )
        self.reset(arrays["seeds"].tolist())
        while ids := [k for k in self._all if step < len(played[k])]:
            self.send(np.stack([played[k][step] for k in ids]), ids)
            self.recv(len(ids))
            step += 1
        return self._observations()

    def step(self, actions: Array) -> tuple[dict[str, Array], Array, Array, list[Infos]]:
        """One step of all environments.

        actions: (count, robots, ...). Returns observations as from `reset`, rewards (count, robots) float32, whether
        the episode has ended (count,) bool, and `infos[k][robot]`; if it has, `is_terminated` in them tells whether the
        floor was mapped (`episode.ends_at_coverage`) or the time limit reached.
        """
        self.send(actions, self._all)
        return self._receive(self.count, range(self.count))[1:]

    def send(self, actions: Array, ids: Iterable[int]) -> None:
        """Start one step of each of the environments `ids` and return at once.

        actions: (len(ids), robots, ...), in the order of `ids`. Raises ActionError for invalid actions and for ids that
        are unknown, repeated, or of environments whose last step was not yet received; no step is started then.
        """
        wanted = self._idle(ids)
        self._arrays.actions[wanted] = self._checked(actions, wanted)
        for k in wanted:
            self._episodes.note(k, self._arrays.actions[k], self._arrays.ended[k])
        with self._running() as runner:
            runner.submit(STEP, wanted)
        self._pending.update(wanted)

    def recv(self, count: int | None = None) -> tuple[Array, dict[str, Array], Array, Array, list[Infos]]:
        """Wait for the first `count` environments whose step is done; by default for all that were sent actions.

        Returns their ids (count,), in the order in which they were done, and what `step` returns with one row per id.
        Raises TwcError if fewer environments were sent actions. Without workers, the steps are executed here, in the
        order in which they were sent.
        """
        self._open()
        count = len(self._pending) if count is None else whole_number("count", count, 1)
        if not 0 < count <= len(self._pending):
            raise TwcError(f"{len(self._pending)} environments have actions; recv({count}) needs a send() to more")
        return self._receive(count)

    def _receive(
        self, count: int, rows: Sequence[int] | None = None
    ) -> tuple[Array, dict[str, Array], Array, Array, list[Infos]]:
        """The next `count` results; that of environment k is in row rows[k], by default in the order of arrival."""
        arrays, ids = self._arrays, np.empty(count, np.int64)
        observations = {name: np.empty((count, *b.shape[1:]), b.dtype) for name, b in arrays.observations.items()}
        infos: list[Infos] = [[]] * count
        failures = []
        with self._running() as runner:
            for place, (k, result) in enumerate(self._results(runner, count)):
                row = place if rows is None else rows[k]
                ids[row] = k
                for name, block in arrays.observations.items():
                    observations[name][row] = block[k]
                if isinstance(result, TwcError):
                    failures.append(result)
                else:
                    infos[row] = result
        self._pending.difference_update(ids.tolist())
        if failures:
            raise failures[0]
        return ids, observations, arrays.rewards[ids], arrays.ended[ids], infos

    def _results(self, runner: Runner, count: int) -> Iterator[tuple[int, Infos | TwcError]]:
        early = [self._early.popleft() for _ in range(min(count, len(self._early)))]
        yield from early
        yield from runner.results(count - len(early))

    def _first_seeds(self, seed: int | Sequence[int]) -> list[int]:
        if not isinstance(seed, (list, tuple, range)) and not (isinstance(seed, np.ndarray) and seed.ndim == 1):
            first = whole_number("seed", seed, 0)
            return [first + k for k in self._all]
        if len(seed) != self.count:
            raise ConfigError(f"seed must be one whole number, or {self.count}, one per environment; got {len(seed)}")
        return [whole_number(f"seed[{k}]", each, 0) for k, each in enumerate(seed)]

    def _execute(self, command: int, ids: Sequence[int], seeds: Sequence[int] = ()) -> None:
        """Execute a command other than STEP in each of these environments; RESET with these seeds."""
        missing, failures = set(ids), []
        with self._running() as runner:
            runner.submit(command, ids, seeds)
            while missing:
                for k, result in runner.results(1):
                    if k not in missing:  # a step, which somebody else is to receive
                        self._early.append((k, result))
                    elif isinstance(result, TwcError):
                        failures.append(result)
                    missing.discard(k)
        if failures:
            raise failures[0]

    @contextlib.contextmanager
    def _running(self) -> Iterator[Runner]:
        """The runner; it is closed if the block is interrupted, because the next call must not read old results."""
        runner = self._open()
        with self._alone:
            try:
                yield runner
            except BaseException:
                self.close()
                raise

    def _open(self) -> Runner:
        if self._runner is None:
            raise TwcError("these environments are closed: create new ones")
        return self._runner

    def _idle(self, ids: Iterable[int]) -> list[int]:
        """The ids, if they are valid and none has a step that was not yet received."""
        self._open()
        try:
            wanted = [operator.index(k) for k in ids]
        except TypeError:
            raise ActionError(f"ids must be whole numbers from 0 to {self.count - 1}; got {ids!r}") from None
        for k in wanted:
            if not 0 <= k < self.count:
                raise ActionError(f"there is no environment {k}; ids are 0 to {self.count - 1}")
            if k in self._pending:
                raise ActionError(f"environment {k} has a step that was not yet received: call recv() first")
        if len(set(wanted)) < len(wanted):
            raise ActionError(f"each environment takes one action at a time; got ids {wanted}")
        return wanted

    def _begun(self, ids: Iterable[int]) -> list[int]:
        """`_idle`; raises TwcError before the first `reset`."""
        if None in self._episodes.seeds:
            raise TwcError("no episode has started: call reset() first")
        return self._idle(ids)

    def _checked(self, actions: Array, ids: list[int]) -> Array:
        """Actions as an array. Raises ActionError for invalid ones, before any environment has moved."""
        space, given, actions = self.action_space, actions, action_array(actions)
        wanted = (len(ids), self.robots, *(space.shape or ()))
        if actions.dtype.kind not in "biufc" or not actions.size:
            raise ActionError(f"actions must be numbers of shape {wanted}; got {type(given).__name__} {given!r:.80}")
        if actions.shape != wanted:
            raise ActionError(f"actions must have shape {wanted}, one per environment and robot; got {actions.shape}")
        low, high = (0, space.n - 1) if isinstance(space, spaces.Discrete) else (-1.0, 1.0)
        kinds = ("iu", "whole") if isinstance(space, spaces.Discrete) else ("iuf", "real")
        if actions.dtype.kind not in kinds[0]:
            raise ActionError(f"actions must be {kinds[1]} numbers from {low} to {high}; got {actions.dtype}")
        is_valid = (actions >= low - 1e-6) & (actions <= high + 1e-6)  # False for NaN
        if not is_valid.all():
            row, robot = np.argwhere(~is_valid)[0][:2]
            raise ActionError(
                f"the action of robot {robot} in environment {ids[row]} must be finite and in [{low}, {high}]; "
                f"got {actions[row, robot].tolist()}"
            )
        return actions

    def sample(self) -> Array:
        """(environments, robots, ...) random actions, within the mask if there is one."""
        space = self.action_space
        if not isinstance(space, spaces.Discrete):
            return np.array([[space.sample() for _ in self.agents] for _ in self._all])
        return np.array([[space.sample(mask.astype(np.int8)) for mask in row] for row in self.action_masks()])

    def action_masks(self, ids: Iterable[int] | None = None) -> Array:
        """(environments, robots, choices) bool: each robot's valid choices, by default in all environments.

        Raises ConfigError unless `action.kind = "frontier"`, TwcError before the first `reset`, ActionError for ids as
        `send` does.
        """
        if not isinstance(self.action_space, spaces.Discrete):
            raise ConfigError(
                f"only choices have masks: action.kind must be 'frontier'; it is {self.config.action.kind!r}"
            )
        blocks, wanted = self._arrays.observations, self._begun(self._all if ids is None else ids)
        seen = blocks["action_mask"] if "action_mask" in blocks else blocks[FLAT]  # which ends with the mask
        return seen[wanted][..., -int(self.action_space.n) :] > 0

    def states(self, ids: Iterable[int] | None = None) -> Array:
        """(environments, 6 robots) float32: the `state()` of each environment now, by default of all.

        For centralised critics; it holds ground truth. Raises as `action_masks` for ids and before `reset`.
        """
        wanted = self._begun(self._all if ids is None else ids)
        if self.config.action.kind == "velocity":
            self._execute(STATE, wanted)
        return self._arrays.states[wanted]

    def __enter__(self) -> VectorTeams:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the environments and end the worker processes."""
        runner, self._runner = self._runner, None
        if runner is not None:
            runner.close()


def _close_unless_forked(runner: Runner, owner: int) -> None:
    """Close what nobody refers to any more; a copy in a forked process must not end the workers of its parent."""
    if os.getpid() == owner:
        runner.close()


def _building_names(buildings: str | Sequence[str], family: str) -> tuple[str, ...]:
    """Names of maps that can be loaded, none or more; the name of a split stands for all of it, in this family."""
    if isinstance(buildings, str):
        if buildings in SPLITS:
            return split_names(buildings, family)
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
    return name.rpartition("/")[0] if is_of_split(name) else recipe if number.isdecimal() else name
