"""Dead reckoning, simulated and real: errors of raw odometry at the hand-verified relations of the Intel Lab log.

The simulated robot drives along the log's corrected path and measures it with the odometry of the chosen platform; both
are evaluated at the same pairs of scans by the same code. The platform `pioneer-intel` was calibrated on the means over
all relations; error growth with path length and the long loops were only evaluated.
"""

from __future__ import annotations

import argparse
import itertools

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.config import OdometryConfig
from twc_env.datasets.logs.scan_log import Relations
from twc_env.records.geometry import between, compose, poses_along, travelled_m, wrap_angle
from twc_env.reproduce.logs.laser_logs import intel_log, intel_relations
from twc_env.reproduce.runner import Runner, add_seeds
from twc_env.running.options import number
from twc_env.world.sensors.odometry import PRESETS, Odometry

CHOOSES = ("seeds",)
WINDOW_M = 25.0
"""Path length over which a heading error per metre is averaged, to see whether it stays the same along the log."""

_BANDS_M = ((0.0, 0.5), (5.0, 200.0), (200.0, 1000.0))
"""Ranges of path length between the two scans of a relation."""
CURL = f"heading error per metre over {WINDOW_M:g} m: spread [deg/m]"
_LONG_S = 60.0
"""Relations over a longer time count as loops."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the table."""
    parser.add_argument("--platform", choices=tuple(PRESETS), default="pioneer-intel", help="odometry preset")
    parser.add_argument("--drift", type=number(0.0, 10.0), default=1.0, help="multiplier of the preset's errors")
    parser.add_argument(
        "--variation", type=number(0.0, 1.0), default=0.0, help="share of the systematic errors that varies on the way"
    )
    add_seeds(parser, "0-99", "seeds of the simulated drives")


def rows(options: argparse.Namespace, runner: Runner) -> list[dict]:
    """One row per figure: {quantity, role, relations, real, simulated, simulated_std}."""
    raw, corrected = intel_log(), intel_log(is_corrected=True)
    relations = intel_relations(raw)
    groups = _groups(relations, corrected.times_s, corrected.poses)
    config = OdometryConfig(platform=options.platform, drift=options.drift, variation=options.variation)

    def measured(poses: Array) -> dict[str, float]:
        return figures(poses, relations, groups) | {CURL: curl_spread_deg_m(poses, corrected.poses)}

    real = measured(raw.poses)
    simulated = runner.each(
        options.seeds,
        lambda seed: measured(dead_reckoning(corrected.poses, config, seed)),
        lambda seed: f"drive {seed} with {PRESETS[options.platform]}",
    )
    remaining = measured(corrected.poses)
    table = []
    for name, value in real.items():
        drives = [drive[name] for drive in simulated]
        table.append(
            {
                "quantity": name,
                "role": "calibrated" if name.startswith("all") else "reported",
                "relations": int(groups[name.split(":")[0]].sum()) if name != CURL else None,
                "real": value,
                "simulated": float(np.mean(drives)),
                "simulated_std": float(np.std(drives)),
                "corrected_path": remaining[name],
            }
        )
    return table


def dead_reckoning(path: Array, config: OdometryConfig, seed: int) -> Array:
    """Poses (k, 3) from the platform's odometry on a true path (k, 3), starting at its first pose."""
    odometry = Odometry(config, 1.0, 1, seed)
    motions = [odometry.measure(a[None], b[None])[0][0] for a, b in itertools.pairwise(path)]
    return compose(path[0], poses_along(np.array(motions)))


def curl_spread_deg_m(poses: Array, path: Array) -> float:
    """Standard deviation [deg/m] over stretches of WINDOW_M of the heading error per metre of poses (k, 3) along a true
    path (k, 3); constant errors leave only that of noise."""
    turned = wrap_angle(between(poses[:-1], poses[1:])[:, 2] - between(path[:-1], path[1:])[:, 2])
    stretch = (travelled_m(path)[1:] / WINDOW_M).astype(int)
    return float(np.degrees(np.bincount(stretch, turned)[:-1].std() / WINDOW_M))


def figures(poses: Array, relations: Relations, groups: dict[str, Array]) -> dict[str, float]:
    """Mean translation [m] and rotation [deg] error of poses (k, 3) over each group of relations."""
    translation_m, rotation_deg = relations.errors(poses)
    found = {}
    for name, chosen in groups.items():
        found[f"{name}: translation_m"] = float(translation_m[chosen].mean())
        found[f"{name}: rotation_deg"] = float(rotation_deg[chosen].mean())
    return found


def _groups(relations: Relations, times_s: Array, path: Array) -> dict[str, Array]:
    """Groups of relations: all, those over a long time, and ranges of path length in between."""
    travel_m = travelled_m(path)
    between_m = np.abs(travel_m[relations.second] - travel_m[relations.first])
    groups = {
        "all relations": np.ones(len(between_m), bool),
        f"loops over {_LONG_S:g} s": np.abs(times_s[relations.second] - times_s[relations.first]) > _LONG_S,
    }
    for low, high in _BANDS_M:
        chosen = (between_m >= low) & (between_m < high)
        if chosen.any():
            groups[f"path {low:g}-{high:g} m"] = chosen
    return groups
