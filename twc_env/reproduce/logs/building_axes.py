"""Alignment of paths with a building's axes: corrected paths of public laser logs, and the walks of `radio-table1`.

Places are sampled every 3 m along a path. Some of the segments between them follow two orthogonal directions, with a
normally distributed deviation; the others have any direction. The share of the former and the deviation are fitted to
each path. `slam.building_axes.STD_RAD` was chosen on the logs; the walks were only evaluated.
"""

from __future__ import annotations

import argparse
import dataclasses

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.datasets.logs.scan_log import apart
from twc_env.reproduce.logs.laser_logs import LOGS, corrected_log
from twc_env.reproduce.radio.radio_twins import PLACES, true_path
from twc_env.reproduce.runner import Runner, add_seeds
from twc_env.slam.radio.building_axes import LENGTH_M, BuildingAxes

CHOOSES = ("seeds",)
ROUNDS = 100
LEAST_RAD = np.radians(1.0)
"""Lower limit of the deviation: otherwise a few segments exactly on an axis would dominate the fit."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the table."""
    add_seeds(parser, "0-1", "seeds of the walks in each place")


def rows(options: argparse.Namespace, runner: Runner) -> list[dict]:
    """One row per path: {path, role, ways, share, std_deg}."""
    found = runner.each(LOGS, lambda log: figures(corrected_log(log).poses))
    table = [{"path": log, "role": "calibrated", **row} for log, row in zip(LOGS, found, strict=True)]
    walks = runner.grid(PLACES, options.seeds, lambda name, seed: figures(true_path(PLACES[name], seed)))
    return table + [
        {"path": f"{name}, walk {seed}", "role": "reported", **row}
        for name, rows_ in walks.items()
        for seed, row in zip(options.seeds, rows_, strict=True)
    ]


def figures(path: Array) -> dict[str, float]:
    """Number of segments of a path (n, 3), the share that follows the axes, and their deviation [deg], at least 1."""
    places, axes = path[apart(path, LENGTH_M), :2], BuildingAxes()
    for _ in range(ROUNDS):
        axes = dataclasses.replace(axes.fitted(places), std_rad=max(axes.deviation_rad(places), LEAST_RAD))
    return {"ways": len(places) - 1, "share": axes.share, "std_deg": float(np.degrees(axes.std_rad))}
