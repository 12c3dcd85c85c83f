"""Table 1 of the radio SLAM paper: odometry, WiFi, LTE and WiFi with laser in twins of its three environments.

Each seed is another walk of the published length and duration, with the published odometry error (mean over the walk,
first pose given). Errors are means and standard deviations over all scan positions of a walk, with the first pose
given, averaged over seeds; `ate_m` is the root mean square after one rigid alignment. `paper` methods use the published
weighting: all pairs above the threshold, distances from Eq. 3 as printed, plain least squares. `false` methods add that
share of false closures (two places drawn at random and declared to be close).

With the first pose given, the error has two components that hardly affect `ate_m`. Radio determines neither the scale
of the map, which comes from odometry (off by up to 6 % semi-indoor), nor its rotation relative to the first heading,
which only odometry and the building's axes maintain (off by 2 degrees semi-indoor). The paper does not describe its
alignment.

With `wifi`, the radio map of a walk is also used: how far from the truth it locates the walk's other scans.
"""

from __future__ import annotations

import argparse
import functools
from pathlib import Path

import numpy as np

from twc_env.exploration.drawing.figures import require_matplotlib
from twc_env.reproduce.radio import radio_figures, radio_survey, radio_sweep
from twc_env.reproduce.radio.radio_methods import METHODS, location_errors_m, means, outcomes
from twc_env.reproduce.radio.radio_twins import PLACES
from twc_env.reproduce.runner import Runner, add_seeds, add_some
from twc_env.running.options import count, number, picture_options

CHOOSES = ("seeds", "places")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of `twc-env reproduce radio-table1`."""
    add_seeds(parser, "4-9", "walks, of which 0-3 were used for calibration")
    add_some(parser, "--places", PLACES, "places")
    add_some(parser, "--methods", METHODS, "methods")
    parser.add_argument("--jobs", type=count, default=2, help="parallel processes")
    parser.add_argument(
        "--share", type=number(0.01, 1.0), default=1.0, help="share of the published length, for a quick look"
    )
    parser.add_argument(
        "--sweep", action="store_true", help="instead: error by number of access points, drift and distance"
    )
    parser.add_argument(
        "--survey", action="store_true", help="instead: duration of a survey in large loops, and in small ones (Fig. 5)"
    )
    parser.add_argument(
        "--out", type=Path, metavar="FOLDER", help="folder for pictures: models, trajectories, map (Fig. 3, 4)"
    )


def rows(options: argparse.Namespace, runner: Runner) -> list[dict]:
    """One row per environment and method; means over seeds."""
    if options.sweep:
        return radio_sweep.rows(options.seeds, runner, options.share, options.jobs)
    if options.survey:
        return radio_survey.rows(options.seeds, runner, options.share, options.jobs)
    if options.out:
        require_matplotlib()  # before the first walk
    table = []
    for name, found in _walks(options, runner, options.seeds).items():
        walks = [walk["errors"] for walk in found]
        table += [_row(name, method, walks) for method in options.methods if method in walks[0]]
        _note_worse(runner, name, walks)
        for way in found[0]["located_m"]:
            error_m = np.mean([walk["located_m"][way] for walk in found])
            runner.notes.append(
                f"{name}, wifi: other scans of the walk are located to {error_m:.2f} m by its map, {way}"
            )
        if options.out and (kind := picture_options(options)):
            runner.notes += map(str, radio_figures.draw(options.out, name, PLACES[name].twin, found[0]["drawn"], kind))
    runner.notes.append("gmapping and wifi+lidar run semi-indoor only, as in print")
    runner.notes.append("settings were chosen on other walks: seeds 0 to 3 of all places, 100 to 105 semi-indoor")
    return table


def draw(options: argparse.Namespace, runner: Runner, folder: Path) -> list[Path]:
    """Draw the first walk of each place into the folder of the rows, unless --out names another."""
    if options.out or options.sweep or options.survey:
        return []
    first = _walks(options, runner, options.seeds[:1])
    return [
        path
        for name, (walk,) in first.items()
        for path in radio_figures.draw(folder, name, PLACES[name].twin, walk["drawn"], picture_options(options))
    ]


def _walks(options: argparse.Namespace, runner: Runner, seeds: list[int]) -> dict[str, list[dict]]:
    """Place -> results of `_measured` for each seed."""
    work = functools.partial(_measured, share=options.share, methods=options.methods)
    return runner.grid(options.places, seeds, work, options.jobs)


def _measured(name: str, seed: int, share: float, methods: list[str]) -> dict[str, dict]:
    """The errors of one walk by method, and the content of its pictures."""
    found = outcomes(PLACES[name].shortened(share), seed, methods)
    errors = {method: outcome.errors() for method, outcome in found.items()}
    located_m = location_errors_m(found["wifi"]) if "wifi" in found else {}
    return {"errors": errors, "drawn": radio_figures.content_of(found), "located_m": located_m}


def _row(name: str, method: str, walks: list[dict]) -> dict:
    printed = PLACES[name].printed.get(method.removesuffix(" paper"), (None, None))
    return {
        "environment": name,
        "method": method,
        **means([walk[method] for walk in walks]),
        "paper_mean_m": printed[0],
        "paper_std_m": printed[1],
        "seeds": len(walks),
    }


def _note_worse(runner: Runner, name: str, walks: list[dict]) -> None:
    """Note the spread over seeds of each method, and how often it is worse than the odometry of the same walk."""
    for method in walks[0]:
        if method == "odometry" or "odometry" not in walks[0]:
            continue
        errors_m = np.array([walk[method]["mean_m"] for walk in walks])
        worse = sum(walk[method]["mean_m"] > walk["odometry"]["mean_m"] + 1e-6 for walk in walks)
        runner.notes.append(
            f"{name}, {method}: seeds {errors_m.min():.2f} to {errors_m.max():.2f} m, sd {errors_m.std():.2f} m; "
            f"worse than its odometry in {worse} of {len(walks)}"
        )
