"""Measurements in separate processes: start-up time, memory per environment, two worker processes.

`twc-env.bench.probes PROBE ...` runs one measurement and prints its figure.
"""

from __future__ import annotations

import contextlib
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from typing import Any

Report = Callable[[str], None]

_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")
_WARM_STARTS = 3
_MEMORY_MAP, _MEMORY_ENVS = "gen:office:1000:{}", 4
_ROUNDS = 21
COUNTING, _TURNS = "counting", 1_000_000
"""A task without memory access, and its length: its speed-up on two cores is the upper limit of this machine."""


def probe(map_name: str, steps: int, report: Report) -> dict[str, float | None]:
    """first_step_cold_s, all_kernels_cold_s, first_step_warm_s (and their CPU times), memory_per_env_mb,
    workers2_speedup and two_cores_ceiling."""
    figures: dict[str, float | None] = {}
    with tempfile.TemporaryDirectory() as folder:
        own_cache = {"NUMBA_CACHE_DIR": folder}
        starts = [json.loads(_run(["first_step", map_name], own_cache)) for _ in range(1 + _WARM_STARTS)]
    for column, key in enumerate(("s", "cpu_s")):
        figures[f"first_step_cold_{key}"] = starts[0][column]
        figures[f"all_kernels_cold_{key}"] = starts[0][2 + column]
        figures[f"first_step_warm_{key}"] = statistics.median(start[column] for start in starts[1:])
    for kind, what in (
        ("first_step_cold", "first step, no kernel compiled yet"),
        ("all_kernels_cold", "the end of compilation beside it"),
        ("first_step_warm", "first step, kernels on disk"),
    ):
        report(f"import to {what}: {figures[f'{kind}_s']:.2f} s ({figures[f'{kind}_cpu_s']:.2f} s of CPU time)")
    figures["memory_per_env_mb"] = float(_run(["memory", str(steps)]))
    report(f"memory of one environment of 1,000 m2: {figures['memory_per_env_mb']:.1f} MB")
    return figures | two_workers(map_name, steps, report)


def two_workers(map_name: str, steps: int, report: Report) -> dict[str, float | None]:
    """workers2_speedup: steps per second of two simultaneous worker processes over those of one. two_cores_ceiling: the
    same for processes that only count, the most that this machine provided at that time. None on a single core.

    Medians over many short rounds: the first worker alone, then both, then the second alone.
    """
    figures: dict[str, float | None] = {"workers2_speedup": None, "two_cores_ceiling": None}
    available = cores()
    if len(available) < 2:
        report("one core only: two workers cannot be measured")
        return figures
    ratios: dict[str, list[float]] = {name: [] for name in figures}
    with two_processes(map_name, steps, available) as workers:
        _rates(workers, "0")  # kernels are compiled or read from disk
        for seed in range(_ROUNDS):
            for name, task in zip(figures, (str(seed), COUNTING), strict=True):
                ratios[name].append(speedup(workers, task))
    for (name, rounds), what in zip(ratios.items(), ("two workers against one", "two that only count"), strict=True):
        figures[name] = statistics.median(rounds)
        report(f"{what}: {figures[name]:.2f} x (rounds: {min(rounds):.2f} to {max(rounds):.2f})")
    return figures


def cores() -> list[int]:
    """The cores that this process may use."""
    return sorted(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else list(range(os.cpu_count() or 1))


@contextlib.contextmanager
def two_processes(map_name: str, steps: int, available: list[int]) -> Iterator[list[subprocess.Popen]]:
    """Two processes that execute tasks, on the first two of these cores."""
    workers = [_start(["worker", map_name, str(steps), str(core)]) for core in available[:2]]
    try:
        yield workers
    finally:
        for worker in workers:
            _end(worker)


def speedup(workers: list[subprocess.Popen], task: str) -> float:
    """Rate at which two processes do a task over that of one: the first alone, then both, then the second alone."""
    first, both, second = (_rates(some, task) for some in (workers[:1], workers, workers[1:]))
    return sum(both) / statistics.mean(first + second)


def _rates(workers: list[subprocess.Popen], task: str) -> list[float]:
    """Rate [1/s] at which each of these workers does a task, each on its own core, started simultaneously."""
    _answers(workers, task)
    return [1.0 / seconds for seconds in _answers(workers, "go")]


def _answers(workers: list[subprocess.Popen], word: str) -> list[Any]:
    """Send a word to all workers, then read the answer of each."""
    try:
        for worker in workers:
            assert worker.stdin is not None
            worker.stdin.write(f"{word}\n")
            worker.stdin.flush()
        lines = [worker.stdout.readline() for worker in workers if worker.stdout is not None]
    except BrokenPipeError:  # a broken pipe of our own output would end the command silently
        lines = [""]
    if not all(lines):
        raise RuntimeError("a worker of the probe came to an end: see its message above")
    return [json.loads(line) for line in lines]


def _end(worker: subprocess.Popen) -> None:
    """Stop a worker, whatever its state."""
    worker.kill()
    worker.wait()
    for stream in (worker.stdin, worker.stdout):
        assert stream is not None
        with contextlib.suppress(BrokenPipeError):
            stream.close()


def _start(arguments: list[str], environment: dict[str, str] | None = None) -> subprocess.Popen:
    """Start a probe with one thread, which writes bytecode as usual."""
    inherited = {key: value for key, value in os.environ.items() if key != "PYTHONDONTWRITEBYTECODE"}
    pinned = dict.fromkeys(_THREADS, "1")
    return subprocess.Popen(
        [sys.executable, "-m", __name__, *arguments],
        env={**inherited, **pinned, **(environment or {})},
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )


def _run(arguments: list[str], environment: dict[str, str] | None = None) -> str:
    process = _start(arguments, environment)
    output, _ = process.communicate()
    if process.returncode != 0:
        raise RuntimeError(f"the probe {' '.join(arguments)} failed: see its message above")
    return output.strip()


def _first_step(map_name: str) -> list[float]:
    """Wall and CPU seconds from before the import to the end of the first step; then until all kernels are compiled."""
    wall, cpu = time.perf_counter(), sum(os.times()[:4])
    import numpy as np

    import twc_env
    from twc_env.exploration.warm_up import compile_all

    env = twc_env.parallel_env(map=map_name)
    env.reset(seed=0)
    env.step(dict.fromkeys(env.agents, np.zeros(2, np.float32)))
    first = [time.perf_counter() - wall, sum(os.times()[:4]) - cpu]
    compile_all()
    return [*first, time.perf_counter() - wall, sum(os.times()[:4]) - cpu]


def _memory_mb(steps: int) -> float:
    """Resident memory [MB] of each further environment, each in another building, after an episode."""
    from twc_env.bench.memory import growth_mb

    return growth_mb(lambda k: _played(_MEMORY_MAP.format(100 + k), steps), _MEMORY_ENVS)


def _played(map_name: str, steps: int) -> Any:
    from twc_env.bench.rates import wander
    from twc_env.exploration.environment import ExplorationEnv

    env = ExplorationEnv(map=map_name, max_cycles=steps)
    env.reset(seed=0)
    for actions in wander(env, 0):
        env.step(actions)
    return env


def _worker(map_name: str, steps: int, core: int, hear: Iterator[str], say: Callable[[str], object]) -> None:
    """For each task that is read (the seed of an episode, or counting): answer that it is ready, await the next line,
    run it and answer with its duration [s]."""
    from twc_env.bench.rates import record_actions
    from twc_env.config import EnvConfig, override
    from twc_env.exploration.environment import ExplorationEnv

    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {core})
    config = override(EnvConfig(), {"map": map_name, "max_cycles": steps})
    env, recorder = ExplorationEnv(config=config), ExplorationEnv(config=override(config, {"slam.mode": "off"}))
    for task in map(str.strip, hear):
        actions = [] if task == COUNTING else record_actions(recorder, int(task))
        if actions:
            env.reset(seed=int(task))
        say('"ready"\n')
        next(hear)
        begin = time.monotonic()
        for action in actions:
            env.step(action)
        if not actions:
            _count()
        say(json.dumps(time.monotonic() - begin) + "\n")


def _count() -> int:
    number = 1
    for _ in range(_TURNS):
        number = (number * 5 + 1) & 0xFFFF
    return number


def main(arguments: list[str]) -> None:
    """Run one probe; the figure goes to standard output."""

    def say(text: str) -> None:
        sys.stdout.write(text)
        sys.stdout.flush()

    name, *rest = arguments
    if name == "first_step":
        say(json.dumps(_first_step(rest[0])) + "\n")
    elif name == "memory":
        say(f"{_memory_mb(int(rest[0]))}\n")
    elif name == "worker":
        _worker(rest[0], int(rest[1]), int(rest[2]), iter(sys.stdin.readline, ""), say)
    else:
        raise ValueError(f"no probe named {name!r}")


if __name__ == "__main__":
    main(sys.argv[1:])
