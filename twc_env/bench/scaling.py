"""Cost of a step of the world by number of walls, beams, robots and area, and reset times of large buildings."""

from __future__ import annotations

import dataclasses
import statistics
import time
from collections.abc import Callable
from typing import Any

import numpy as np

from twc_env.bench.peers import ROBOTS, world_plan
from twc_env.bench.rates import record_actions
from twc_env.config import EnvConfig, override
from twc_env.exploration.environment import ExplorationEnv
from twc_env.maps import load_map
from twc_env.world.building.floorplan import Floorplan

WALL_PARTS = (1, 2, 4, 8)
"""Number of pieces that each wall is cut into: the same building with more walls."""
BEAMS = (90, 180, 360, 720)
ROBOT_COUNTS = (1, 3, 6, 12)
AREAS_M2 = (250, 1000, 4000, 10_000)
LARGE_MAP = "gen:office:10000:1"
_STEPS, _RESETS = 500, 3
_PLAYS = 5
"""Repetitions of the same episode; the fastest run of each step counts, to reduce the influence of other load."""


def bench_scaling(report: Callable[[str], None] = lambda _line: None) -> list[dict[str, Any]]:
    """Rows {what, value, walls, access_points, us_per_env_step}: SLAM off, whole steps through the PettingZoo API."""
    plan = world_plan()
    cases: list[tuple[str, int, Floorplan, dict[str, Any]]] = [
        ("walls", len(plan.walls_m) * k, cut_walls(plan, k), {}) for k in WALL_PARTS
    ]
    cases += [("beams", beams, plan, {"lidar.beam_count": beams}) for beams in BEAMS]
    cases += [("robots", robots, plan, {"robots": robots}) for robots in ROBOT_COUNTS]
    cases += [("area_m2", area, load_map(f"gen:office:{area}:1"), {}) for area in AREAS_M2]
    rows = []
    for what, value, building, settings in cases:
        rows.append(_row(what, value, building, settings, _STEPS))
        report(f"{what} {value}: {rows[-1]['us_per_env_step']:.1f} us per environment step")
    return rows


def bench_large_reset(map_name: str = LARGE_MAP) -> dict[str, float]:
    """Wall seconds to generate a building of 10,000 m2, and to reset an environment in it (first, median), all warm."""
    config = override(EnvConfig(), {"map": map_name})
    ExplorationEnv(config=override(config, {"map": "gen:office:250:1"})).reset(seed=0)
    begin = time.perf_counter()
    plan = load_map(map_name)
    built = time.perf_counter()
    env = ExplorationEnv(config=config, floorplan=plan)
    env.reset(seed=0)
    first = time.perf_counter()
    resets = []
    for seed in range(1, 1 + _RESETS):
        again = time.perf_counter()
        env.reset(seed=seed)
        resets.append(time.perf_counter() - again)
    return {
        "large_generate_s": built - begin,
        "large_first_reset_s": first - built,
        "large_reset_s": statistics.median(resets),
    }


def cut_walls(plan: Floorplan, parts: int) -> Floorplan:
    """The same building with every wall cut into equal parts."""
    share = np.linspace(0.0, 1.0, parts + 1)[None, :, None]
    begins, ends = plan.walls_m[:, :1], plan.walls_m[:, 1:]
    cuts = begins + share * (ends - begins)  # (walls, parts + 1, 2)
    return dataclasses.replace(
        plan,
        walls_m=np.stack([cuts[:, :-1], cuts[:, 1:]], axis=2).reshape(-1, 2, 2),
        wall_loss_db=np.repeat(plan.wall_loss_db, parts),
        wall_materials=tuple(name for name in plan.wall_materials for _ in range(parts)),
    )


def _row(what: str, value: int, plan: Floorplan, settings: dict[str, Any], steps: int) -> dict[str, Any]:
    config = override(EnvConfig(), {"robots": ROBOTS, "slam.mode": "off", "max_cycles": steps, **settings})
    env = ExplorationEnv(config=config, floorplan=plan)
    actions = record_actions(env, 0)
    quickest_s = np.full(steps, np.inf)
    for _ in range(_PLAYS):
        env.reset(seed=0)
        for step, action in enumerate(actions):
            begin = time.perf_counter()
            env.step(action)
            quickest_s[step] = min(quickest_s[step], time.perf_counter() - begin)
    return {
        "what": what,
        "value": value,
        "walls": len(plan.walls_m),
        "access_points": len(plan.access_points),
        "us_per_env_step": 1e6 * float(quickest_s.mean()),
    }
