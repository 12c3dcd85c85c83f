"""Measure speed: environment steps per second of the world alone and of the whole step with SLAM inside.

The robots wander by reflex (the driver's time is not counted), through whole episodes, so that keyframes, loop
closures, merges, optimisation and redrawing are all paid for. The team's trajectory error is printed beside the
speed, because an engine that has lost track can be fast.
"""

from __future__ import annotations

import platform
import statistics
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.config import EnvConfig
from twc_env.exploration.environment import ExplorationEnv
from twc_env.maps import load_map
from twc_env.world.world import World

WARM_UP_STEPS = 30


class Wanderer:
    """Drives one robot by its scan alone: straight on, and away from what comes near."""

    def __init__(self, seed: int):
        self._random = np.random.default_rng(seed)
        self._turn_steps = 0
        self._turn = 1.0

    def act(self, ranges_m: Array) -> Array:
        """(2,) action from a scan (beams,) [m]."""
        beams = len(ranges_m)
        ahead = max(1, beams // 12)
        front = min(ranges_m[:ahead].min(), ranges_m[-ahead:].min())
        if self._turn_steps > 0:
            self._turn_steps -= 1
            return np.array([0.0, self._turn])
        if front < 0.7:
            left, right = ranges_m[: beams // 2].mean(), ranges_m[beams // 2 :].mean()
            self._turn = 1.0 if left > right else -1.0
            self._turn_steps = int(self._random.integers(4, 14))
            return np.array([0.0, self._turn])
        return np.array([1.0, np.clip(self._random.normal(0.0, 0.3), -1.0, 1.0)])


def wander(env: ExplorationEnv, seed: int) -> Iterator[dict[str, Array]]:
    """The actions of a wandering team, step by step, until the episode ends; the caller steps the environment."""
    drivers = {agent: Wanderer(seed * 1000 + robot) for robot, agent in enumerate(env.agents)}
    while env.agents:
        seen = {f.robot: f.ranges_m for f in env.frames}  # robots that have failed see nothing, and do not move
        yield {
            agent: drivers[agent].act(seen[robot]) if robot in seen else np.zeros(2)
            for robot, agent in enumerate(env.agents)
        }


@dataclass(frozen=True, slots=True, eq=False)
class Run:
    """One timed run."""

    steps: int
    wall_s: float
    cpu_s: float
    team_ate_m: float = float("nan")
    step_s: Array | None = None
    """(steps,) wall time of each step, where it was taken."""

    @property
    def rate(self) -> float:
        """Steps per second."""
        return self.steps / self.wall_s

    @property
    def cpu_rate(self) -> float:
        """Steps per second of CPU time."""
        return self.steps / self.cpu_s


def bench(config: EnvConfig, episodes: int, report: Callable[[str], None] = lambda _line: None) -> dict:
    """Time `episodes` episodes of each kind; rates are medians. `report` gets a line after each."""
    world, slam = [], []
    for seed in range(episodes):
        world.append(time_world(config, seed))
        report(f"world alone, seed {seed}: {world[-1].rate:,.0f} steps/s")
        slam.append(time_environment(config, seed))
        report(f"whole step,  seed {seed}: {slam[-1].rate:,.0f} steps/s, team ATE {slam[-1].team_ate_m:.3f} m")
    return {
        "world_env_steps_per_s": statistics.median(run.rate for run in world),
        "slam_env_steps_per_s": statistics.median(run.rate for run in slam),
        "world_env_steps_per_cpu_s": statistics.median(run.cpu_rate for run in world),
        "slam_env_steps_per_cpu_s": statistics.median(run.cpu_rate for run in slam),
        "slam_agent_steps_per_s": config.robots * statistics.median(run.rate for run in slam),
        "slam_env_steps_per_s_min": min(run.rate for run in slam),
        "slam_env_steps_per_s_max": max(run.rate for run in slam),
        "team_ate_m": statistics.median(run.team_ate_m for run in slam),
        "map": config.map,
        "robots": config.robots,
        "beams": config.lidar.beam_count,
        "steps": config.max_cycles,
        "episodes": episodes,
        "machine": f"{platform.machine()} {platform.system()}, Python {platform.python_version()}",
    }


def time_world(config: EnvConfig, seed: int) -> Run:
    """An episode of the world alone: physics and all sensors."""
    world = World(config, load_map(config.map))
    world.reset(seed)
    drivers = [Wanderer(seed * 1000 + robot) for robot in range(config.robots)]
    frames = world.sense()
    scale = np.array([config.dynamics.speed_max_m_s, config.dynamics.turn_rate_max_rad_s])
    wall_s = cpu_s = 0.0
    for step in range(config.max_cycles + WARM_UP_STEPS):
        commands = np.array([d.act(f.ranges_m) for d, f in zip(drivers, frames, strict=True)]) * scale
        wall, cpu = time.perf_counter(), time.process_time()
        world.step(commands)
        frames = world.sense()
        if step >= WARM_UP_STEPS:
            wall_s += time.perf_counter() - wall
            cpu_s += time.process_time() - cpu
    return Run(config.max_cycles, wall_s, cpu_s)


def time_environment(config: EnvConfig, seed: int) -> Run:
    """An episode of the environment: world, SLAM, observations, rewards."""
    warm = ExplorationEnv(config=config)
    warm.reset(seed=seed)
    warm.step(dict.fromkeys(warm.agents, np.zeros(2)))
    env = ExplorationEnv(config=config)
    env.reset(seed=seed)
    wall_s = cpu_s = 0.0
    for actions in wander(env, seed):
        wall, cpu = time.perf_counter(), time.process_time()
        env.step(actions)
        wall_s += time.perf_counter() - wall
        cpu_s += time.process_time() - cpu
    return Run(config.max_cycles, wall_s, cpu_s, env.result().figures["team_ate_m"])
