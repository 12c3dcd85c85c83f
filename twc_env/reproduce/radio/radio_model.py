"""The radio model against measurements: real and simulated statistics by the same estimators.

Each survey is simulated at its own locations, in a plan that imitates its building, and both sets of readings are
evaluated by the same function. `calibrated` rows belong to data sets to which the presets were fitted; `reported` rows
to data sets that were only evaluated afterwards, with the same settings. The preset `radio-indoor` is used for the
offices, the library and the robot's floor, `radio-mall` for the malls. Properties of a place or device (its plan, the
number of transmitters, the power of a tag or router, the detection limit of a phone) are set per place.

`real_low` and `real_high` give the natural variation between real places of the kind: the central 95 % of a bootstrap
over the data set's access points, anchors or walks, or the range over three positions of a router; none for published
values. `real_near` is the share of these within 15 % of the real value, that is, how often a perfect model would be.
"""

from __future__ import annotations

import argparse
import dataclasses
import hashlib
import math
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from twc_env.errors import ConfigError
from twc_env.records.json_values import plain
from twc_env.reproduce.radio.radio_likeness import MALLS, ROBOT_FLOOR
from twc_env.reproduce.radio.radio_offices import OFFICES
from twc_env.reproduce.radio.radio_papers import FINGERPRINT_SLAM, K_VISIBILITY
from twc_env.reproduce.radio.radio_study import NEAR, Figures, Spread, Study
from twc_env.reproduce.radio.radio_surveys import FLATS, LIBRARIES
from twc_env.reproduce.runner import Runner, data_folder
from twc_env.running.options import count

CHOOSES = ("runs", "only")

_SPREAD, _REAL = -2, -1
_NAMES = {_SPREAD: "spread", _REAL: "real"}
"""Part numbers of a set other than simulated runs."""
_DETECTED_MIN = 0.02
"""Detection rates below this are left out, since their relative error is not meaningful."""
STUDIES: tuple[Study, ...] = (
    *OFFICES, *LIBRARIES, *FLATS, *MALLS, ROBOT_FLOOR, *FINGERPRINT_SLAM, *K_VISIBILITY,
)  # fmt: skip
"""All sets, in the order of the rows."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the table."""
    parser.add_argument(
        "--runs", type=count, default=6, metavar="N", help="simulated runs; four times as many for small sets"
    )
    parser.add_argument(
        "--only", default="", metavar="TEXT", help="only data sets whose name contains this text (default: all)"
    )
    parser.add_argument("--quick", action="store_true", help="a small part of each data set, as a smoke test")


def rows(options: argparse.Namespace, runner: Runner) -> list[dict]:
    """{quantity, dataset, role, real, simulated, real_low, real_high, real_near}; simulated is the mean over seeds."""
    chosen = [study for study in STUDIES if options.only in study.name]
    if not chosen:
        raise ConfigError(f"no set is named {options.only!r}; known are {', '.join(s.name for s in STUDIES)}")
    folder = data_folder()
    parts = [(study, seed) for study in chosen for seed in range(_SPREAD, options.runs * study.runs)]
    found = runner.each(parts, lambda part: _measure(part, folder, options.quick), _label)
    table = []
    for study in chosen:
        spread, real, *runs = [figures for (other, _), figures in zip(parts, found, strict=True) if other is study]
        for quantity, value in real.items():
            if quantity.startswith("detection rate") and (value is None or value < _DETECTED_MIN):
                continue
            known = [run[quantity] for run in runs if run[quantity] is not None]
            simulated = float(np.mean(known)) if known else float("nan")
            low, high, near = spread.get(quantity, (None, None, None))
            table.append(
                {
                    "quantity": quantity,
                    "dataset": study.name,
                    "role": study.role,
                    "real": value,
                    "simulated": simulated,
                    "real_low": low,
                    "real_high": high,
                    "real_near": near,
                }
            )
    runner.notes += notes(plain(table))
    return table


def notes(table: Sequence[dict]) -> Iterator[str]:
    """How many rows of each role are near the real figure, and how many a perfect model would have there."""
    for role in ("calibrated", "reported"):
        mine = [row for row in table if row["real"] and row["role"] == role]
        if mine:
            near = sum(map(_is_near, mine))
            yield f"{role}: {near} of {len(mine)} rows within {NEAR:.0%} of the real figure ({near / len(mine):.0%})"
        if known := [row for row in mine if row["real_low"] is not None]:
            inside = sum(row["real_low"] <= (row["simulated"] or math.nan) <= row["real_high"] for row in known)
            yield (
                f"{role}: of {len(known)} rows whose spread the data tells, {inside} are within it, and "
                f"{sum(map(_is_near, known))} within {NEAR:.0%}, where other real places of the kind would have "
                f"{sum(row['real_near'] for row in known):.1f}"
            )


def _is_near(row: dict) -> bool:
    return row["simulated"] is not None and abs(row["simulated"] / row["real"] - 1.0) <= NEAR


def _measure(part: tuple[Study, int], folder: Path, quick: bool) -> Figures | Spread:
    study, seed = part
    if seed == _SPREAD:
        return study.spread(folder, quick)
    return study.real(folder, quick) if seed == _REAL else study.simulated(folder, study.config, seed, quick)


def _label(part: tuple[Study, int]) -> str:
    """The label of a part, with a digest of its settings, so that changed presets are recomputed."""
    study, seed = part
    settings = hashlib.sha256(repr(dataclasses.asdict(study.config)).encode()).hexdigest()[:8]
    return f"{study.name} {_NAMES.get(seed, f'simulated {seed}')} {settings if seed >= 0 else ''}"
