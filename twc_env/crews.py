"""Who plays the environments of `VectorTeams`: crews, here or in other processes, and the boards that all see."""

from __future__ import annotations

import contextlib
import math
import multiprocessing
import os
import select
import time
from collections.abc import Callable, Mapping
from multiprocessing.connection import Connection
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray as Array

from twc_env import errors
from twc_env.errors import TwcError
from twc_env.exploration.environment import ExplorationEnv
from twc_env.threads import single_threaded
from twc_env.worker_processes import deaf_to_interrupts

FLAT = ""
"""Name of the only block of flat observations."""


class Boards:
    """Arrays that all processes see: what was observed, paid and ended, and what is to be done."""

    def __init__(self, count: int, robots: int, observation: spaces.Space, action: spaces.Space):
        boxes = observation.spaces if isinstance(observation, spaces.Dict) else {FLAT: observation}
        self._shapes: dict[str, tuple[tuple[int, ...], np.dtype]] = {
            name: ((count, robots, *(box.shape or ())), np.dtype(box.dtype)) for name, box in boxes.items()
        }
        self._shapes |= {
            " rewards": ((count, robots), np.dtype(np.float32)),
            " ended": ((count,), np.dtype(bool)),
            " actions": ((count, robots, *(action.shape or ())), np.dtype(action.dtype)),
        }
        self._raw = {
            name: multiprocessing.get_context("spawn").RawArray("B", max(1, math.prod(shape) * dtype.itemsize))
            for name, (shape, dtype) in self._shapes.items()
        }
        self._view()

    def _view(self) -> None:
        views: dict[str, Array] = {
            name: np.frombuffer(self._raw[name], dtype, math.prod(shape)).reshape(shape)
            for name, (shape, dtype) in self._shapes.items()
        }
        self.rewards, self.ended, self.actions = (views.pop(f" {name}") for name in ("rewards", "ended", "actions"))
        self.blocks = views

    def __getstate__(self) -> dict:
        return {"_shapes": self._shapes, "_raw": self._raw}

    def __setstate__(self, state: dict) -> None:
        self._shapes, self._raw = state["_shapes"], state["_raw"]
        self._view()

    def observations(self) -> dict[str, Array]:
        """Copies, so that the next step does not change what the caller holds."""
        return {name: block.copy() for name, block in self.blocks.items()}

    def write(self, k: int, observations: Mapping[str, Any]) -> None:
        """Put the observations of environment k, one per robot in order, on the boards."""
        for robot, observation in enumerate(observations.values()):
            for name, block in self.blocks.items():
                block[k, robot] = observation if name == FLAT else observation[name]


class Crew:
    """Some of the environments, run one after another."""

    def __init__(self, part: list[int], boards: Boards, config: dict, buildings: tuple[str, ...]):
        self._part, self._boards, self._buildings = part, boards, buildings
        self._envs = [ExplorationEnv(config=config) for _ in part]
        self._seeds = [0] * len(part)
        self._answer: Any = None

    def send(self, what: str, seed: int) -> None:
        """Do what is told: "reset", "step" or "state"; `receive` has the answer, or the TwcError that was raised."""
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
        """The answer to what was sent last."""
        return self._answer

    def reset(self, seed: int) -> None:
        """Begin new episodes; environment k plays seed + k."""
        for i, k in enumerate(self._part):
            self._seeds[i] = seed + k
            self._boards.write(k, self._begin(i))
            self._boards.rewards[k], self._boards.ended[k] = 0.0, False

    def step(self) -> list[list[dict[str, Any]]]:
        """One step of each environment, by the actions on the boards; infos[environment][robot]."""
        answers = []
        for i, (k, env) in enumerate(zip(self._part, self._envs, strict=True)):
            actions = dict(zip(env.possible_agents, self._boards.actions[k], strict=True))
            observations, rewards, _, truncations, infos = env.step(actions)
            self._boards.rewards[k] = list(rewards.values())
            has_ended = all(truncations.values())
            self._boards.ended[k] = has_ended
            if has_ended:
                state = env.state()
                for agent, info in infos.items():
                    info["final_observation"], info["final_state"] = observations[agent], state
                self._seeds[i] += self._boards.ended.shape[0]
                observations = self._begin(i)
            self._boards.write(k, observations)
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


class Worker:
    """A crew in a process of its own."""

    def __init__(self, context, part: list[int], boards: Boards, task: tuple):
        self._pipe, theirs = context.Pipe()
        self._stay_awake = _wakefulness(self._pipe)
        self._process = context.Process(target=_work, args=(theirs, part, boards, *task), daemon=True)
        with single_threaded(), deaf_to_interrupts():
            self._process.start()
        theirs.close()

    def send(self, what: str, seed: int) -> None:
        """See `Crew`. Raises WorkerError where the process has died, as `receive` does."""
        try:
            self._pipe.send((what, seed))
        except OSError:
            raise errors.WorkerError(_LOST) from None

    def receive(self) -> Any:
        """Wait for the answer to what was sent last."""
        self._stay_awake()
        try:
            return self._pipe.recv()
        except (EOFError, OSError):
            raise errors.WorkerError(_LOST) from None

    def close(self) -> None:
        """End the process."""
        with contextlib.suppress(OSError):  # it may be gone already
            self._pipe.send(("close", 0))
        self._process.join(5.0)
        if self._process.is_alive():
            self._process.terminate()
        self._pipe.close()


_LOST = (
    "a worker process has died (out of memory, killed, or started by a script that makes environments outside "
    "`if __name__ == '__main__':`): make them anew"
)


_AWAKE_S = 1e-3
"""How long who waits for another process keeps its core awake."""


def _wakefulness(pipe: Connection) -> Callable[[], None]:
    """What waits until there is something to receive, or for a moment.

    A core that has fallen asleep takes as long to wake up as an environment takes for a step, and does not know any
    more by then what it worked on. Whoever else wants the core gets it.
    """
    if not (hasattr(os, "sched_yield") and hasattr(select, "poll")):
        return lambda: None
    coming = select.poll()
    coming.register(pipe.fileno(), select.POLLIN)

    def wait() -> None:
        end = time.monotonic() + _AWAKE_S
        while not coming.poll(0) and time.monotonic() < end:
            os.sched_yield()

    return wait


def _work(pipe: Connection, part: list[int], boards: Boards, config: dict, buildings: tuple[str, ...]) -> None:
    """The life of a worker process."""
    crew, stay_awake = Crew(part, boards, config, buildings), _wakefulness(pipe)
    while True:
        stay_awake()
        try:
            what, seed = pipe.recv()
        except (EOFError, OSError):  # the parent is gone
            return
        if what == "close":
            crew.close()
            return
        crew.send(what, seed)
        with contextlib.suppress(OSError):
            pipe.send(crew.receive())
