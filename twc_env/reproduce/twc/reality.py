"""What each effect of reality costs: teams in generated offices, without effects and with one at a time.

Three robots (`--robots`) start at random poses of generated offices and drive to the nearest frontier, or to the next
one after a decision that did not move them, until the whole team shares one map without frontiers or the steps are
over. `clean` has none of the effects; every other row has one, `all` has them together, and the worlds are the presets
of that name (`world = "office"`), in the same offices. In the rows with people, robots wait for whoever moves close to
them.

`merged_share` is the share of robots in the largest map at the end, `wrong_merges` the number of pairs of robots (or of
parts of the path of a carried robot) that shared a map at any time although their own paths place it more than 1 m or
10 degrees apart, summed over the buildings. `ate_m` and `coverage_correct` are means over buildings, `steps_per_s` is
measured with everything in it. `stuck_share` is the share of time in which a robot stood for ten seconds or more.
`people_collisions` counts contacts that robots began by driving.
"""

from __future__ import annotations

import argparse
import time

import numpy as np

from twc_env.config import WORLD_PRESETS
from twc_env.exploration.environment import ExplorationEnv
from twc_env.reproduce.runner import Runner, add_some
from twc_env.running.options import count

CHOOSES = ("buildings", "effects")
EFFECTS: dict[str, dict] = {
    "clean": {},
    "people 12": {"people.count": 12},
    "people 30": {"people.count": 30},
    "doors": {"clutter.door_share": 0.8},
    "doors, keyframes in standing": {"clutter.door_share": 0.8, "slam.keyframe.still_s": 3.0},
    "furniture": {"clutter.furniture": 25},
    "furniture below the scan": {"clutter.furniture": 25, "clutter.hidden_share": 1.0},
    "moved furniture": {"clutter.furniture": 25, "clutter.moves_per_min": 1.0},
    "bumps and slips": {"odometry.bumps_per_m": 0.5, "odometry.threshold_slip_m": 0.03},
    "late scans": {"lidar.delay_s": 0.05},
    "unlike clocks": {"failure.clock_offset_std_s": 100.0, "failure.clock_skew_std_ppm": 50.0},
    "good odometry": {"odometry.drift": 0.25},
    "bad odometry": {"odometry.drift": 2.0},
    "carried once": {"failure.kidnap_step": 300},
    "carried often": {"failure.kidnaps_per_min": 1.0},
    "noisy scanner": {"lidar.range_noise_std_m": 0.03, "lidar.dropout_probability": 0.1, "lidar.beam_count": 90},
    "skid-steer": {"odometry.platform": "skid-steer"},
    "varying odometry": {"odometry.variation": 1.0},
    "repeated signs": {"building.sign_duplication": 0.5},
    "measured radio": {"radio.preset": "radio-mall"},
    "access points that change": {"radio.power_change_std_db": 5.0},
    "measured radio, fused": {"radio.preset": "radio-mall", "slam.place_recognition.recogniser": "fused"},
    "weak links": {"link.topology": "peer", "link.range_max_m": 10.0, "link.wall_range_m": 4.0},
    "late starts": {"failure.start_spread_s": 20.0},
    "lost frames": {"failure.frame_loss_probability": 0.3},
    "lost robot": {"failure.robots": 1, "failure.robots_step": 400},
}
"""Settings of each effect."""
FIGURES = ("ate_m", "coverage_correct", "stuck_share", "steps_per_s")
ALL = "all"
WORLDS = tuple(f"world {name}" for name in WORLD_PRESETS if name != "clean")
MOVED_M = 0.3
"""A robot that a decision moved less than this chooses another goal next."""
_NOT_TOGETHER = (
    "people 12", "furniture", "furniture below the scan", "good odometry", "bad odometry", "carried often",
    "lost robot", "measured radio, fused",
)  # fmt: skip
"""Left out of `all`: another row has more of it, and lost and carried robots leave nothing of the rest to see."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of this table."""
    parser.add_argument("--buildings", type=count, default=5, help="number of generated offices per effect")
    parser.add_argument("--area", type=count, default=400, help="floor area of each [m2]")
    parser.add_argument("--robots", type=count, default=3, help="number of robots")
    parser.add_argument("--steps", type=count, default=1500, help="maximum steps per episode")
    add_some(parser, "--effects", [*EFFECTS, ALL, *WORLDS], "effects")


def rows(options: argparse.Namespace, runner: Runner) -> list[dict]:
    """One row per effect."""
    episodes = runner.grid(
        options.effects,
        range(options.buildings),
        lambda effect, k: episode(settings_of(effect), k, options.area, options.robots, options.steps),
    )
    return [_row(effect, found, options.robots) for effect, found in episodes.items()]


def settings_of(effect: str) -> dict:
    """The settings of one effect, of `all`, or of one of `WORLDS`."""
    if effect in WORLDS:
        return {"world": effect.removeprefix("world ")}
    if effect != ALL:
        return EFFECTS[effect]
    return {key: value for name, own in EFFECTS.items() if name not in _NOT_TOGETHER for key, value in own.items()}


def episode(effect: dict, building: int, area_m2: int, robots: int, steps: int) -> dict:
    """The figures of one episode."""
    own = {"map": f"gen:office:{area_m2}:{building}", "robots": robots, "max_cycles": steps, "action.kind": "frontier"}
    env = ExplorationEnv(config={**own, **effect})
    observations, _ = env.reset(seed=building)
    begun, idle, tries, before = time.perf_counter(), 0, np.zeros(robots, int), np.full((robots, 2), np.inf)
    while env.agents and idle < 2:
        masks = [observations[agent]["action_mask"] for agent in env.agents]
        here = np.array([env.belief(agent).pose_odom[:2] for agent in env.agents])
        tries, before = np.where(np.hypot(*(here - before).T) < MOVED_M, tries + 1, 0), here
        frontiers = env.config.action.frontier_slots
        has_frontier = any(mask[:frontiers].any() for mask in masks)
        is_merged = all(len(env.belief(agent).teammates) == robots - 1 for agent in env.agents)
        idle = idle + 1 if is_merged and not has_frontier else 0
        choices = [np.flatnonzero(mask) for mask in masks]  # frontiers first, the nearest one before the others
        goals = [int(valid[k % len(valid)]) for valid, k in zip(choices, tries.tolist(), strict=True)]
        observations, *_ = env.step(dict(zip(env.agents, goals, strict=True)))
    took_s, figures = time.perf_counter() - begun, env.result().figures
    return {
        "merged": figures["merged_robots"],
        "wrong_merges": figures["wrong_merges"],
        "undone": sum(mapper.merges_undone for mapper in env.engine.mappers),
        "ate_m": figures["team_ate_m"],
        "coverage_correct": figures["coverage_correct"],
        "stuck_share": figures["stuck_share"],
        "steps_per_s": figures["steps"] / took_s,
        "people_collisions": figures.get("people_collisions", 0),
        "robot_hours": robots * figures["sim_time_s"] / 3600.0,
    }


def _row(effect: str, episodes: list[dict], robots: int) -> dict:
    means = {name: float(np.mean([found[name] for found in episodes])) for name in FIGURES}
    return {
        "effect": effect,
        "buildings": len(episodes),
        "merged_share": float(np.mean([found["merged"] for found in episodes])) / robots,
        "wrong_merges": sum(found["wrong_merges"] for found in episodes),
        "undone": sum(found["undone"] for found in episodes),
        **{name: round(value, 4) for name, value in means.items()},
        "people_collisions": sum(found["people_collisions"] for found in episodes),
        "robot_hours": round(sum(found["robot_hours"] for found in episodes), 2),
    }
