"""Walls crossed in a real flat (Kolakowski 2021): six BLE transmitters, known walls, one robot.

The wall plan is used for scoring alone. k is cut at each `k_max` in truth and estimates; `majority` is the accuracy of
always guessing the commonest k. `ours` maps all transmitters at once; `signal` is its signal model alone, without a map.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from twc_env.datasets.ble_flat import read_ble_run, read_flat
from twc_env.reproduce import radio_places as places
from twc_env.reproduce import sfw_scoring as scoring
from twc_env.reproduce.runner import Runner, data_folder
from twc_env.reproduce.sfw_walks import RadioWalk
from twc_env.slam.k_visibility_signal import bin_along_path, fit_signal, k_means, predict_walls, sliding_window

Array = NDArray

SUMMARY = "walls crossed in a real flat with six BLE transmitters"
_WALL_FACES = 2
_WINDOW = 7
_RUNS = ("calib3", "calib4")
"""Drives in the order of time; the calibration set is no path."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of `reproduce sfw-ble`."""
    parser.add_argument("--out", type=Path, default=Path("runs/sfw-ble"), help="pictures (default: %(default)s)")


def rows(options: argparse.Namespace, runner: Runner) -> list[dict]:
    """One row per k_max and method, over all drives and transmitters."""
    folder = data_folder() / "wifi" / "ble_lidar"
    runs = runner.each(_RUNS, lambda run: measure(run, folder, options.out))
    table = []
    for k_max in (1, 2, 3):
        true = np.minimum(np.concatenate([run["true"] for run in runs]), k_max)
        majority = float(np.bincount(true).max() / len(true))
        for method in ("k-means", "signal", "ours"):
            guess = np.concatenate([run[f"{method} {k_max}"] for run in runs])
            table.append(
                {"k_max": k_max, "method": method, "k_accuracy": float(np.mean(guess == true)), "majority": majority}
            )
    return table


def measure(run: str, folder: Path, out: Path | None) -> dict:
    """True and estimated k of every reading heard, by method and k_max."""
    survey = read_ble_run(folder, run)
    plan = places.flat(read_flat(folder), 6.0)
    routers = survey.transmitters[0]
    crossed = np.column_stack([plan.wall_index.crossing(router, survey.position_m)[0] for router in routers])
    walk = RadioWalk(
        survey.position_m, survey.rssi_dbm.astype(float), routers, (crossed + _WALL_FACES - 1) // _WALL_FACES
    )
    heard = np.isfinite(walk.rssi_dbm)
    mapped = scoring.by_ours(walk, plan.cells(scoring.RESOLUTION_M), seed=0)
    bins = bin_along_path(walk.position_m, walk.rssi_dbm)
    figures = {"true": walk.walls[heard]}
    for k_max in (1, 2, 3):
        by_means, by_signal = np.zeros(walk.walls.shape, int), np.zeros(walk.walls.shape, int)
        for r, router in enumerate(routers):
            level = walk.rssi_dbm[heard[:, r], r]
            smooth = sliding_window(level, _WINDOW)
            by_means[heard[:, r], r] = predict_walls(smooth, k_means(smooth, k_max + 1))
            by_signal[:, r] = fit_signal(bins, r, router, k_max).walls[bins.bin_of]
        figures[f"k-means {k_max}"] = by_means[heard]
        figures[f"signal {k_max}"] = by_signal[heard]
        figures[f"ours {k_max}"] = np.minimum(mapped.structure.walls, k_max)[heard]
    if out is not None:
        cells = plan.cells(scoring.RESOLUTION_M)
        scoring.draw_maps(out / f"{run}.png", f"flat, {run}", walk, cells, {"ours": mapped})
    return figures
