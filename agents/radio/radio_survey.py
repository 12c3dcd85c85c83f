"""Radio map quality over path length: active path planning against wall following.

Both robots start at the same place of the same building with the same noise, know the routers only, and are scored on
`Belief.radio_map` only. The score is the IoU of free floor with unknown floor counted as missed, so that abstaining
does not help; IoU as published and coverage are reported as well.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray as Array

import twc_env
from twc_env import load_map
from twc_env.config import EnvConfig, override
from twc_env.records.geometry import inverse, transform_points
from twc_env.records.messages import GridMap
from twc_env.running.finished_parts import FinishedParts

from ..policy import make_policy
from .radio_bound import shortest_known_walk_m

AGENTS = ("wall-follower", "radio-walk")
STEP_M = 1.0
"""Path length between two evaluations of the map."""
RADIO = {
    "radio.preset": "sfw",
    "slam.k_visibility.enabled": True,
    "slam.k_visibility.power_at_1m_dbm": -29.0,
    "slam.k_visibility.path_loss_exponent": 1.25,
    "slam.k_visibility.wall_loss_db": 8.0,
    "slam.k_visibility.noise_std_db": 4.0,
    "slam.k_visibility.are_transmitters_known": True,
    "slam.k_visibility.period_scans": 5,
}
"""Radio of the k-visibility twins, and an engine with known signal model and router positions."""


@dataclass(frozen=True, slots=True)
class Walked:
    """One walk, scored along its path."""

    path_m: list[float]
    iou: list[float]
    """IoU of free floor; unknown floor counts as missed."""
    iou_published: list[float]
    """IoU of free floor among known cells (papers.md K18)."""
    coverage: list[float]
    is_finished: bool
    start_m: list[float]
    """(2,) in the building frame."""


@dataclass(frozen=True, slots=True)
class Comparison:
    """Both walks of one building and seed."""

    name: str
    seed: int
    along_walls: Walked
    active: Walked

    def path_share(self, part: float = 1.0) -> float:
        """Path length at which the active walk reaches this part of the final IoU of wall following, relative to that
        of wall following."""
        goal = part * self.along_walls.iou[-1]
        return _reached_m(self.active, goal) / max(_reached_m(self.along_walls, goal), STEP_M)

    def bound(self, plan) -> float:
        """As `path_share`, for the shortest walk found with a known building and noise-free readings."""
        known_m = shortest_known_walk_m(plan, np.array(self.along_walls.start_m), self.along_walls.iou[-1])
        return known_m / max(_reached_m(self.along_walls, self.along_walls.iou[-1]), STEP_M)

    def at_share(self, share: float) -> tuple[float, float]:
        """IoU of both walks after this share of the path of wall following."""
        limit = share * self.along_walls.path_m[-1]
        return tuple(  # type: ignore[return-value]
            max([iou for m, iou in zip(w.path_m, w.iou, strict=True) if m <= limit], default=0.0)
            for w in (self.along_walls, self.active)
        )


def compare(
    names: list[str], seeds: Sequence[int], steps: int, folder: Path, tell=lambda text: None
) -> list[Comparison]:
    """Run every building with every seed; finished walks are read from the folder."""
    finished = FinishedParts(folder, "radio-survey", {"steps": steps}, ("twc_env.agents",))
    if finished.remark:
        tell(finished.remark)
    found = []
    for name in names:
        for seed in seeds:
            walks = []
            for agent in AGENTS:
                tell(f"{name} seed {seed} {agent}")
                walks.append(_once(name, agent, seed, steps, finished))
            found.append(Comparison(name, seed, *walks))
    return found


def median_share(shares: list[float]) -> tuple[float, float, float]:
    """Median of path shares, and its 95 % bootstrap interval over buildings and seeds."""
    draws = np.random.default_rng(0).integers(0, len(shares), (2000, len(shares)))
    medians = np.sort(np.median(np.array(shares)[draws], axis=1))
    return float(np.median(shares)), float(medians[50]), float(medians[-51])


def survey(config: EnvConfig, agent: str, seed: int) -> Walked:
    """Run an agent, and score its radio map every `STEP_M`."""
    env = twc_env.parallel_env(config=config)
    policy = make_policy(agent, config)
    env.reset(seed=seed)
    policy.reset(seed, env.possible_agents)
    held: list[tuple[float, GridMap]] = []
    path_m, last, is_finished = 0.0, None, False
    while env.agents and not is_finished:
        beliefs = {name: env.belief(name) for name in env.agents}
        (belief,) = beliefs.values()
        if last is not None:
            path_m += math.dist(last, belief.pose_odom[:2])
        last = belief.pose_odom[:2].copy()
        actions, is_finished = policy.act(beliefs), policy.finished(beliefs)
        if belief.radio_map is not None and (is_finished or path_m >= len(held) * STEP_M):
            held.append((path_m, belief.radio_map))
        env.step(actions)
    start = env.result().true_poses[0, 0]
    env.close()
    plan = load_map(config.map)
    iou, published, coverage = zip(*(score(grid, start, plan) for _, grid in held), strict=True)
    return Walked([m for m, _ in held], list(iou), list(published), list(coverage), is_finished, start[:2].tolist())


def score(radio: GridMap, pose_building_map: Array, plan) -> tuple[float, float, float]:
    """IoU of free floor with unknown as missed, IoU among known cells, and the share of cells known."""
    cells = plan.cells(radio.resolution_m)
    is_scored = cells.free | cells.wall
    centres = cells.centre_of(np.argwhere(is_scored))
    level = radio.level_at(transform_points(inverse(pose_building_map), centres))
    free, known, truly = level < 0, level != 0, cells.free[is_scored]
    right = float((free & truly).sum())
    return right / (free | truly).sum(), right / max((known & (free | truly)).sum(), 1), float(known.mean())


def _reached_m(walked: Walked, goal: float) -> float:
    """Path length [m] at which a walk first reached this IoU; inf if never."""
    return next((m for m, iou in zip(walked.path_m, walked.iou, strict=True) if iou >= goal), math.inf)


def _once(name: str, agent: str, seed: int, steps: int, finished: FinishedParts) -> Walked:
    config = override(EnvConfig(), {"map": name, "robots": 1, "max_cycles": steps, **RADIO})
    key = f"{name} {load_map(name).digest} {agent} {seed}"
    return Walked(**finished.once(key, lambda: asdict(survey(config, agent, seed))))
