"""Groups of environments that `VectorTeams` steps, in this process or in worker processes."""

from __future__ import annotations

import contextlib
import os
import select
import time
from collections.abc import Callable
from multiprocessing.connection import Connection
from typing import Any

import numpy as np

from twc_env import errors
from twc_env.errors import TwcError
from twc_env.exploration.environment import ExplorationEnv
from twc_env.shared_arrays import SharedArrays
from twc_env.threads import single_threaded
from twc_env.worker_processes import deaf_to_interrupts


class EnvironmentGroup:
    """Some of the environments, stepped one after another in this process."""

    def __init__(self, ids: list[int], arrays: SharedArrays, config: dict, buildings: tuple[str, ...]):
        self._ids, self._arrays, self._buildings = ids, arrays, buildings
        self._envs = [ExplorationEnv(config=config) for _ in ids]
        self._seeds = [0] * len(ids)
        self._answer: Any = None

    def send(self, what: str, seed: int) -> None:
        """Execute a command, "reset", "step" or "state"; `receive` returns its result or the TwcError it raised."""
        try:
            self._answer = None
            if what == "reset":
                self.reset(seed)
            elif what == "state":
                self._answer = np.array([env.state() for env in self._envs])
            else:
                self._answer = self.step()
        except TwcError as error:
            self._answer = error

    def receive(self) -> Any:
        """The result of the last command."""
        return self._answer

    def reset(self, seed: int) -> None:
        """Begin new episodes; environment k plays seed + k."""
        for i, k in enumerate(self._ids):
            self._seeds[i] = seed + k
            self._arrays.write(k, self._begin(i))
            self._arrays.rewards[k], self._arrays.ended[k] = 0.0, False

    def step(self) -> list[list[dict[str, Any]]]:
        """One step of each environment with the actions in shared memory; returns infos[environment][robot]."""
        answers = []
        for i, (k, env) in enumerate(zip(self._ids, self._envs, strict=True)):
            actions = dict(zip(env.possible_agents, self._arrays.actions[k], strict=True))
            observations, rewards, _, truncations, infos = env.step(actions)
            self._arrays.rewards[k] = list(rewards.values())
            has_ended = all(truncations.values())
            self._arrays.ended[k] = has_ended
            if has_ended:
                state = env.state()
                for agent, info in infos.items():
                    info["final_observation"], info["final_state"] = observations[agent], state
                self._seeds[i] += self._arrays.ended.shape[0]
                observations = self._begin(i)
            self._arrays.write(k, observations)
            answers.append(list(infos.values()))
        return answers

    def _begin(self, i: int) -> dict[str, Any]:
        names = self._buildings
        options = {"map": names[self._seeds[i] % len(names)]} if names else None
        return self._envs[i].reset(self._seeds[i], options)[0]

    def close(self) -> None:
        """Close the environments."""
        for env in self._envs:
            env.close()


class WorkerProcess:
    """An environment group in a process of its own."""

    def __init__(self, context, ids: list[int], arrays: SharedArrays, task: tuple):
        self._pipe, theirs = context.Pipe()
        self._spin = _spinner(self._pipe)
        self._process = context.Process(target=_work, args=(theirs, ids, arrays, *task), daemon=True)
        with single_threaded(), deaf_to_interrupts():
            self._process.start()
        theirs.close()

    def send(self, what: str, seed: int) -> None:
        """See `EnvironmentGroup`. Raises WorkerError if the process has died; so does `receive`."""
        try:
            self._pipe.send((what, seed))
        except OSError:
            raise errors.WorkerError(_DIED) from None

    def receive(self) -> Any:
        """Wait for the result of the last command."""
        self._spin()
        try:
            return self._pipe.recv()
        except (EOFError, OSError):
            raise errors.WorkerError(_DIED) from None

    def close(self) -> None:
        """End the process; one that does not end within five seconds is terminated."""
        with contextlib.suppress(OSError):  # it may be gone already
            self._pipe.send(("close", 0))
        self._process.join(5.0)
        if self._process.is_alive():
            self._process.terminate()
        self._pipe.close()


_DIED = (
    "a worker process has died (out of memory, killed, or started by a script that makes environments outside "
    "`if __name__ == '__main__':`): create them again"
)


_SPIN_S = 1e-3
"""How long a process polls before it blocks."""


def _spinner(pipe: Connection) -> Callable[[], None]:
    """A function that polls the pipe until it is readable, at most `_SPIN_S`, and yields the core to other processes.

    Waking an idle core takes as long as a step of an environment, and its caches are cold afterwards.
    """
    if not (hasattr(os, "sched_yield") and hasattr(select, "poll")):
        return lambda: None
    readable = select.poll()
    readable.register(pipe.fileno(), select.POLLIN)

    def wait() -> None:
        end = time.monotonic() + _SPIN_S
        while not readable.poll(0) and time.monotonic() < end:
            os.sched_yield()

    return wait


def _work(pipe: Connection, ids: list[int], arrays: SharedArrays, config: dict, buildings: tuple[str, ...]) -> None:
    """Main function of a worker process: execute commands until told to close."""
    group, spin = EnvironmentGroup(ids, arrays, config, buildings), _spinner(pipe)
    while True:
        spin()
        try:
            what, seed = pipe.recv()
        except (EOFError, OSError):  # the parent has died
            return
        if what == "close":
            group.close()
            return
        group.send(what, seed)
        with contextlib.suppress(OSError):
            pipe.send(group.receive())
