"""Radio map quality over path length: active path planning against wall following (papers.md K24).

Both robots start at the same place of the same building with the same noise, know the routers only, and are scored on
`Belief.radio_map` only. `iou_free` is the IoU of free floor with unknown floor counted as missed, so that abstaining
does not help; IoU as published (`iou_known`) and coverage are reported as well.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray as Array

import twc_env
from twc_env.agents import make_policy
from twc_env.agents.radio.radio_bound import shortest_known_walk_m
from twc_env.config import EnvConfig, override
from twc_env.maps import load_map
from twc_env.records.geometry import inverse, transform_points
from twc_env.records.messages import GridMap
from twc_env.reproduce.runner import Runner, add_seeds
from twc_env.running.finished_parts import code_digest
from twc_env.running.options import count

PACKAGES = ("twc_env.agents",)
CHOOSES = ("seeds", "maps")
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


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of `reproduce sfw-active`."""
    parser.add_argument(
        "--maps",
        nargs="+",
        metavar="MAP",
        default=[f"sfw-e{n}" for n in range(1, 7)],
        help="names or files (default: sfw-e1 to sfw-e6)",
    )
    add_seeds(parser, "0-2", "seeds of starts and noise")
    parser.add_argument("--steps", type=count, default=2500, help="maximum number of steps")
    parser.add_argument("--jobs", type=count, default=2, help="number of worker processes")


def rows(options: argparse.Namespace, runner: Runner) -> list[dict]:
    """One row per building, seed and agent."""
    plans = {name: load_map(name) for name in options.maps}
    parts = [(name, seed, agent) for name in plans for seed in options.seeds for agent in AGENTS]
    teams = code_digest("twc_env.agents")  # a walk is finished only for the same teams and the same file
    walks = runner.each(
        parts,
        partial(_walked, options.steps),
        lambda part: f"{part[0]} seed {part[1]} {part[2]} {plans[part[0]].digest[:8]} {teams[:8]}",
        options.jobs,
    )
    found = [Walked(**walk) for walk in walks]
    pairs = [
        Comparison(name, along, active)
        for (name, *_), along, active in zip(parts[::2], found[::2], found[1::2], strict=True)
    ]
    runner.notes += _notes(pairs, [pair.bound(plans[pair.name]) for pair in pairs])
    return [
        {
            "map": name, "seed": seed, "agent": agent, "path_m": walk.path_m[-1], "iou_free": walk.iou[-1],
            "iou_known": walk.iou_published[-1], "coverage": walk.coverage[-1], "is_finished": walk.is_finished,
        }
        for (name, seed, agent), walk in zip(parts, found, strict=True)
    ]  # fmt: skip


def _notes(pairs: Sequence[Comparison], bounds: list[float]) -> list[str]:
    told = []
    for share in (0.25, 0.5, 0.6, 0.75, 1.0):
        along, active = np.mean([pair.at_share(share) for pair in pairs], axis=0)
        told.append(f"after {share:.0%} of the path along the walls: IoU {along:.3f}, active {active:.3f}")
    for part in (0.5, 0.75, 0.9, 1.0):
        told.append(
            f"path for {part:.0%} of the final IoU of wall following, active by wall following: "
            f"{_told([pair.path_share(part) for pair in pairs])}; inf: never reached"
        )
    what = "lower bound for 100 % (shortest path found with known building and noise-free readings)"
    return [*told, f"{what}: {_told(bounds)}"]


def _told(shares: list[float]) -> str:
    middle, low, high = median_share(shares)
    return f"{middle:.2f} (median, 95 % interval {low:.2f} to {high:.2f})"


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


def _walked(steps: int, part: tuple[str, int, str]) -> dict:
    name, seed, agent = part
    config = override(EnvConfig(), {"map": name, "robots": 1, "max_cycles": steps, **RADIO})
    return asdict(survey(config, agent, seed))
