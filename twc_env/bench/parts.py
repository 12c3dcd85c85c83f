"""Profile of a step: the time of each part, averaged over whole episodes.

An episode is run in two ways: unchanged for the CPU time of the whole step, and with a stopwatch around each part for
the shares. Both are repeated, and the fastest run of each step counts, which reduces the influence of other processes.
The time of a part excludes other parts that it calls.
"""

from __future__ import annotations

import math
import statistics
import time
from collections import defaultdict
from collections.abc import Callable
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.bench.rates import wander
from twc_env.config import EnvConfig
from twc_env.exploration.environment import ExplorationEnv

_CALIBRATION_CALLS = 20_000
REPEATS = 5
"""Repetitions of each episode, of both kinds."""
REST = "the rest"


@dataclass(frozen=True, slots=True)
class PartTime:
    """One part of the step: medians over the episodes."""

    part: str
    is_engine: bool
    robot_step_us: float
    """CPU time per robot and step, amortised over the episode."""
    share: float
    """Of the whole step."""
    calls_per_step: float
    call_us: float
    """CPU time per call; NaN where it was never called."""


def _parts() -> list[tuple[str, bool, Any, str]]:
    """(part, whether it belongs to the engine, owner, function or method) of all timed parts."""
    from twc_env.exploration.assessment import map_scores
    from twc_env.exploration.episode import Episode
    from twc_env.exploration.observation import map_view
    from twc_env.exploration.observation.observations import ObservationBuilder
    from twc_env.slam.engine import CooperativeSlam
    from twc_env.slam.exchange import Exchange
    from twc_env.slam.front_end.tracking import Tracker
    from twc_env.slam.mapping.closure_search import ClosureSearch
    from twc_env.slam.mapping.group_maps import GroupMaps
    from twc_env.slam.mapping.team_graph import TeamGraph
    from twc_env.slam.matching.loop_verification import LoopVerifier
    from twc_env.slam.merging.map_optimiser import MapOptimiser
    from twc_env.slam.robot import FrontEnds, RobotFrontEnd
    from twc_env.slam.team import TeamMapper
    from twc_env.world.world import World

    return [
        ("world: motion and sensors", False, World, "tick"),
        ("front end: tracking", True, Tracker, "update"),
        ("front end: signs", True, RobotFrontEnd, "read_signs"),
        ("keyframe: making, local map", True, FrontEnds, "_take_keyframe"),
        ("front end: the rest", True, CooperativeSlam, "track"),
        ("messages", True, Exchange, "deliver"),
        ("team: keyframe into the graph", True, TeamGraph, "add_keyframe"),
        ("team: merged grid", True, GroupMaps, "_draw"),
        ("team: place recognition", True, ClosureSearch, "propose"),
        ("team: verification", True, LoopVerifier, "verify"),
        ("team: merging", True, TeamMapper, "_try_merge"),
        ("team: merge review", True, TeamMapper, "_undo_wrong_merge"),
        ("team: pose graph", True, MapOptimiser, "optimise"),
        ("team: redrawing", True, GroupMaps, "redraw"),
        ("team: the rest", True, CooperativeSlam, "absorb"),
        ("beliefs", False, CooperativeSlam, "beliefs"),
        ("observation: notes", False, ObservationBuilder, "notice"),
        ("observation: map crop", False, map_view.MapViews, "draw"),
        ("observation: the rest", False, ObservationBuilder, "build"),
        ("reward: map against the truth", False, map_scores, "standing"),
        ("end of the episode: report", False, Episode, "numbers"),
    ]


class Stopwatch:
    """Exclusive times of functions that call each other."""

    def __init__(self, clock: Callable[[], float] = time.perf_counter):
        self._clock = clock
        self.time_s: dict[str, float] = defaultdict(float)
        self.calls: dict[str, int] = defaultdict(int)
        self._running: list[list[float]] = []
        """Of each running timed call: the time spent in other timed calls."""
        self._overhead_s = 0.0
        self._overhead_s = self._calibrated_overhead_s()

    @contextmanager
    def around(self, parts: list[tuple[str, bool, Any, str]]):
        """Time these functions within this context."""
        held = [(owner, name, owner.__dict__[name]) for _, _, owner, name in parts]
        try:
            for part, _, owner, name in parts:
                setattr(owner, name, self.timed(part, getattr(owner, name)))
            yield
        finally:
            for owner, name, function in held:
                setattr(owner, name, function)

    def timed(self, part: str, function: Callable) -> Callable:
        """The function, with the stopwatch around it."""
        clock, running, time_s, calls = self._clock, self._running, self.time_s, self.calls

        def run(*arguments, **keywords):
            inside = [0.0]
            running.append(inside)
            start = clock()
            try:
                return function(*arguments, **keywords)
            finally:
                spent = clock() - start
                running.pop()
                time_s[part] += spent - inside[0]
                calls[part] += 1
                if running:
                    running[-1][0] += spent + self._overhead_s

        return run

    def _calibrated_overhead_s(self) -> float:
        """Overhead of a stopwatch for the caller of the timed function."""
        empty = self.timed("", lambda: None)
        clock = self._clock
        start = clock()
        for _ in range(_CALIBRATION_CALLS):
            empty()
        spent = (clock() - start) / _CALIBRATION_CALLS - self.time_s.pop("") / _CALIBRATION_CALLS
        del self.calls[""]
        return spent


def bench_parts(config: EnvConfig, episodes: int, report: Callable[[str], None] = lambda _line: None) -> list[PartTime]:
    """Time the parts over `episodes` episodes; in the order of a step, `REST` last."""
    runs = []
    for seed in range(episodes):
        step_us, team_ate_m = _time_whole(config, seed)
        time_s, calls = _time_parts(config, seed)
        whole = sum(time_s.values())
        runs.append({part: (spent / whole * step_us, spent / whole, calls[part]) for part, spent in time_s.items()})
        report(f"seed {seed}: {step_us:.1f} us of CPU time per robot-step, team ATE {team_ate_m:.3f} m")
    is_engine = {part: engine for part, engine, _, _ in _parts()} | {REST: False}
    rows = []
    for part, engine in is_engine.items():
        spent_us, shares, counts = zip(*(run.get(part, (0.0, 0.0, 0)) for run in runs), strict=True)
        calls_per_step, robot_step_us = statistics.median(counts) / config.max_cycles, statistics.median(spent_us)
        call_us = robot_step_us * config.robots / calls_per_step if calls_per_step else math.nan
        rows.append(PartTime(part, engine, robot_step_us, statistics.median(shares), calls_per_step, call_us))
    return rows


def _time_whole(config: EnvConfig, seed: int) -> tuple[float, float]:
    """CPU time of one episode's steps [us per robot and step], and its trajectory error [m]."""
    best = np.full(config.max_cycles, np.inf)
    for _ in range(REPEATS):
        env = ExplorationEnv(config=config)
        env.reset(seed=seed)
        for k, actions in enumerate(wander(env, seed)):
            begin = time.process_time_ns()
            env.step(actions)
            best[k] = min(best[k], time.process_time_ns() - begin)
    return 1e-3 * float(best.mean()) / config.robots, env.result().figures["team_ate_m"]


def _time_parts(config: EnvConfig, seed: int) -> tuple[dict[str, float], dict[str, int]]:
    """Seconds and calls of each part in one episode; `REST` is the remaining time."""
    parts = _parts()
    best: dict[str, Array] = {}
    for _ in range(REPEATS):
        watch = Stopwatch()
        env = ExplorationEnv(config=config)
        env.reset(seed=seed)
        step = watch.timed(REST, env.step)
        spent: dict[str, Array] = {}
        with watch.around(parts):
            for k, actions in enumerate(wander(env, seed)):
                watch.time_s.clear()
                step(actions)
                for part, time_s in watch.time_s.items():
                    spent.setdefault(part, np.zeros(config.max_cycles))[k] = time_s
        best = {part: np.minimum(row, best.get(part, np.inf)) for part, row in spent.items()}
    return {part: float(row.sum()) for part, row in best.items()}, watch.calls


def table_of(rows: list[PartTime]) -> list[list[str]]:
    """The parts as cells of a table, with a head, and the sums of the engine and of the whole step."""
    cells = [["part", "us per robot-step", "share", "calls per step", "us per call"]]
    for r in rows:
        call = f"{r.call_us:.0f}" if r.calls_per_step else "-"
        cells.append([r.part, f"{r.robot_step_us:.1f}", f"{r.share:.1%}", f"{r.calls_per_step:.2f}", call])
    for name, chosen in (("the engine", [r for r in rows if r.is_engine]), ("the whole step", rows)):
        spent_us, share = sum(r.robot_step_us for r in chosen), sum(r.share for r in chosen)
        cells.append([name, f"{spent_us:.1f}", f"{share:.1%}", "", ""])
    return cells
