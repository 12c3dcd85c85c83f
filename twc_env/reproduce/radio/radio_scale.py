"""Scaling of radio SLAM: one robot driving ever further through one building, and search among many fingerprints.

Each row is one stretch of the run through the semi-indoor twin, averaged over seeds (`error_sd_m` is the standard
deviation over seeds of the stretch's mean error): the memory held by `slam.radio_trail` at its end, and the CPU time
per scan, including the optimisations every 30 m. Errors are given the first pose. Odometry drifts like that of the
twin, without adjustment to the published error.
"""

from __future__ import annotations

import argparse
import pickle
import time

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.config import RadioSlamConfig
from twc_env.maps import load_map
from twc_env.records.geometry import compose
from twc_env.records.messages import Fingerprint
from twc_env.reproduce.radio import radio_walks
from twc_env.reproduce.radio.radio_twins import PLACES, radio_config
from twc_env.reproduce.runner import Runner, add_seeds
from twc_env.running.options import count, number
from twc_env.slam.radio.radio_similarity import FingerprintStore, all_similarities, feature_rows
from twc_env.slam.radio.radio_trail import RadioTrail

CHOOSES = ("seeds",)
PLACE = PLACES["semi-indoor"]
HEARD = 44
"""Number of addresses per fingerprint in the search."""
SPREADS = {"in a building of 4096 addresses": 4096, "in one room of 88 addresses": 88}
BULK, REPEATS = 4000, 5


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of `twc-env reproduce radio-scale`."""
    add_seeds(parser, "0-1", "seeds of the drives")
    parser.add_argument("--length", type=number(100.0, 1e6), default=10_000.0, help="path length in metres")
    parser.add_argument("--stored", type=count, default=100_000, help="number of stored fingerprints")


def rows(options: argparse.Namespace, runner: Runner) -> list[dict]:
    """{travel_km, places, memory_kib, scan_ms, scan_ms_max, error_mean_m, error_sd_m, odometry_mean_m, seeds}."""
    parts = [(options.length, seed) for seed in options.seeds]
    runs = runner.each(parts, run, lambda part: f"{part[0]:g} m, seed {part[1]}", processes=min(2, len(parts)))
    speeds = runner.each(
        list(SPREADS.values()), lambda spread: similarity_speed(options.stored, spread), lambda n: f"similarity {n}"
    )
    for where, speed in zip(SPREADS, speeds, strict=True):
        runner.notes.append(
            f"{HEARD} addresses heard {where}: one against {options.stored} stored {speed['search_ms']:.2f} ms, "
            f"all pairs of {BULK} {speed['pair_us']:.4f} us a pair"
        )
    return [_row(k, runs) for k in range(len(runs[0]))]


def _row(stretch: int, runs: list[list[dict]]) -> dict:
    mine = [run[stretch] for run in runs]
    row = {key: float(np.mean([part[key] for part in mine])) for key in mine[0]}
    row["error_sd_m"] = float(np.std([part["error_mean_m"] for part in mine]))
    return row | {"seeds": len(mine)}


def run(part: tuple[float, int]) -> list[dict]:
    """One drive of (length [m], seed); a dictionary for each of ten stretches."""
    length_m, seed = part
    truth = radio_walks.drive(PLACE.twin, length_m, PLACE.speed_m_s, seed, PLACE.resolution_m)
    at = np.arange(0, len(truth), radio_walks.STEPS_PER_SCAN)
    motions, turned_rad = radio_walks.measured_odometry(truth, at, PLACE.drift, seed)
    truth = truth[at]
    prints = radio_walks.scan_radio(load_map(PLACE.twin), radio_config(PLACE, "wifi"), truth, seed)
    odometry = radio_walks.dead_reckoning(truth[0], motions)
    motions, turned_rad = np.concatenate([np.zeros((1, 3)), motions]), np.append(0.0, turned_rad)
    _warm_up(motions, turned_rad, prints)
    trail, out = RadioTrail(RadioSlamConfig()), []
    for stretch in np.array_split(np.arange(len(truth)), 10):
        poses, spent = np.empty((len(stretch), 3)), np.empty(len(stretch))
        for k, scan in enumerate(stretch.tolist()):
            began = time.process_time()
            poses[k] = trail.add(motions[scan], float(turned_rad[scan]), prints[scan])
            spent[k] = time.process_time() - began
        away = compose(truth[0], poses)[:, :2] - truth[stretch, :2]
        out.append(
            {
                "travel_km": 1e-3 * length_m * (stretch[-1] + 1) / len(truth),
                "places": len(trail),
                "memory_kib": len(pickle.dumps(trail)) / 1024,
                "scan_ms": 1e3 * float(spent.mean()),
                "scan_ms_max": 1e3 * float(spent.max()),
                "error_mean_m": float(np.linalg.norm(away, axis=1).mean()),
                "odometry_mean_m": float(np.linalg.norm((odometry - truth)[stretch, :2], axis=1).mean()),
            }
        )
    return out


def _warm_up(motions: Array, turned_rad: Array, prints: tuple[Fingerprint, ...]) -> None:
    """Compile the kernels of a run."""
    trail = RadioTrail(RadioSlamConfig())
    for motion, turn, heard in zip(motions[:300], turned_rad[:300].tolist(), prints[:300], strict=True):
        trail.add(motion, turn, heard)


def similarity_speed(stored: int, transmitters: int) -> dict[str, float]:
    """{search_ms, pair_us}: CPU time of one against many, and per pair of all pairs; the best of several."""
    random = np.random.default_rng(0)
    prints = [_made(random, transmitters) for _ in range(max(stored, BULK))]
    store = FingerprintStore()
    for one in prints[:stored]:
        store.add(one)
    store.nearest(prints[0], 5)
    search_s = min(_spent(lambda: store.nearest(_made(random, transmitters), 5)) for _ in range(20))
    table = feature_rows(prints[:BULK])
    all_similarities(table[:10])
    bulk_s = min(_spent(lambda: all_similarities(table)) for _ in range(REPEATS))
    return {"search_ms": 1e3 * search_s, "pair_us": 1e6 * bulk_s / (BULK * (BULK - 1) / 2)}


def _made(random: np.random.Generator, transmitters: int) -> Fingerprint:
    """A random fingerprint of neighbouring addresses, as from near transmitters."""
    first = random.integers(0, transmitters - 2 * HEARD + 1)
    macs = first + np.sort(random.choice(2 * HEARD, HEARD, replace=False))
    return Fingerprint(macs.astype(np.int64), random.uniform(-90.0, -40.0, HEARD))


def _spent(work) -> float:
    began = time.process_time()
    work()
    return time.process_time() - began
