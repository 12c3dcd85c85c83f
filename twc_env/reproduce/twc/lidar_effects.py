"""What each limit and error of real laser scanners costs: merging and trajectory error, one effect at a time.

Episodes are those of `merging`: robots without a common frame walk through unseen buildings on partially overlapping
paths. `d_ate_m` is the mean difference to the row `none` in the same buildings, `sd_ate_m` its standard deviation over
buildings. Rolling scans are shown with and without being undone by odometry (`slam.undoes_rolling`).
"""

from __future__ import annotations

import argparse
import math

import numpy as np

from twc_env.config import LIDAR_PRESETS
from twc_env.reproduce.runner import Runner, add_some
from twc_env.reproduce.twc.merging import first_buildings, merge_in
from twc_env.running.options import count, natural

CHOOSES = ("buildings", "effects")
EFFECTS: dict[str, dict[str, object]] = {
    "none": {},
    "270 degrees": {"lidar.field_of_view_rad": 1.5 * math.pi},
    "180 degrees": {"lidar.field_of_view_rad": math.pi},
    "mounting": {"lidar.mount_x_m": 0.2, "lidar.mount_yaw_rad": 0.5},
    "minimum range": {"lidar.range_min_m": 0.5},
    "5 Hz": {"lidar.rate_hz": 5.0},
    "rolling 10 Hz": {"lidar.rate_hz": 10.0, "lidar.is_rolling": True},
    "rolling 10 Hz, not undone": {"lidar.rate_hz": 10.0, "lidar.is_rolling": True, "slam.undoes_rolling": False},
    "rolling 5 Hz": {"lidar.rate_hz": 5.0, "lidar.is_rolling": True},
    "rolling 5 Hz, not undone": {"lidar.rate_hz": 5.0, "lidar.is_rolling": True, "slam.undoes_rolling": False},
    "noise 1 % of range": {"lidar.range_noise_per_m": 0.01},
    "noise 3 % of range": {"lidar.range_noise_per_m": 0.03},
    "lost returns": {"lidar.detection_range_m": 12.0},
    "lost returns, dark": {"lidar.detection_range_m": 12.0, "lidar.dark_share": 0.1},
    "mixed pixels": {"lidar.beam_divergence_rad": 0.01},
    **{name: {"lidar.preset": name} for name in LIDAR_PRESETS if name != "ideal"},
}
"""Settings of each row."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of this table."""
    parser.add_argument("--buildings", type=count, default=8, help="number of test-split buildings")
    parser.add_argument("--robots", type=count, default=3, help="number of robots")
    parser.add_argument("--seed", type=natural, default=0, help="noise seed")
    add_some(parser, "--effects", EFFECTS, "rows")


def rows(options: argparse.Namespace, runner: Runner) -> list[dict]:
    """One row per effect; `none` is always among them."""
    names = list(dict.fromkeys(["none", *options.effects]))

    def merged(name: str, building: str) -> dict:
        return merge_in(building, options.robots, options.seed, EFFECTS[name])

    runs = runner.grid(names, first_buildings(options.buildings), merged, what="building")
    return [_row(name, runs[name], runs["none"]) for name in names]


def _row(name: str, runs: list[dict], without: list[dict]) -> dict:
    ate_m = np.array([run["team_ate_m"] for run in runs])
    difference_m = ate_m - [run["team_ate_m"] for run in without]
    return {
        "effect": name,
        "buildings": len(runs),
        "fully_merged": sum(run["fully_merged"] for run in runs),
        "wrong_merges": sum(run["wrong_merges"] for run in runs),
        "ate_m": round(float(ate_m.mean()), 4),
        "ate_max_m": round(float(ate_m.max()), 4),
        "d_ate_m": round(float(difference_m.mean()), 4),
        "sd_ate_m": round(float(difference_m.std()), 4),
        "wall_thickness_m": round(float(np.mean([run["wall_thickness_m"] for run in runs])), 4),
    }
