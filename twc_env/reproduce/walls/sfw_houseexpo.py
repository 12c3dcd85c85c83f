"""Structure from WiFi on HouseExpo plans, with a route along all walls (inverse k-visibility Fig. 7).

One router: the access point with the shortest mean distance to the route; signal strength from the preset `sfw`. The
walker keeps 0.3 m from walls, or less where doors are too narrow. In the largest plans one router does not reach
everywhere: see coverage. No setting was chosen on these plans.
"""

from __future__ import annotations

import argparse
import dataclasses
from pathlib import Path
from typing import Any

import numpy as np

from twc_env.config import radio_preset
from twc_env.datasets.buildings.house_expo import read_house_expo
from twc_env.errors import DataError, MapError
from twc_env.metrics import path_length_m
from twc_env.metrics.k_visibility import UNKNOWN, WALL, calibration_error, reliability
from twc_env.pictures.style import new_figure, style
from twc_env.reproduce.drawing import Pictures, pictures_of, save_picture
from twc_env.reproduce.radio_places import WALL_FACES
from twc_env.reproduce.runner import Runner, data_folder
from twc_env.reproduce.walls import sfw_scoring as scoring
from twc_env.reproduce.walls.sfw_walks import read_walk, resampled, wall_following_route
from twc_env.running.options import add_folder, add_pictures, count
from twc_env.world.building.floorplan import Floorplan

CHOOSES = ("plans",)
_READINGS_PER_M = 40.0
_WALL_LOSS_SCALE = 1.6
"""Walls of the plans have 5 dB; in the experiments of the paper it is 8 dB."""
_STANDOFFS_M = (0.3, 0.25, 0.2, 0.15)
_ALONG_SHARE = 0.85
"""Minimum length of a complete route, as a share of the length of walls."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of `reproduce sfw-houseexpo`."""
    parser.add_argument("--plans", type=count, default=30, help="number of plans, smallest files first")
    add_folder(parser, "--out", "runs/sfw-houseexpo", "folder for pictures")
    add_pictures(parser)


def rows(options: argparse.Namespace, runner: Runner) -> list[dict]:
    """One row per plan and method, and the mean of all at the end."""
    folder = data_folder() / "houseexpo"
    paths = sorted(folder.glob("*.json"), key=lambda path: path.stat().st_size)[: options.plans]
    if not paths:
        raise DataError(f"{folder} holds no plans (*.json); check the path")
    found = runner.each(
        paths,
        lambda path: measure(path, pictures_of(options)),
        lambda path: f"{path.stem[:8]}, drawn in {options.out}",
    )
    runs = [run for run in found if run]
    table = []
    for method in scoring.METHODS:
        own = [row for run in runs for row in run["rows"] if row["method"] == method]
        if own:
            averaged = ("area_m2", "standoff_m", "points", *scoring.FIGURES)
            means = {key: float(np.mean([row[key] for row in own])) for key in averaged}
            table.append({**own[0], **means, "plan": f"mean of {len(own)}", "calibration_error": None})
    cells = [np.array(run["cells"]) for run in runs]
    if cells and table:
        both = np.concatenate(cells)
        table[-1]["calibration_error"] = calibration_error(both[:, 0], both[:, 1] > 0.5)
        draw_reliability(pictures_of(options), both[:, 0], both[:, 1] > 0.5)
    return [row for run in runs for row in run["rows"]] + table


def measure(path: Path, pictures: Pictures | None) -> dict | None:
    """Results of both methods on one plan, and (probability, is wall) of our cells; None without a complete route."""
    plan = read_house_expo(path)
    found = _route(plan)
    if found is None:
        return None
    standoff_m, way = found
    route = resampled(way, int(np.clip(_READINGS_PER_M * path_length_m(way), 300, 6000)))
    nearest = min(plan.access_points, key=lambda p: float(np.linalg.norm(route - p.position_m, axis=1).mean()))
    plan = dataclasses.replace(plan, access_points=(nearest,))
    radio = dataclasses.replace(radio_preset("sfw"), wall_loss_scale=_WALL_LOSS_SCALE)
    walk = read_walk(plan, radio, route, seed=0, faces_per_wall=WALL_FACES)
    cells = plan.cells(scoring.RESOLUTION_M)
    maps = {"paper": scoring.by_paper(walk, cells), "ours": scoring.by_ours(walk, cells, seed=0)}
    scoring.draw_maps(pictures, path.stem[:8], path.stem, walk, cells, maps)
    ours = maps["ours"]
    told = np.isfinite(ours.probability) & (ours.truth != UNKNOWN)
    pairs = np.column_stack([ours.probability[told], ours.truth[told] == WALL]).round(3)
    return {
        "rows": [
            {
                "plan": path.stem[:8],
                "area_m2": plan.floor_area_m2,
                "standoff_m": standoff_m,
                "points": len(route),
                "method": method,
                **made.figures,
                "calibration_error": made.calibration_error,
            }
            for method, made in maps.items()
        ],
        "cells": pairs,
    }


def _route(plan: Floorplan) -> tuple[float, np.ndarray] | None:
    """The largest standoff with a complete route, and the route; None if there is none."""
    walls = float(np.linalg.norm(plan.walls_m[:, 0] - plan.walls_m[:, 1], axis=1).sum())
    for standoff_m in _STANDOFFS_M:
        try:
            way = wall_following_route(plan, standoff_m)
        except MapError:
            continue
        if path_length_m(way) >= _ALONG_SHARE * walls:
            return standoff_m, way
    return None


def remarks(table: list[dict]) -> list[str]:
    """The number of plans, and those that miss 0.97 free IoU or coverage 0.8."""
    own = [row for row in table if row["method"] == "ours" and not row["plan"].startswith("mean")]
    far = [row for row in own if row["coverage"] < 0.8]
    bad = [row for row in own if row["iou_free"] < 0.97]
    return [
        f"{len(own)} plans; coverage below 0.8 in {len(far)} ({_names(far)})",
        f"free IoU below 0.97 in {len(bad)} ({_names(bad)})",
    ]


def _names(rows_: list[dict]) -> str:
    return ", ".join(row["plan"] for row in rows_) or "none"


def draw_reliability(pictures: Pictures | None, probability: np.ndarray, is_wall: np.ndarray) -> None:
    """Draw the share of walls among cells by probability, if there are to be pictures."""
    if pictures is not None:
        with style():
            save_picture(_reliability_figure(probability, is_wall), pictures.folder / "reliability", pictures.kind)


def _reliability_figure(probability: np.ndarray, is_wall: np.ndarray) -> Any:
    mean, share, count = reliability(probability, is_wall)
    figure = new_figure((5, 5), dpi=100)
    axes = figure.add_subplot()
    axes.plot([0, 1], [0, 1], color="0.7")
    axes.plot(mean, share, "o-")
    for x, y, n in zip(mean, share, count, strict=True):
        if n:
            axes.annotate(f"{n:,}", (x, y), fontsize=7)
    axes.set(xlabel="probability of a wall", ylabel="share that are walls", aspect="equal")
    axes.set_title(f"expected calibration error {calibration_error(probability, is_wall):.3f}")
    return figure
