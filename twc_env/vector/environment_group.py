"""Some of the environments of `VectorTeams`, executed one after another in one process."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Sequence
from typing import Any

from twc_env.errors import TwcError
from twc_env.exploration.environment import ExplorationEnv
from twc_env.vector.shared_arrays import FLAT, SharedArrays, write_observations

RESET, STEP, STATE = range(3)
"""Commands to one environment."""
Infos = list[dict[str, Any]]
"""One info per robot."""


class EnvironmentGroup:
    """Environments `ids` of `arrays`. Environment k reads its actions from row k and writes its results there."""

    def __init__(self, ids: Sequence[int], arrays: SharedArrays, config: dict, buildings: tuple[str, ...]):
        self._arrays, self._buildings = arrays, buildings
        self._envs = {k: ExplorationEnv(config=config) for k in ids}
        self._writes_states = any(env.config.action.kind != "velocity" for env in self._envs.values())
        """Whether each step writes the state; with velocities, which last one time step, only `STATE` does."""
        self._seeds = dict.fromkeys(ids, 0)
        self._commands: deque[tuple[int, int, int]] = deque()

    def submit(self, command: int, ids: Sequence[int], seeds: Sequence[int] = ()) -> None:
        """Queue a command for each of these environments; RESET needs one seed per environment."""
        self._commands.extend((command, k, seed) for k, seed in zip(ids, seeds or [0] * len(ids), strict=True))

    def results(self, count: int) -> Iterator[tuple[int, Infos | TwcError]]:
        """Execute the next `count` commands; yields the environment and the result of `execute` or its TwcError."""
        for _ in range(count):
            command, k, seed = self._commands.popleft()
            try:
                yield k, self.execute(command, k, seed)
            except TwcError as error:
                yield k, error

    def execute(self, command: int, k: int, seed: int = 0) -> Infos:
        """Execute one command: RESET begins the episode of a seed, STEP returns one info per robot, STATE writes the
        state."""
        if command == RESET:
            self._seeds[k] = seed
            self._arrays.ended[k] = False
            self._begin(k)
        elif command == STEP:
            return self._step(k)
        else:
            self._arrays.states[k] = self._envs[k].state()
        return []

    def _step(self, k: int) -> Infos:
        """One step with the actions of row k. If it ends the episode, the next one begins."""
        env, arrays = self._envs[k], self._arrays
        actions = dict(zip(env.possible_agents, arrays.actions[k], strict=True))
        observations, rewards, terminations, _, infos = env.step(actions)
        arrays.rewards[k] = list(rewards.values())
        arrays.ended[k] = has_ended = not env.agents
        if has_ended:
            state = env.state()
            for agent, info in infos.items():
                info["final_observation"], info["final_state"] = self._named(observations[agent]), state
                info["is_terminated"] = terminations[agent]
            self._seeds[k] += len(arrays.ended)
            self._begin(k)
        else:
            write_observations(arrays.observations, k, observations)
            self._write_state(k)
        return list(infos.values())

    def _named(self, observation: Any) -> Any:
        """The observation with its blocks in the order of `arrays.observations`, as from environments of workers."""
        blocks = self._arrays.observations
        return observation if FLAT in blocks else {name: observation[name] for name in blocks}

    def _begin(self, k: int) -> None:
        names, seed = self._buildings, self._seeds[k]
        options = {"map": names[seed % len(names)]} if names else None
        write_observations(self._arrays.observations, k, self._envs[k].reset(seed, options)[0])
        self._write_state(k)

    def _write_state(self, k: int) -> None:
        if self._writes_states:
            self._arrays.states[k] = self._envs[k].state()

    def close(self) -> None:
        """Close the environments."""
        for env in self._envs.values():
            env.close()
