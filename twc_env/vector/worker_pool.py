"""This process and the worker processes that execute the environments of `VectorTeams`.

Commands and results go through pipes, arrays through shared memory.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import pickle
import traceback
from collections import deque
from collections.abc import Iterator, Sequence
from multiprocessing.connection import Connection, wait
from typing import Any, NamedTuple

from twc_env.errors import TwcError, WorkerError
from twc_env.exploration.assessment.rewards import TERMS
from twc_env.processes.threads import single_threaded
from twc_env.processes.worker_processes import deaf_to_interrupts, end_with_parent
from twc_env.vector.environment_group import EnvironmentGroup, Infos
from twc_env.vector.shared_arrays import FLAT, SharedArrays, write_observations

_DIED = (
    "a worker process has died (out of memory, killed, or started by a script that makes environments outside "
    "`if __name__ == '__main__':`): create them again"
)
Order = tuple[int, int, int]
"""A command, the environment that executes it, and a seed, which RESET needs."""


class WorkerPool:
    """This process and its worker processes, each with a share of the environments; k belongs to process k modulo
    `processes`.

    Same interface as `EnvironmentGroup`, except that results come in the order in which they are ready. This process
    steps environments of its own whenever no result of another process is ready.
    """

    def __init__(self, count: int, processes: int, arrays: SharedArrays, config: dict, buildings: tuple[str, ...]):
        self._arrays, self._processes = arrays, processes
        self._workers: list[_Worker] = []
        for number in range(1, processes):
            self._workers.append(_Worker(range(number, count, processes), arrays, config, buildings))
        self._pipes = [worker.pipe for worker in self._workers]
        self._own = EnvironmentGroup(range(0, count, processes), arrays, config, buildings)
        self._own_left = 0
        self._since_own = 0
        """Results of other processes since the last of this one."""
        self._ready: deque[tuple[int, Any]] = deque()
        self._is_closed = False

    def submit(self, command: int, ids: Sequence[int], seeds: Sequence[int] = ()) -> None:
        """Start a command in each of these environments, none of which may have a result that was not yet taken.
        RESET needs one seed per environment.

        Raises WorkerError if a process has died.
        """
        shares: list[list[Order]] = [[] for _ in range(self._processes)]
        for k, seed in zip(ids, seeds or [0] * len(ids), strict=True):
            shares[k % self._processes].append((command, k, seed))
        own, *others = shares
        for worker, orders in zip(self._workers, others, strict=True):
            if orders:
                worker.submit(orders)
        self._own.submit(command, [k for _, k, _ in own], [seed for _, _, seed in own])
        self._own_left += len(own)

    def results(self, count: int) -> Iterator[tuple[int, Infos | TwcError]]:
        """The next `count` results as they become ready. Raises WorkerError if a process has died, and any other error
        of an environment than a TwcError as it was raised there."""
        for _ in range(count):
            if not self._ready:
                self._collect(0.0)
            is_own_turn = not self._ready or self._since_own >= 2 * self._processes
            if is_own_turn and self._own_left:
                self._own_left -= 1
                self._since_own = 0
                yield from self._own.results(1)
                continue
            if not self._ready:
                self._collect(None)
            self._since_own += 1
            k, message = self._ready.popleft()
            yield k, self._result(k, message)

    def _collect(self, patience_s: float | None) -> None:
        """Read all results that are there, or come within this time; None: until there is one."""
        try:
            for pipe in wait(self._pipes, patience_s):
                assert isinstance(pipe, Connection)
                self._ready.append(pipe.recv())
                while pipe.poll():
                    self._ready.append(pipe.recv())
        except (EOFError, OSError):
            raise WorkerError(_DIED) from None

    def _result(self, k: int, message: Any) -> Infos | TwcError:
        arrays = self._arrays
        if message is None:
            return [{"reward_terms": dict(zip(TERMS, row, strict=True))} for row in arrays.reward_terms[k].tolist()]
        if isinstance(message, _Raised):
            raise message.error from RuntimeError(message.trace)
        if not isinstance(message, TwcError) and message and arrays.ended[k]:
            state = arrays.final_states[k].copy()
            for robot, info in enumerate(message):
                blocks = {name: block[k, robot].copy() for name, block in arrays.final_observations.items()}
                info["final_observation"], info["final_state"] = blocks.get(FLAT, blocks), state
        return message

    def close(self) -> None:
        """End the processes; those that do not end within five seconds are terminated. Again: nothing happens."""
        if self._is_closed:
            return
        self._is_closed = True
        for worker in self._workers:
            worker.tell_to_end()
        for worker in self._workers:
            worker.close()
        self._own.close()


class _Raised(NamedTuple):
    """An error other than a TwcError in an environment of a worker process, and its traceback there."""

    error: Exception
    trace: str


class _Worker:
    """One worker process, seen from its parent."""

    def __init__(self, ids: range, *task: Any):
        context = multiprocessing.get_context("spawn")
        self.pipe, theirs = context.Pipe()
        self._process = context.Process(target=_work, args=(list(ids), theirs, *task), daemon=True)
        with single_threaded(), deaf_to_interrupts():
            self._process.start()
        theirs.close()

    def submit(self, orders: list[Order] | None) -> None:
        """Execute these, one after another; None: end. Raises WorkerError if the process has died."""
        try:
            self.pipe.send(orders)
        except OSError:
            raise WorkerError(_DIED) from None

    def tell_to_end(self) -> None:
        """End after the present commands."""
        with contextlib.suppress(WorkerError):
            self.submit(None)

    def close(self) -> None:
        """Wait for the end of the process."""
        self._process.join(5.0)
        for end in (self._process.terminate, self._process.kill):
            if self._process.is_alive():
                end()
                self._process.join(5.0)
        self.pipe.close()


def _work(ids: list[int], pipe: Connection, arrays: SharedArrays, config: dict, buildings: tuple[str, ...]) -> None:
    """Main function of a worker process: execute commands until there are no more."""
    end_with_parent()
    group = EnvironmentGroup(ids, arrays, config, buildings)
    with contextlib.suppress(EOFError, OSError):  # the parent does not listen any more
        while (orders := pipe.recv()) is not None:
            for order in orders:
                pipe.send((order[1], _answer(group, order, arrays)))
    group.close()


def _answer(group: EnvironmentGroup, order: Order, arrays: SharedArrays) -> Infos | TwcError | _Raised | None:
    """Execute one order; what to send of its result, see `_share`."""
    try:
        return _share(group.execute(*order), order[1], arrays)
    except TwcError as error:
        return error
    except Exception as error:  # of code of the user's own, such as a recogniser
        return _portable(error)


def _portable(error: Exception) -> _Raised:
    """What to send of an error; a RuntimeError that names it, if it cannot be pickled."""
    trace = "\n" + "".join(traceback.format_exception(error))
    try:
        pickle.loads(pickle.dumps(error))
    except Exception:  # of any kind, since pickling calls methods of the error
        error = RuntimeError(f"an environment in a worker process raised {type(error).__name__}: {error}")
    return _Raised(error, trace)


def _share(infos: Infos, k: int, arrays: SharedArrays) -> Infos | None:
    """Write what the infos of environment k hold in most steps to shared memory; returns what is left of them."""
    if all(len(info) == 1 for info in infos):
        if infos:
            arrays.reward_terms[k] = [list(info["reward_terms"].values()) for info in infos]
        return None
    if arrays.ended[k] and "final_state" in infos[0]:
        arrays.final_states[k] = infos[0]["final_state"]
        finals = {str(robot): info.pop("final_observation") for robot, info in enumerate(infos)}
        write_observations(arrays.final_observations, k, finals)
        for info in infos:
            del info["final_state"]
    return infos
