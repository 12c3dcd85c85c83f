"""Number of walls crossed in a real flat (Kolakowski 2021): six BLE transmitters, known walls, one robot.

The wall plan is used for scoring only. k is capped at each `k_max` in truth and estimates; `majority` is the accuracy
of always guessing the most frequent k. `ours` is the signal model along the path, with power, exponent and wall loss
shared by all (identical) tags; `map` counts walls of the map that explains all rays jointly
(`k_visibility.map_structure`, with its defaults, each tag on its own); `known signal` rounds each smoothed reading by
itself, given the true power, exponent and loss.

The calibration run holds four drives. The priors of the signal model were chosen on the last two, which are also runs
of their own and stay in one room and the adjacent hall; the other two are the test.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from twc_env.datasets.surveys.ble_flat import read_ble_run, read_flat
from twc_env.reproduce import radio_places as places
from twc_env.reproduce.drawing import Pictures, pictures_of
from twc_env.reproduce.runner import Runner, data_folder
from twc_env.reproduce.walls import sfw_scoring as scoring
from twc_env.reproduce.walls.sfw_walks import WalkReadings
from twc_env.running.options import add_folder, add_pictures
from twc_env.slam.walls.k_clusters import k_means, predict_walls, sliding_window
from twc_env.slam.walls.k_visibility_signal import fit_identical_routers
from twc_env.slam.walls.path_bins import bin_along_path

_WINDOW = 7
TEST = "calibration, first two drives"
_TEST_WALKS = (0, 1)
RUNS = (TEST, "calibration", "calib3", "calib4")
METHODS = ("k-means", "known signal", "map", "ours")
_TRUE_SIGNAL = (-50.7, 0.77, 6.0)
"""Power [dBm], exponent and wall loss [dB] fitted to the first run with the walls known."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of `reproduce sfw-ble`."""
    add_folder(parser, "--out", "runs/sfw-ble", "folder for pictures")
    add_pictures(parser)


def rows(options: argparse.Namespace, runner: Runner) -> list[dict]:
    """One row per drive, k_max and method, over all transmitters."""
    folder = data_folder() / "wifi" / "ble_lidar"
    runs = runner.each(
        RUNS,
        lambda run: measure(run, folder, pictures_of(options)),
        lambda run: f"{run}, drawn in {options.out}",
    )
    table = []
    for name, run in zip(RUNS, runs, strict=True):
        for k_max in (1, 2, 3):
            true = np.minimum(run["true"], k_max)
            majority = float(np.bincount(true).max() / len(true))
            for method in METHODS:
                accuracy = float(np.mean(np.array(run[f"{method} {k_max}"]) == true))
                table.append(
                    {"run": name, "k_max": k_max, "method": method, "k_accuracy": accuracy, "majority": majority}
                )
    return table


def remarks(table: list[dict]) -> list[str]:
    """A sentence on the limits of the accuracy."""
    return [
        "the first wall takes 10 dB on average and the second 4 dB more, a reading strays by 6 dB: even with the true "
        "power, exponent and loss known, two walls are hardly told from one by strength alone; rays that cross say more"
    ]


def measure(run: str, folder: Path, pictures: Pictures | None) -> dict:
    """True and estimated k of every reading heard, by method and k_max."""
    survey = read_ble_run(folder, run.partition(",")[0])
    if run == TEST:
        survey = survey.at_scans(np.isin(survey.walk, _TEST_WALKS))
    plan = places.flat(read_flat(folder), 6.0)
    routers = survey.transmitters[0]
    crossed = np.column_stack([plan.wall_index.crossing(router, survey.position_m)[0] for router in routers])
    walk = WalkReadings(survey.position_m, survey.rssi_dbm.astype(float), routers, places.walls_of(crossed))
    heard = np.isfinite(walk.rssi_dbm)
    bins = bin_along_path(walk.position_m, walk.rssi_dbm)
    figures = {"true": walk.walls[heard]}
    power, exponent, loss = _TRUE_SIGNAL
    apart_m = np.linalg.norm(bins.position_m[:, None] - routers, axis=2)
    excess = power - 10 * exponent * np.log10(np.maximum(apart_m, 0.5)) - bins.rssi_dbm
    cells = plan.cells(scoring.RESOLUTION_M)
    mapped = scoring.by_ours(walk, cells, seed=0)
    structure = mapped.structure
    assert structure is not None
    known = np.maximum(np.round(np.nan_to_num(excess) / loss), 0).astype(int)[bins.bin_of]
    for k_max in (1, 2, 3):
        by_means = np.zeros(walk.walls.shape, int)
        for r in range(len(routers)):
            smooth = sliding_window(walk.rssi_dbm[heard[:, r], r], _WINDOW)
            by_means[heard[:, r], r] = predict_walls(smooth, k_means(smooth, k_max + 1))
        by_signal = np.column_stack([fit.walls[bins.bin_of] for fit in fit_identical_routers(bins, routers, k_max)])
        found = {"k-means": by_means, "known signal": known, "map": structure.walls, "ours": by_signal}
        figures |= {f"{method} {k_max}": np.minimum(walls, k_max)[heard] for method, walls in found.items()}
    title = f"flat, {run} (k of the strongest transmitter)"
    scoring.draw_maps(pictures, run, title, walk, cells, {"map": mapped})
    return figures
