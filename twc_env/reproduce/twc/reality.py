"""What each effect of reality costs: teams in generated offices, without effects and with one at a time.

Three robots (`--robots`) start at random poses of generated offices and explore them with a scripted team (`--agent`)
until it is finished or the steps are over. `clean` has none of the effects; every other row has one, `all` has them
together, and the worlds are the presets of that name (`world = "office"`), in the same offices. These have no panes of
glass but in `glass` and `all`, so what the worlds say of glass is without effect. In the rows with people, robots wait
for whoever moves close to them.

`fully_merged` is the share of the teams that share one map at the end, `merged_share` the mean share of robots in the
largest map. `wrong_merges` is the number of pairs of robots (or of parts of the path of a carried robot) that shared a
map at any time although their own paths place it more than 1 m or 10 degrees apart, summed over the buildings;
`wrong_teams` the number of teams in which there were any. `ate_m`, `coverage_correct`, `steps` and `stuck_share` are
means over buildings. `stuck_share` is the share of time in which a robot stood for ten seconds or more, whatever it
waited for; `commanded_stuck_share` counts only those ten seconds in more than half of which it was told to drive or
turn: who waits in a closed room or is not switched on is not stuck. Of the three robots, the greatest counts;
`stuck_worst` and `commanded_stuck_worst` are those of the worst episode, `stuck_teams` the number of those in which it
is more than a tenth. `steps_per_s` is measured with everything in
it, also what the team thinks. `people_collisions` counts contacts that robots began by driving.
"""

from __future__ import annotations

import argparse
import time
from functools import partial

import numpy as np

from twc_env.config import WORLD_PRESETS
from twc_env.exploration.environment import ExplorationEnv
from twc_env.reproduce.runner import Runner, add_some
from twc_env.running.options import count, natural
from twc_env.suite.player import drive

CHOOSES = ("buildings", "first", "effects")
PACKAGES = ("twc_env.agents",)
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
    "scanner lds-01": {"lidar.preset": "lds-01"},
    "scanner rplidar-a1": {"lidar.preset": "rplidar-a1"},
    "scanner utm-30lx": {"lidar.preset": "utm-30lx"},
    "scanner lms-200": {"lidar.preset": "lms-200"},
    "glass": {"building.glass_share": 0.3, "lidar.glass_return_probability": 0.3},
    "people among glass": {"building.glass_share": 0.3, "lidar.glass_return_probability": 0.3, "people.count": 12},
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
FIGURES = ("ate_m", "coverage_correct", "steps", "stuck_share", "commanded_stuck_share", "steps_per_s")
STUCK_MAX = 0.1
ALL = "all"
WORLDS = tuple(f"world {name}" for name in WORLD_PRESETS if name != "clean")
_NOT_TOGETHER = (
    "people 12", "furniture", "furniture below the scan", "good odometry", "bad odometry", "carried often",
    "lost robot", "measured radio", "people among glass", "scanner lds-01", "scanner rplidar-a1", "scanner utm-30lx",
    "scanner lms-200",
)  # fmt: skip
"""Left out of `all`: another row has more of it, and lost and carried robots leave nothing of the rest to see. Of the
scanners it has the noisy one."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of this table."""
    parser.add_argument("--buildings", type=count, default=5, help="number of generated offices per effect")
    parser.add_argument("--first", type=natural, default=0, help="number of the first office")
    parser.add_argument("--area", type=count, default=400, help="floor area of each [m2]")
    parser.add_argument("--robots", type=count, default=3, help="number of robots")
    parser.add_argument("--steps", type=count, default=4000, help="maximum steps per episode")
    parser.add_argument("--agent", default="nearest-frontier", help="the scripted team")
    parser.add_argument("--jobs", type=count, default=1, help="number of worker processes")
    add_some(parser, "--effects", [*EFFECTS, ALL, *WORLDS], "effects")


def rows(options: argparse.Namespace, runner: Runner) -> list[dict]:
    """One row per effect."""
    common = {"robots": options.robots, "max_cycles": options.steps}
    numbers = range(options.first, options.first + options.buildings)
    play = partial(episode, options.agent, options.area, common)
    episodes = runner.grid(options.effects, numbers, play, options.jobs)
    return [_row(effect, found, options.robots) for effect, found in episodes.items()]


def settings_of(effect: str) -> dict:
    """The settings of one effect, of `all`, or of one of `WORLDS`."""
    if effect in WORLDS:
        return {"world": effect.removeprefix("world ")}
    if effect != ALL:
        return EFFECTS[effect]
    return {key: value for name, own in EFFECTS.items() if name not in _NOT_TOGETHER for key, value in own.items()}


def episode(agent: str, area_m2: int, common: dict, effect: str, building: int) -> dict:
    """The figures of one episode."""
    from twc_env.agents.explore import commanded_stuck_share

    env = ExplorationEnv(config={**common, "map": f"gen:office:{area_m2}:{building}", **settings_of(effect)})
    begun = time.perf_counter()
    commands = drive(env, agent, building)
    took_s, result = time.perf_counter() - begun, env.result()
    figures = result.figures
    undone = sum(mapper.merges_undone for mapper in env.engine.mappers)
    env.close()
    return {
        "merged": figures["merged_robots"],
        "wrong_merges": figures["wrong_merges"],
        "undone": undone,
        "ate_m": figures["team_ate_m"],
        "coverage_correct": figures["coverage_correct"],
        "steps": figures["steps"],
        "stuck_share": figures["stuck_share"],
        "commanded_stuck_share": commanded_stuck_share(result, commands),
        "steps_per_s": figures["steps"] / took_s,
        "people_collisions": figures.get("people_collisions", 0),
        "robot_hours": figures["robots"] * figures["sim_time_s"] / 3600.0,
    }


def _row(effect: str, episodes: list[dict], robots: int) -> dict:
    means = {name: float(np.mean([found[name] for found in episodes])) for name in FIGURES}
    merged = np.array([found["merged"] for found in episodes])
    return {
        "effect": effect,
        "buildings": len(episodes),
        "fully_merged": float(np.mean(merged == robots)),
        "merged_share": float(np.mean(merged)) / robots,
        "wrong_merges": sum(found["wrong_merges"] for found in episodes),
        "wrong_teams": sum(found["wrong_merges"] > 0 for found in episodes),
        "undone": sum(found["undone"] for found in episodes),
        **{name: round(value, 4) for name, value in means.items()},
        "stuck_teams": sum(found["stuck_share"] > STUCK_MAX for found in episodes),
        "stuck_worst": round(max(found["stuck_share"] for found in episodes), 4),
        "commanded_stuck_worst": round(max(found["commanded_stuck_share"] for found in episodes), 4),
        "people_collisions": sum(found["people_collisions"] for found in episodes),
        "robot_hours": round(sum(found["robot_hours"] for found in episodes), 2),
    }
