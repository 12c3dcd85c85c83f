"""Our speed and that of other simulators, in one run on one core: rates, slowest steps, workers, memory and start-up.

Ours are whole episodes through the PettingZoo parallel API (`bench.OurRuns`). Each repetition plays the same episodes,
and after each episode a part of the peers' steps, so that a core that slows down for some seconds slows all candidates.
Each figure is a median over repetitions, also each ratio. Compare figures of one run only.
"""

from __future__ import annotations

import contextlib
import dataclasses
import gc
import importlib.util
import io
import logging
import os
import statistics
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.bench import probes as bench_probes
from twc_env.bench.rates import OurRuns, Run
from twc_env.config import EnvConfig, override
from twc_env.maps import load_map
from twc_env.world.building.floorplan import Floorplan

Report = Callable[[str], None]

WORLD_MAP, WORLD_ACCESS_POINTS = "gen:office:1000:1", 20
"""Building for the world without SLAM: about 200 walls; further access points are left out."""
SLAM_MAP = "twin-02"
ROBOTS, BEAMS = 3, 180
PEERS = {"irsim": ("irsim", "IR-SIM", "ir-sim"), "mpe2": ("mpe2", "MPE2", "mpe2")}
"""Key -> module, name, package."""
REPETITIONS, EPISODES = 5, 5
"""Repetitions, and episodes of each, with the seeds 0, 1, ..."""
WORLD_STEPS, SLAM_STEPS, IRSIM_STEPS, MPE2_STEPS, PROBE_STEPS = 2000, 2000, 200, 1500, 1000
"""Steps of an episode; of the peers, steps after each of our episodes; steps of an episode of a probe."""


def bench_peers(report: Report = lambda _line: None) -> dict[str, Any]:
    """All figures of the comparison in one dictionary; None for a simulator that is not installed."""
    with pinned_to_one_core():
        figures = _rates(report)
    figures |= bench_probes.probe(SLAM_MAP, PROBE_STEPS, report)
    return figures


def _rates(report: Report) -> dict[str, Any]:
    candidates = _candidates(report)
    runs: dict[str, list[Run]] = {name: [] for name in candidates}
    for repetition in range(REPETITIONS):
        parts: dict[str, list[Run]] = {name: [] for name in candidates}
        for seed in range(EPISODES):
            for name, once in candidates.items():
                parts[name].append(once(seed))
        for name, own in parts.items():
            runs[name].append(Run.joined(own))
            report(f"{repetition + 1}/{REPETITIONS} {name:<6} {runs[name][-1].rate:>9,.0f} env-steps/s")
    figures: dict[str, Any] = {}
    for name in ("world", "slam", *PEERS):
        for suffix, rate in (("s", "rate"), ("cpu_s", "cpu_rate")):
            values = [getattr(run, rate) for run in runs.get(name, [])]
            figures[f"{name}_env_steps_per_{suffix}"] = statistics.median(values) if values else None
    for ours in ("world", "slam"):
        for peer in PEERS:
            pairs = zip(runs[ours], runs.get(peer, []), strict=False)
            ratios = [own.cpu_rate / other.cpu_rate for own, other in pairs]
            figures[f"{ours}_over_{peer}"] = statistics.median(ratios) if ratios else None
    slowest = [np.percentile(run.step_s, 99) for run in runs["slam"] if run.step_s is not None]
    plan = world_plan()
    return figures | {
        "slam_step_p99_ms": 1e3 * statistics.median(slowest),
        "slam_team_ate_m": statistics.median(run.team_ate_m for run in runs["slam"]),
        "repetitions": REPETITIONS,
        "episodes": EPISODES,
        "robots": ROBOTS,
        "beams": BEAMS,
        "world_map": WORLD_MAP,
        "world_walls": len(plan.walls_m),
        "world_access_points": len(plan.access_points),
        "slam_map": SLAM_MAP,
    }


def _candidates(report: Report) -> dict[str, Callable[[int], Run]]:
    base = {"robots": ROBOTS, "lidar.beam_count": BEAMS}
    world = override(EnvConfig(), {**base, "slam.mode": "off", "max_cycles": WORLD_STEPS})
    slam = override(EnvConfig(), {**base, "map": SLAM_MAP, "max_cycles": SLAM_STEPS})
    candidates: dict[str, Callable[[int], Run]] = {
        "world": OurRuns(world, world_plan()).once,
        "slam": OurRuns(slam, load_map(SLAM_MAP)).once,
    }
    peers: dict[str, Callable[[], Callable[[int], Run]]] = {
        "irsim": lambda: IrsimRuns(IRSIM_STEPS).once,
        "mpe2": lambda: Mpe2Runs(MPE2_STEPS).once,
    }
    for peer, make in peers.items():
        if is_installed(peer, report):
            try:
                candidates[peer] = make()
            except ImportError as error:
                report(f"{PEERS[peer][1]} cannot be imported, its figures stay empty: {error}")
    return candidates


class IrsimRuns:
    """IR-SIM without plots: three robots with laser scanners drive circles among 20 boxes; no mapping."""

    def __init__(self, steps: int):
        import irsim

        self._steps = steps
        with tempfile.TemporaryDirectory() as folder, _quiet():
            path = Path(folder) / "world.yaml"
            path.write_text(_irsim_world())
            self._env = irsim.make(str(path), headless=True, disable_all_plot=True, log_level="CRITICAL")
        self._action = [np.array([[0.5], [0.6]])] * ROBOTS
        self.once(0)

    def once(self, _seed: int) -> Run:
        """Time a few hundred steps, each with a scan per robot."""
        return _timed(self._steps, self._env.step, self._action)

    @property
    def scans(self) -> list[Array]:
        """The last scan of each robot."""
        return [np.asarray(robot.get_lidar_scan()["ranges"]) for robot in self._env.robot_list]


def _irsim_world() -> str:
    places = [[4 + 8 * column, 4 + 7 * row, 0.3 * row] for row in range(4) for column in range(5)]
    robots = [[8, 7.5, 0], [16, 14.5, 1], [32, 21.5, 2]]
    return f"""
world: {{height: 30, width: 40, step_time: 0.1, sample_time: 0.1, collision_mode: stop}}
robot:
  - number: {ROBOTS}
    distribution: {{name: manual}}
    kinematics: {{name: diff}}
    shape: {{name: circle, radius: 0.2}}
    state: {robots}
    sensors:
      - {{type: lidar2d, range_min: 0, range_max: 10, angle_range: 6.2831853, number: {BEAMS}, noise: false}}
obstacle:
  - number: {len(places)}
    distribution: {{name: manual}}
    shape: {{name: rectangle, length: 1, width: 1}}
    state: {places}
"""


class Mpe2Runs:
    """MPE2's simple_spread with three agents: points in the plane, no sensors."""

    def __init__(self, steps: int):
        from mpe2 import simple_spread_v3

        self._steps = steps
        self._env = simple_spread_v3.parallel_env(N=ROBOTS, max_cycles=10**9)
        self._env.reset(seed=0)
        self.once(0)

    def once(self, _seed: int) -> Run:
        """Time a few thousand steps with fixed actions."""
        return _timed(self._steps, self._env.step, {agent: 1 + k for k, agent in enumerate(self._env.agents)})


def _timed(steps: int, step: Callable[[Any], Any], action: Any) -> Run:
    gc.collect()
    cpu, wall = time.process_time(), time.perf_counter()
    for _ in range(steps):
        step(action)
    return Run(steps, time.perf_counter() - wall, time.process_time() - cpu)


def world_plan() -> Floorplan:
    """The building in which the world without SLAM is timed."""
    plan = load_map(WORLD_MAP)
    every = max(len(plan.access_points) // WORLD_ACCESS_POINTS, 1)
    return dataclasses.replace(plan, access_points=plan.access_points[::every][:WORLD_ACCESS_POINTS])


def is_installed(peer: str, report: Report) -> bool:
    """Whether a simulator is installed; if not, reports how to install it."""
    module, name, package = PEERS[peer]
    if importlib.util.find_spec(module) is not None:
        return True
    report(f"{name} is not installed, its figures stay empty: pip install {package}, or pip install 'twc_env[peers]'")
    return False


@contextlib.contextmanager
def pinned_to_one_core() -> Iterator[None]:
    """Pin this process to one core, if the system supports it."""
    if not hasattr(os, "sched_setaffinity"):
        yield
        return
    held = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {min(held)})
    try:
        yield
    finally:
        os.sched_setaffinity(0, held)


@contextlib.contextmanager
def _quiet() -> Iterator[None]:
    """Suppress what a simulator prints and logs while it starts."""
    logging.disable(logging.CRITICAL)
    try:
        with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
            yield
    finally:
        logging.disable(logging.NOTSET)
