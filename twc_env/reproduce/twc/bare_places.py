"""Three robots in scenes with little geometry: bare corridors, and a hall larger than the laser range.

Robots start at random poses without a common frame and drive to the nearest frontier. Along a corridor, scan matching
is constrained only at the ends. Signs are 8 m apart, access points 10 m (`without WiFi`: none). `words`: every sign has
a distinct text; `numbers`: texts that differ in one digit only, which recognition treats as similar. The hall is 60 m
wide, with signs 10 m apart along two walls and nine access points; from its centre the laser reaches no wall.

`wrong_merges` counts pairs of robots that shared a map at any time although their own paths place it more than 1 m or
10 degrees apart, `wrong_episodes` the episodes with any, `undone` the merges that the engine undid. `false_closures`
are closures accepted at the end with an error above 0.5 m or 10 degrees, except those that leave a direction
unconstrained. Wrong merges without false closures are drift: along a corridor distance comes from odometry alone, whose
scale is off by 2.5 %. `ate_m` aligns every group of merged robots once.
"""

from __future__ import annotations

import argparse
import itertools
import math
from dataclasses import dataclass

import numpy as np

from twc_env.exploration.environment import ExplorationEnv
from twc_env.reproduce.runner import Runner, add_seeds, add_some
from twc_env.running.options import count
from twc_env.world.building.floorplan import AccessPoint, Floorplan, Sign

CHOOSES = ("seeds", "scenes")
WORDS = (
    "OPTICS LAB", "CERAMICS", "LIBRARY", "SERVER ROOM", "KITCHEN", "WORKSHOP", "ARCHIVE", "MEETING", "STORE", "EXIT",
)  # fmt: skip
SIGN_SPACING_M, FIRST_SIGN_M = 8.0, 4.0
AP_SPACING_M = HALL_SPACING_M = 10.0
MAC_FIRST = 0x02005E110010
WALL_LOSS_DB = 8.0


@dataclass(frozen=True, slots=True)
class Corridor:
    """A straight corridor, closed at both ends."""

    length_m: float
    width_m: float
    signs: str = ""
    """"words", "numbers" or none."""
    has_wifi: bool = True

    def plan(self) -> Floorplan:
        """The floor plan."""
        along_m = np.arange(FIRST_SIGN_M, self.length_m, SIGN_SPACING_M) if self.signs else ()
        texts = itertools.cycle(WORDS) if self.signs == "words" else (f"DOOR {k}" for k in itertools.count())
        signs = [Sign(text, np.array([x, 0.0]), math.pi / 2) for x, text in zip(along_m, texts, strict=False)]
        places = [(x, self.width_m / 2) for x in np.arange(AP_SPACING_M / 2, self.length_m, AP_SPACING_M)]
        return _box(self.length_m, self.width_m, signs, places if self.has_wifi else [])


@dataclass(frozen=True, slots=True)
class Hall:
    """A square hall."""

    side_m: float

    def plan(self) -> Floorplan:
        """The floor plan."""
        along_m = np.arange(HALL_SPACING_M / 2, self.side_m, HALL_SPACING_M)
        signs = [Sign(f"GATE {k}", np.array([x, 0.0]), math.pi / 2) for k, x in enumerate(along_m)]
        signs += [Sign(f"DOCK {k}", np.array([x, self.side_m]), -math.pi / 2) for k, x in enumerate(along_m)]
        thirds_m = (np.arange(3) + 0.5) * self.side_m / 3
        return _box(self.side_m, self.side_m, signs, list(itertools.product(thirds_m, thirds_m)))


SCENES: dict[str, Corridor | Hall] = {
    "corridor 1.2 m": Corridor(80.0, 1.2),
    "corridor 2 m": Corridor(80.0, 2.0),
    "corridor 3 m": Corridor(80.0, 3.0),
    "corridor 2 m, 160 m long": Corridor(160.0, 2.0),
    "corridor 1.2 m, words": Corridor(80.0, 1.2, "words"),
    "corridor 2 m, words": Corridor(80.0, 2.0, "words"),
    "corridor 1.2 m, words, without WiFi": Corridor(80.0, 1.2, "words", has_wifi=False),
    "corridor 2 m, numbers": Corridor(80.0, 2.0, "numbers"),
    "corridor 2 m, numbers, without WiFi": Corridor(80.0, 2.0, "numbers", has_wifi=False),
    "hall": Hall(60.0),
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of this table."""
    add_seeds(parser, "0-9", "seeds of the episodes of each scene")
    add_some(parser, "--scenes", SCENES, "scenes")
    parser.add_argument("--robots", type=count, default=3, help="number of robots")
    parser.add_argument("--steps", type=count, default=2000, help="maximum steps per episode")


def rows(options: argparse.Namespace, runner: Runner) -> list[dict]:
    """One row per scene."""
    runs = runner.grid(
        options.scenes, options.seeds, lambda scene, seed: episode(scene, seed, options.robots, options.steps)
    )
    return [_row(scene, episodes) for scene, episodes in runs.items()]


def episode(scene: str, seed: int, robots: int, steps: int) -> dict:
    """One episode in one scene."""
    settings = {"robots": robots, "max_cycles": steps, "action.kind": "frontier"}
    env = ExplorationEnv(config=settings, floorplan=SCENES[scene].plan())
    observations, _ = env.reset(seed=seed)
    while env.agents:  # the first valid choice is the nearest frontier
        observations, *_ = env.step({agent: int(observations[agent]["action_mask"].argmax()) for agent in env.agents})
    env.engine.finish()
    (mapper,), result = env.engine.mappers, env.result()
    figures = result.figures
    return {
        "merged_share": figures["merged_robots"] / robots,
        "wrong_merges": figures["wrong_merges"],
        "undone": mapper.merges_undone,
        "false_closures": sum(
            row["status"] == "accepted" and not row["correct"] and not closure.is_loose
            for row, closure in zip(result.closures, mapper.closures, strict=True)
        ),
        "ate_m": figures["team_ate_m"],
    }


def _row(scene: str, runs: list[dict]) -> dict:
    ate_m = [run["ate_m"] for run in runs]
    return {
        "scene": scene,
        "episodes": len(runs),
        "merged_share": round(float(np.mean([run["merged_share"] for run in runs])), 3),
        "wrong_merges": sum(run["wrong_merges"] for run in runs),
        "wrong_episodes": sum(run["wrong_merges"] > 0 for run in runs),
        "undone": sum(run["undone"] for run in runs),
        "false_closures": sum(run["false_closures"] for run in runs),
        "ate_m": round(float(np.mean(ate_m)), 4),
        "ate_worst_m": round(max(ate_m), 4),
    }


def _box(length_m: float, width_m: float, signs: list[Sign], access_points_m: list[tuple[float, float]]) -> Floorplan:
    """Four walls with signs and access points."""
    corners = np.array([(0.0, 0.0), (length_m, 0.0), (length_m, width_m), (0.0, width_m)])
    return Floorplan(
        f"bare {length_m:g} x {width_m:g} m",
        np.stack([corners, np.roll(corners, -1, axis=0)], axis=1),
        np.full(4, WALL_LOSS_DB),
        signs=tuple(signs),
        access_points=tuple(
            AccessPoint(f"AP {k}", np.array(place), (MAC_FIRST + 256 * k,)) for k, place in enumerate(access_points_m)
        ),
        interior_m=np.array([[length_m / 2, width_m / 2]]),
    )
