"""What the size of odometry errors costs on laser logs, with what the engine assumes of all logs and with what each
shows.

The logs are driven again with Intel's odometry errors times each size (`resampled_odometry`; 0: perfect odometry). With
`noise` "assumed" the engine is not told the size; with "from log" it finds the errors by matching scans, as `twc-env
replay` does. Good odometry should end no worse than poor one. `ate_m` is the mean distance to the log's own corrected
path over the draws, `ate_std_m` and `ate_max_m` their spread and the worst one, and `odometry_ate_m` is what the
odometry alone gives.
"""

from __future__ import annotations

import argparse

import numpy as np

from twc_env.reproduce.logs.laser_logs import LOGS
from twc_env.reproduce.logs.resampled_odometry import drive_again
from twc_env.reproduce.runner import Runner, add_seeds, add_some, data_folder
from twc_env.running.options import count, number

CHOOSES = ("logs", "sizes", "noises", "seeds")
NOISES = ASSUMED, FROM_LOG = "assumed", "from log"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the table."""
    add_some(parser, "--logs", LOGS, "logs")
    parser.add_argument(
        "--sizes",
        type=number(0.0, 10.0),
        nargs="+",
        default=[0.0, 0.25, 1.0, 2.0],
        help="multiples of Intel's errors (default: 0 0.25 1 2)",
    )
    add_some(parser, "--noises", NOISES, "what the engine goes by")
    parser.add_argument("--jobs", type=count, default=1, help="number of worker processes")
    add_seeds(parser, "0-2", "draws of the errors")


def rows(options: argparse.Namespace, runner: Runner) -> list[dict]:
    """One row per log, size and noise."""
    data_folder()  # without data this fails before the first log
    kinds = [(name, size, noise) for name in options.logs for size in options.sizes for noise in options.noises]
    cases = [(*kind, seed) for kind in kinds for seed in options.seeds]
    found = runner.each(cases, _drive, lambda case: f"{case[0]}, {case[1]:g} times, {case[2]}, {case[3]}", options.jobs)
    table = []
    for k, (name, size, noise) in enumerate(kinds):
        runs = found[k * len(options.seeds) : (k + 1) * len(options.seeds)]
        ate_m, odometry_ate_m = (np.array([run[key] for run in runs]) for key in ("ate_m", "odometry_ate_m"))
        table.append(
            {
                "log": name,
                "size": size,
                "noise": noise,
                "draws": len(ate_m),
                "ate_m": float(ate_m.mean()),
                "ate_std_m": float(ate_m.std()),
                "ate_max_m": float(ate_m.max()),
                "odometry_ate_m": float(odometry_ate_m.mean()),
            }
        )
    return table


def _drive(case: tuple[str, float, str, int]) -> dict:
    name, size, noise, seed = case
    return drive_again(name, size, seed, noise == FROM_LOG)
