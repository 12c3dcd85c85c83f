"""Speed of `VectorTeams` with two worker processes against none, and against `gymnasium.vector` with the same teams.

The environments play recorded actions of robots that wander, so that the caller takes next to no time. All candidates
take turns, window by window of one episode and each time another one first, and what is compared are windows of the
same actions; each figure is a median over them.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import statistics
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from gymnasium.vector import AsyncVectorEnv, SyncVectorEnv
from numpy.typing import NDArray as Array

from twc_env.bench import probes as bench_probes
from twc_env.bench.gymnasium_teams import GymnasiumTeams
from twc_env.bench.rates import record_actions
from twc_env.config import EnvConfig, override
from twc_env.exploration.environment import ExplorationEnv
from twc_env.processes.process_memory import proportional_mb
from twc_env.processes.threads import single_threaded
from twc_env.vector.teams import VectorTeams

Report = Callable[[str], None]

COUNTS = 8, 16
"""Numbers of environments."""
WINDOW = 50
"""Steps of each window."""
WORKERS = 2
NONE = "VectorTeams, no workers"
_CLOCK_HZ = os.sysconf("SC_CLK_TCK") if hasattr(os, "sysconf") else 100


@dataclass
class _Candidate:
    """One way to run the same environments, and what it has cost so far."""

    name: str
    env: Any
    play: Callable[[Array], object]
    """Executes a window of actions (steps, environments, robots, 2)."""
    processes: list[int]
    """The processes that it has started."""
    start_s: float
    """Until the first observations."""
    wall_s: list[float] = field(default_factory=list)
    """Per window."""
    cpu_s: list[float] = field(default_factory=list)
    """Per window, of all processes."""

    def timed(self, window: Array) -> None:
        """Play a window."""
        cpu_s, begin = self._cpu_s(), time.perf_counter()
        self.play(window)
        self.wall_s.append(time.perf_counter() - begin)
        self.cpu_s.append(self._cpu_s() - cpu_s)

    def _cpu_s(self) -> float:
        return sum(map(_cpu_s, [os.getpid(), *self.processes]))

    def row(self, none: _Candidate, steps: int) -> dict[str, Any]:
        """Figures of this candidate; steps: of all environments together in a window."""
        of_window = np.array(none.wall_s) / np.array(self.wall_s)
        low, median, high = np.percentile(of_window, [25, 50, 75]).tolist()
        return {
            "how": self.name,
            "speedup": median,
            "quartiles": f"{low:.2f} to {high:.2f}",
            "steps_per_s": steps / statistics.median(self.wall_s),
            "cpu_ms_per_step": 1e3 * sum(self.cpu_s) / len(self.cpu_s) / steps,
            "processes": 1 + len(self.processes),
            "memory_mb": sum(map(proportional_mb, self.processes)),
            "start_s": self.start_s,
        }


def bench_vector(
    config: EnvConfig, counts: Sequence[int] = COUNTS, report: Report = lambda _line: None
) -> dict[str, Any]:
    """`vector`: one row per number of environments and way to run them, with speedup over VectorTeams without workers
    (`quartiles` over the windows), CPU time of all processes, memory of those beside the calling one (shared pages
    count once) and seconds to the first observations. `lockstep_limit{n}`: the most that `step` of VectorTeams can
    reach, since it waits for the slower process. `two_cores_ceiling`: as in `bench_probes`; both None on a single core.
    """
    cores = bench_probes.cores()
    figures: dict[str, Any] = {"vector": [], "two_cores_ceiling": None, **{f"lockstep_limit{n}": None for n in counts}}
    if len(cores) < WORKERS:
        report("one core only: two workers cannot be measured")
        return figures
    ceilings: list[float] = []
    with bench_probes.two_processes(config.map, config.max_cycles, cores) as counting:
        for count in counts:
            report(f"{count} environments, {config.max_cycles} steps each")
            rows, limit = _compared(
                config, count, lambda: ceilings.append(bench_probes.speedup(counting, bench_probes.COUNTING))
            )
            figures["vector"] += rows
            figures[f"lockstep_limit{count}"] = limit
            for row in rows:
                report(f"  {row['how']}: {row['speedup']:.2f} x (quartiles of the windows: {row['quartiles']})")
    figures["two_cores_ceiling"] = statistics.median(ceilings)
    return figures


def _compared(config: EnvConfig, count: int, measure_ceiling: Callable[[], None]) -> tuple[list[dict[str, Any]], float]:
    """The rows of this number of environments, and the limit of `step`."""
    actions, limits = _recorded(config, count), []
    with contextlib.ExitStack() as stack:
        candidates = [_started(stack, *kind) for kind in _kinds(config, count, actions)]
        timed = stack.enter_context(VectorTeams(count, config))
        timed.reset(0)
        for place, begin in enumerate(range(0, len(actions), WINDOW)):
            window = actions[begin : begin + WINDOW]
            first = place % len(candidates)
            for candidate in candidates[first:] + candidates[:first]:
                candidate.timed(window)
            limits.append(_lockstep_limit(timed, window))
            measure_ceiling()
        steps = min(WINDOW, len(actions)) * count
        rows = [{"environments": count, **each.row(candidates[0], steps)} for each in candidates]
    return rows, statistics.median(limits)


def _kinds(config: EnvConfig, count: int, actions: Array) -> list[tuple[str, Callable[[], Any], Callable]]:
    """Name, constructor, and the function that plays a window of actions."""
    team = partial(GymnasiumTeams, config, 1)
    group = partial(GymnasiumTeams, config, count // WORKERS)
    places = np.zeros(count, np.int64)
    return [
        (NONE, partial(VectorTeams, count, config), _lockstep),
        ("VectorTeams.step, two workers", partial(VectorTeams, count, config, WORKERS), _lockstep),
        (
            "VectorTeams.send and recv, two workers",
            partial(VectorTeams, count, config, WORKERS),
            lambda teams, window: _asynchronous(teams, actions, places, window.shape[0] * count),
        ),
        ("SyncVectorEnv", lambda: SyncVectorEnv([team] * count), partial(_grouped, count)),
        ("AsyncVectorEnv", lambda: AsyncVectorEnv([team] * count, context="spawn"), partial(_grouped, count)),
        (
            "AsyncVectorEnv of two groups",
            lambda: AsyncVectorEnv([group] * WORKERS, context="spawn"),
            partial(_grouped, WORKERS),
        ),
    ]


def _started(stack: contextlib.ExitStack, name: str, make: Callable[[], Any], play: Callable) -> _Candidate:
    before, begin = set(multiprocessing.active_children()), time.perf_counter()
    with single_threaded():
        env = stack.enter_context(contextlib.closing(make()))
    env.reset(seed=_first_seeds(env))
    start_s = time.perf_counter() - begin
    started = [process.pid for process in set(multiprocessing.active_children()) - before if process.pid is not None]
    return _Candidate(name, env, partial(play, env), started, start_s)


def _first_seeds(env: Any) -> Any:
    """Such that all candidates play the same episodes."""
    if isinstance(env, VectorTeams):
        return 0
    in_each = env.single_action_space.shape[0]
    return [k * in_each for k in range(env.num_envs)]


def _recorded(config: EnvConfig, count: int) -> Array:
    """(steps, count, robots, 2) actions, row k for a team that wanders through the episode of seed k."""
    recorder = ExplorationEnv(config=override(config, {"slam.mode": "off"}))
    episodes = [[list(step.values()) for step in record_actions(recorder, seed)] for seed in range(count)]
    return np.array(episodes, np.float32).swapaxes(0, 1).copy()


def _lockstep(teams: VectorTeams, actions: Array) -> None:
    for step in actions:
        teams.step(step)


def _grouped(groups: int, envs: SyncVectorEnv | AsyncVectorEnv, actions: Array) -> None:
    """Steps of gymnasium's environments, each of which has a share of the teams."""
    for step in actions.reshape(len(actions), groups, -1, *actions.shape[2:]):
        envs.step(step)


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


def _asynchronous(teams: VectorTeams, actions: Array, places: Array, total: int) -> None:
    """`total` steps in all. Environment k takes its next action, actions[places[k], k], as soon as it is among the half
    of the environments that are ready first."""
    ids, left = np.arange(teams.count), total
    while left:
        ids = ids[:left]
        teams.send(actions[places[ids] % len(actions), ids], ids)
        places[ids] += 1
        left -= len(ids)
        ids = teams.recv(teams.count // 2)[0]
    teams.recv()


def _cpu_s(process: int) -> float:
    """CPU seconds of a process so far, as Linux counts them; NaN on other systems."""
    status = Path(f"/proc/{process}/stat")
    if not status.exists():
        return float("nan")
    user, system = status.read_text().rpartition(")")[2].split()[11:13]
    return (int(user) + int(system)) / _CLOCK_HZ
