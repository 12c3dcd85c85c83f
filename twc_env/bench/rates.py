"""Measure speed: environment steps per second of the world alone (no engine) and of the whole step with SLAM inside.

The robots follow a reactive policy through whole episodes, so that keyframes, loop closures, merges, optimisation and
redrawing are all included. Their actions are recorded beforehand, in an episode without an engine (the world is the
same), so that only the environment is timed. The trajectory error of the team is printed beside the speed, because an
engine that has lost track can be fast.
"""

from __future__ import annotations

import gc
import platform
import statistics
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.config import EnvConfig, override
from twc_env.errors import ConfigError
from twc_env.exploration.environment import ExplorationEnv
from twc_env.maps import load_map
from twc_env.records.messages import UNSEEN_M, SensorFrame
from twc_env.world.building.floorplan import Floorplan

PEOPLE = 12
"""In the world with people, unless the settings have some."""
ROLLING: dict[str, float] = {"lidar.rate_hz": 10.0, "lidar.is_rolling": True}
"""A scanner whose beams are measured one after the other."""
_OPEN_M = 3.0
"""Range that the Wanderer assumes where its scan says nothing."""


class Wanderer:
    """Reactive policy of one robot, from its scan only: straight on, and away from near obstacles."""

    def __init__(self, seed: int):
        self._random = np.random.default_rng(seed)
        self._turn_steps = 0
        self._turn = 1.0

    def act(self, ranges_m: Array) -> Array:
        """(2,) action from a scan (beams,) [m]; beams without information count as open."""
        beams, ranges_m = len(ranges_m), np.where(ranges_m == UNSEEN_M, _OPEN_M, np.abs(ranges_m))
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
    """Yields the actions of a team of Wanderers until the episode ends; the caller steps the environment.

    Raises ConfigError unless actions are velocities: a Wanderer's speed and turn rate are no goal.
    """
    if env.config.action.kind != "velocity":
        raise ConfigError(
            f"this team is driven by velocities: action.kind must be 'velocity'; it is {env.config.action.kind!r}"
        )
    drivers = {agent: Wanderer(seed * 1000 + robot) for robot, agent in enumerate(env.agents)}
    while env.agents:
        frames = {frame.robot: frame for frame in env.frames}  # failed robots have no frame, and do not move
        yield {
            agent: drivers[agent].act(_circle(env, agent, frames[robot])) if robot in frames else np.zeros(2)
            for robot, agent in enumerate(env.agents)
        }


def _circle(env: ExplorationEnv, agent: str, frame: SensorFrame) -> Array:
    """The scan of a frame all around the robot; of scanners of another kind, as its engine holds it."""
    ranges_m = frame.ranges_m if frame.scanner is None else env.belief(agent).ranges_m
    assert ranges_m is not None
    return ranges_m


@dataclass(frozen=True, slots=True, eq=False)
class Run:
    """One timed run."""

    steps: int
    wall_s: float
    cpu_s: float
    team_ate_m: float = float("nan")
    step_s: Array | None = None
    """(steps,) wall time of each step, if measured."""

    @property
    def rate(self) -> float:
        """Steps per second."""
        return self.steps / self.wall_s

    @property
    def cpu_rate(self) -> float:
        """Steps per second of CPU time."""
        return self.steps / self.cpu_s

    @classmethod
    def joined(cls, runs: Sequence[Run]) -> Run:
        """Several runs as one: times are summed, `team_ate_m` is the median."""
        taken = [run.step_s for run in runs if run.step_s is not None]
        return cls(
            sum(run.steps for run in runs),
            sum(run.wall_s for run in runs),
            sum(run.cpu_s for run in runs),
            statistics.median(run.team_ate_m for run in runs),
            np.concatenate(taken) if taken else None,
        )


class OurRuns:
    """Episodes of our environment, one per seed; one is run in advance to compile the kernels."""

    def __init__(self, config: EnvConfig, plan: Floorplan):
        self._env = ExplorationEnv(config=config, floorplan=plan)
        self._recorder = ExplorationEnv(config=override(config, {"slam.mode": "off"}), floorplan=plan)
        self.once(0)

    def once(self, seed: int) -> Run:
        """Time one whole episode."""
        actions = record_actions(self._recorder, seed)
        self._env.reset(seed=seed)
        step, step_s = self._env.step, np.empty(len(actions))
        gc.collect()  # otherwise a run may include the collection of earlier objects
        cpu, wall = time.process_time(), time.perf_counter()
        before = wall
        for k, action in enumerate(actions):
            step(action)
            now = time.perf_counter()
            step_s[k] = now - before
            before = now
        wall_s, cpu_s = time.perf_counter() - wall, time.process_time() - cpu
        return Run(len(actions), wall_s, cpu_s, self._env.result().figures["team_ate_m"], step_s)


def record_actions(env: ExplorationEnv, seed: int) -> list[dict[str, Array]]:
    """Actions of a team of Wanderers in one episode, float32 as from a learned policy."""
    env.reset(seed=seed)
    actions = []
    for action in wander(env, seed):
        actions.append({agent: value.astype(np.float32) for agent, value in action.items()})
        env.step(actions[-1])
    return actions


def bench(config: EnvConfig, episodes: int, report: Callable[[str], None] = lambda _line: None) -> dict:
    """Time `episodes` episodes of each kind; rates are medians. `report` gets a line after each.

    Raises ConfigError unless robots are driven by velocity.
    """
    if config.action.kind != "velocity":
        raise ConfigError(f"bench needs action.kind = 'velocity'; got {config.action.kind!r}: remove this setting")
    plan = load_map(config.map)
    off = override(config, {"slam.mode": "off"})
    crowd: dict[str, float] = {"people.count": config.people.count or PEOPLE}
    timers = {
        "world": ("world alone, seed {}", OurRuns(off, plan)),
        "world_with_people": ("the same among people", OurRuns(override(off, crowd), plan)),
        "world_with_people_and_rolling_scanner": (
            "and with a scanner that rolls", OurRuns(override(off, crowd | ROLLING), plan),
        ),
        "slam": ("whole step,  seed {}", OurRuns(config, plan)),
    }  # fmt: skip
    runs: dict[str, list[Run]] = {kind: [] for kind in timers}
    for seed in range(episodes):
        for kind, (what, timer) in timers.items():
            run = timer.once(seed)
            runs[kind].append(run)
            error = f", team ATE {run.team_ate_m:.3f} m" if kind == "slam" else ""
            report(f"{what.format(seed)}: {run.rate:,.0f} steps/s{error}")
    slam = runs["slam"]
    return {
        **{f"{kind}_env_steps_per_s": statistics.median(run.rate for run in runs[kind]) for kind in runs},
        **{f"{kind}_env_steps_per_cpu_s": statistics.median(run.cpu_rate for run in runs[kind]) for kind in runs},
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
