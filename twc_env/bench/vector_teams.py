"""Speed of `VectorTeams` with two worker processes against none, in lockstep and asynchronously.

The environments play recorded actions of robots that wander, so that the caller takes next to no time. All candidates
take turns, window by window of one episode; each speedup is a median over the windows.
"""

from __future__ import annotations

import contextlib
import statistics
import time
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.bench import probes as bench_probes
from twc_env.bench.rates import record_actions
from twc_env.config import EnvConfig, override
from twc_env.exploration.environment import ExplorationEnv
from twc_env.vector.teams import VectorTeams

Report = Callable[[str], None]

COUNTS = 8, 16, 32
"""Numbers of environments."""
WINDOW = 50
"""Steps of each window."""
WORKERS = 2
_KEYS = "env_steps_per_s", "lockstep_speedup", "lockstep_limit", "async_speedup"


def bench_vector(
    config: EnvConfig, counts: Sequence[int] = COUNTS, report: Report = lambda _line: None
) -> dict[str, float | None]:
    """Keys by number of environments n: vector{n}_env_steps_per_s without workers; vector{n}_lockstep_speedup with two,
    by `step`; vector{n}_lockstep_limit, the most that `step` can reach since it waits for the slower process;
    vector{n}_async_speedup with two, by `send` and `recv` of half of the environments; and two_cores_ceiling, as in
    `bench_probes`. None on a single core."""
    names = [f"vector{count}_{key}" for count in counts for key in _KEYS]
    figures: dict[str, float | None] = dict.fromkeys([*names, "two_cores_ceiling"])
    cores = bench_probes.cores()
    if len(cores) < WORKERS:
        report("one core only: two workers cannot be measured")
        return figures
    ceilings: list[float] = []
    with bench_probes.two_processes(config.map, config.max_cycles, cores) as counting:
        for count in counts:
            report(f"{count} environments, {config.max_cycles} steps each")
            rows = _windows(
                config, count, lambda: ceilings.append(bench_probes.speedup(counting, bench_probes.COUNTING))
            )
            for key, values in zip(_KEYS, np.array(rows).T, strict=True):
                figures[f"vector{count}_{key}"] = median = statistics.median(values.tolist())
                report(f"  {key}: {median:,.2f} (windows: {values.min():,.2f} to {values.max():,.2f})")
    figures["two_cores_ceiling"] = statistics.median(ceilings)
    report(f"two processes that only count: {figures['two_cores_ceiling']:.2f} x")
    return figures


def _windows(config: EnvConfig, count: int, measure_ceiling: Callable[[], None]) -> list[tuple[float, ...]]:
    """One value per key for each window."""
    actions = _recorded(config, count)
    rows: list[tuple[float, ...]] = []
    with contextlib.ExitStack() as stack:
        none, timed, lockstep, asynchronous = (
            stack.enter_context(contextlib.closing(VectorTeams(count, config, workers)))
            for workers in (0, 0, WORKERS, WORKERS)
        )
        for teams in (none, timed, lockstep, asynchronous):
            teams.reset(0)
        places = np.zeros(count, np.int64)
        for begin in range(0, len(actions), WINDOW):
            window = actions[begin : begin + WINDOW]
            none_s = _lockstep(none, window)
            lockstep_s, limit = _lockstep(lockstep, window), _lockstep_limit(timed, window)
            async_s = _asynchronous(asynchronous, actions, places, window.shape[0] * count)
            rows.append((len(window) * count / none_s, none_s / lockstep_s, limit, none_s / async_s))
            measure_ceiling()
    return rows


def _recorded(config: EnvConfig, count: int) -> Array:
    """(steps, count, robots, 2) actions, row k for a team that wanders through the episode of seed k."""
    recorder = ExplorationEnv(config=override(config, {"slam.mode": "off"}))
    episodes = [[list(step.values()) for step in record_actions(recorder, seed)] for seed in range(count)]
    return np.array(episodes, np.float32).swapaxes(0, 1).copy()


def _lockstep(teams: VectorTeams, actions: Array) -> float:
    """Seconds for these steps of all environments."""
    begin = time.perf_counter()
    for step in actions:
        teams.step(step)
    return time.perf_counter() - begin


def _lockstep_limit(teams: VectorTeams, actions: Array) -> float:
    """Speedup by two workers that do nothing but step, because each step waits for the slower one."""
    step_s = np.empty((len(actions), teams.count))
    for row, step in zip(step_s, actions, strict=True):
        teams.send(step, range(teams.count))
        for k in range(teams.count):
            begin = time.perf_counter()
            teams.recv(1)
            row[k] = time.perf_counter() - begin
    shares = [step_s[:, worker::WORKERS].sum(axis=1) for worker in range(WORKERS)]
    return float(step_s.sum() / np.max(shares, axis=0).sum())


def _asynchronous(teams: VectorTeams, actions: Array, places: Array, total: int) -> float:
    """Seconds for `total` steps in all. Environment k takes its next action, actions[places[k], k], as soon as it is
    among the half of the environments that are ready first."""
    begin = time.perf_counter()
    ids, left = np.arange(teams.count), total
    while left:
        ids = ids[:left]
        teams.send(actions[places[ids] % len(actions), ids], ids)
        places[ids] += 1
        left -= len(ids)
        ids = teams.recv(teams.count // 2)[0]
    teams.recv()
    return time.perf_counter() - begin
