"""This process and the worker processes that execute the environments of `VectorTeams`."""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import pickle
import sys
import time
import traceback
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from multiprocessing.connection import Connection
from typing import Any, NamedTuple

from twc_env.errors import TwcError, WorkerError
from twc_env.exploration.assessment.rewards import TERMS
from twc_env.running.threads import single_threaded
from twc_env.running.worker_processes import deaf_to_interrupts
from twc_env.vector.environment_group import RESET, EnvironmentGroup, Infos
from twc_env.vector.shared_arrays import FLAT, SharedArrays, write_observations

_CHECK_S = 0.1
"""How often a process that waits for another checks whether that one is alive."""
_SPIN_S = 1e-3
"""How long a process polls before it blocks."""
_NEVER = sys.maxsize
_DIED = (
    "a worker process has died (out of memory, killed, or started by a script that makes environments outside "
    "`if __name__ == '__main__':`): create them again"
)


class WorkerPool:
    """This process and its worker processes, each with a share of the environments; k belongs to process k modulo
    `processes`.

    Same interface as `EnvironmentGroup`, except that results come in the order in which they are ready. This process
    steps environments of its own whenever no result of another process is ready.
    """

    def __init__(self, count: int, processes: int, arrays: SharedArrays, config: dict, buildings: tuple[str, ...]):
        context = multiprocessing.get_context("spawn")
        self._arrays, self._processes, self._wake_up = arrays, processes, _WakeUp(context, processes - 1)
        self._workers: list[_Worker] = []
        for number in range(processes - 1):
            ids = range(number + 1, count, processes)
            self._workers.append(_Worker(context, number, ids, self._wake_up, arrays, config, buildings))
        self._own = EnvironmentGroup(range(0, count, processes), arrays, config, buildings)
        self._own_left = 0
        self._since_own = 0
        """Results of other processes since the last of this one."""
        self._ready: deque[int] = deque()
        self._is_closed = False

    def submit(self, command: int, ids: Sequence[int], seeds: Sequence[int] = ()) -> None:
        """Start a command in each of these environments, none of which may have a result that was not yet taken.
        RESET needs one seed per environment.

        Raises WorkerError if a process has died.
        """
        own: dict[int, int] = {}
        for k, seed in zip(ids, seeds or [0] * len(ids), strict=True):
            number = k % self._processes
            if number:
                self._workers[number - 1].submit(command, k, seed)
            else:
                own[k] = seed
        self._own.submit(command, list(own), list(own.values()))
        self._own_left += len(own)

    def results(self, count: int) -> Iterator[tuple[int, Infos | TwcError]]:
        """The next `count` results as they become ready. Raises WorkerError if a process has died, and any other error
        of an environment than a TwcError as it was raised there."""
        for left in range(count, 0, -1):
            if not self._ready:
                self._collect()
            is_own_turn = not self._ready or self._since_own >= 2 * self._processes
            if is_own_turn and self._own_left:
                self._own_left -= 1
                self._since_own = 0
                yield from self._own.results(1)
                continue
            if not self._ready:
                self._wait(left)
            self._since_own += 1
            k = self._ready.popleft()
            yield k, self._result(k)

    def _collect(self) -> None:
        for worker in self._workers:
            self._ready.extend(worker.ready())

    def _wait(self, count: int) -> None:
        """Wait until `count` more results of workers are ready, or any when the time is up."""
        taken = sum(worker.taken for worker in self._workers)
        while not self._ready:
            if not self._wake_up.wait(taken + count) and not all(worker.is_alive() for worker in self._workers):
                raise WorkerError(_DIED)
            self._collect()

    def _result(self, k: int) -> Infos | TwcError:
        arrays = self._arrays
        if not arrays.has_message[k]:
            return [{"reward_terms": dict(zip(TERMS, row, strict=True))} for row in arrays.reward_terms[k].tolist()]
        message = self._workers[k % self._processes - 1].message()
        if isinstance(message, _Raised):
            raise message.error from RuntimeError(message.trace)
        if not isinstance(message, TwcError) and message and arrays.ended[k]:
            state = arrays.states[k].copy()
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
        self._wake_up.close()
        self._own.close()


class _Raised(NamedTuple):
    """An error other than a TwcError in an environment of a worker process, and its traceback there."""

    error: Exception
    trace: str


class _Bell:
    """Wakes one process when another one has changed shared memory that it waits for.

    Of pipes, since named semaphores outlive a process that is killed.
    """

    def __init__(self, context: Any):
        self._receiver, self._sender = context.Pipe(duplex=False)
        self._is_blocked = context.RawArray("b", 1)

    def ring(self) -> None:
        """Wake the process that waits, after the change."""
        if self._is_blocked[0]:
            self._is_blocked[0] = 0
            with contextlib.suppress(OSError):
                self._sender.send_bytes(b"")

    def wait(self, is_over: Callable[[], bool]) -> bool:
        """Wait for a condition, but not for long; returns whether it holds. Polls for `_SPIN_S` before it blocks.

        Waking an idle core takes as long as a step of an environment, and its caches are cold afterwards.
        """
        if hasattr(os, "sched_yield"):
            end = time.monotonic() + _SPIN_S
            while time.monotonic() < end:
                if is_over():
                    return True
                os.sched_yield()
        self._is_blocked[0] = 1
        if not is_over() and self._receiver.poll(_CHECK_S):
            self._receiver.recv_bytes()
        self._is_blocked[0] = 0
        return is_over()

    def close(self) -> None:
        """Release the pipe."""
        self._receiver.close()
        self._sender.close()


class _WakeUp:
    """Wakes the parent process when as many results are ready as it waits for, and not for each of them."""

    def __init__(self, context: Any, workers: int):
        self._bell = _Bell(context)
        self._done = context.RawArray("q", workers)
        self._wanted = context.RawArray("q", [_NEVER])

    def done(self, worker: int) -> int:
        """Number of results that this worker has written so far."""
        return self._done[worker]

    def add(self, worker: int) -> None:
        """One more result of this worker."""
        self._done[worker] += 1
        if sum(self._done) >= self._wanted[0]:
            self._bell.ring()

    def wait(self, total: int) -> bool:
        """Wait until there are `total` results since the start, but not for long; returns whether there are."""
        self._wanted[0] = total
        is_over = self._bell.wait(lambda: sum(self._done) >= total)
        self._wanted[0] = _NEVER
        return is_over

    def close(self) -> None:
        """Release what was allocated."""
        self._bell.close()


class _Worker:
    """One worker process, seen from its parent."""

    def __init__(self, context: Any, number: int, ids: range, wake_up: _WakeUp, arrays: SharedArrays, *task: Any):
        self._pipe, theirs = context.Pipe()
        self._queue = _Queue(context, len(ids))
        self._number, self._wake_up = number, wake_up
        self.taken = 0
        arguments = (number, list(ids), theirs, self._queue, wake_up, arrays, *task)
        self._process = context.Process(target=_work, args=arguments, daemon=True)
        with single_threaded(), deaf_to_interrupts():
            self._process.start()
        theirs.close()

    def submit(self, command: int, k: int, seed: int) -> None:
        """See `WorkerPool`."""
        if command == RESET:
            try:
                self._pipe.send(seed)
            except OSError:
                raise WorkerError(_DIED) from None
        self._queue.put(command, k)

    def ready(self) -> list[int]:
        """The environments whose results are ready and were not yet taken."""
        done = self._wake_up.done(self._number)
        ids = [self._queue.results[place % len(self._queue.results)] for place in range(self.taken, done)]
        self.taken = done
        return ids

    def message(self) -> Any:
        """What the worker sent along with a result."""
        try:
            return self._pipe.recv()
        except (EOFError, OSError):
            raise WorkerError(_DIED) from None

    def is_alive(self) -> bool:
        """Whether the process runs."""
        return self._process.is_alive()

    def tell_to_end(self) -> None:
        """End after the current command."""
        self._queue.close()

    def close(self) -> None:
        """Wait for the end of the process."""
        self._process.join(5.0)
        if self._process.is_alive():
            self._process.terminate()
        self._pipe.close()
        self._queue.release()


class _Queue:
    """Commands to a worker and its results, as rings in shared memory; an environment has one of them at a time."""

    def __init__(self, context: Any, size: int):
        self.results = context.RawArray("q", size)
        """Environments whose command was executed, in order."""
        self._commands, self._ids = context.RawArray("q", size), context.RawArray("q", size)
        self._is_closed = context.RawArray("b", 1)
        self._count = context.RawArray("q", 1)
        """Commands added so far."""
        self._bell = _Bell(context)
        self._place = 0

    def put(self, command: int, k: int) -> None:
        """Add a command for environment k."""
        place = self._count[0] % len(self._ids)
        self._commands[place], self._ids[place] = command, k
        self._count[0] += 1
        self._bell.ring()

    def get(self) -> tuple[int, int] | None:
        """Wait for the next command and its environment; None where there will be none."""
        while not self._bell.wait(self._has_next):
            parent = multiprocessing.parent_process()
            if parent is None or not parent.is_alive():
                return None
        if self._is_closed[0]:
            return None
        place = self._place % len(self._ids)
        self._place += 1
        return self._commands[place], self._ids[place]

    def close(self) -> None:
        """Add no more commands; those that wait are dropped."""
        self._is_closed[0] = 1
        self._bell.ring()

    def release(self) -> None:
        """Release what was allocated, after the end of the worker."""
        self._bell.close()

    def _has_next(self) -> bool:
        return bool(self._count[0] > self._place or self._is_closed[0])


def _work(
    number: int,
    ids: list[int],
    pipe: Connection,
    queue: _Queue,
    wake_up: _WakeUp,
    arrays: SharedArrays,
    config: dict,
    buildings: tuple[str, ...],
) -> None:
    """Main function of a worker process: execute commands until there are no more."""
    group, place = EnvironmentGroup(ids, arrays, config, buildings), 0
    while (order := queue.get()) is not None:
        command, k = order
        message: Infos | TwcError | _Raised | None
        try:
            message = _share(group.execute(command, k, pipe.recv() if command == RESET else 0), k, arrays)
        except EOFError:  # the parent has died
            return
        except TwcError as error:
            message = error
        except Exception as error:  # of code of the user's own, such as a recogniser
            message = _portable(error)
        arrays.has_message[k] = message is not None
        queue.results[place % len(ids)] = k
        place += 1
        wake_up.add(number)
        if message is not None:
            with contextlib.suppress(OSError):
                pipe.send(message)
    group.close()


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
        arrays.states[k] = infos[0]["final_state"]
        finals = {str(robot): info.pop("final_observation") for robot, info in enumerate(infos)}
        write_observations(arrays.final_observations, k, finals)
        for info in infos:
            del info["final_state"]
    return infos
