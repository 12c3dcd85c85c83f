"""Figures 3 and 4 of the radio SLAM paper for our walks: models, trajectories, occupancy map.

Their content is kept as JSON with the errors of a walk, so that drawing repeats no computation.
"""

from __future__ import annotations

import base64
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.maps import load_map
from twc_env.pictures.style import ROBOTS, fit_height, legend_below, new_figure
from twc_env.records.geometry import inverse, transform_points
from twc_env.records.messages import GridMap
from twc_env.reproduce.drawing import Kind, save_picture
from twc_env.reproduce.radio.radio_methods import Outcome

PATHS = {"odometry": ROBOTS[1], "lte": ROBOTS[2], "wifi": ROBOTS[0]}
"""Methods whose paths are drawn, and their colours; `lte` and `wifi` have models too."""
LOG_ODDS_SCALE, LOG_ODDS_MAX = 10.0, 6.0
DIGITS = 2


def content_of(outcomes: Mapping[str, Outcome]) -> dict[str, Any]:
    """The content of the pictures of a walk: paths, models and maps of its methods, if any."""
    paths, models, maps = {}, {}, {}
    for method, outcome in outcomes.items():
        if method in PATHS:
            paths["truth"] = _rounded(outcome.truth[:, :2])
            paths[method] = _rounded(outcome.poses[:, :2])
            if outcome.model is not None:
                std_m = np.sqrt(outcome.model.variance_m2)
                models[method] = {"centre": outcome.model.centre, "mean_m": outcome.model.mean_m, "std_m": std_m}
        if outcome.grid is not None:
            maps[method] = _picture(outcome.grid, outcome.truth[0])
    return {"paths": paths, "models": models, "maps": maps}


def _rounded(positions_m: Array) -> list:
    return np.round(positions_m, DIGITS).tolist()


def _picture(grid: GridMap, start: Array) -> dict[str, Any]:
    """The cells (free 255, walls 0) as base64 of zlib; the map frame is that of the first true pose."""
    free = 1.0 / (1.0 + np.exp(np.clip(grid.log_odds / LOG_ODDS_SCALE, -LOG_ODDS_MAX, LOG_ODDS_MAX)))
    cells = np.round(255 * free).astype(np.uint8)
    packed = base64.b64encode(zlib.compress(cells.tobytes())).decode("ascii")
    place = {"shape": cells.shape, "resolution_m": grid.resolution_m, "origin_m": grid.origin_m, "start": start}
    return {**place, "cells": packed}


def draw(folder: Path, name: str, twin: str, walk: Mapping[str, Any], kind: Kind | None = None) -> list[Path]:
    """Write pictures NAME-models, NAME-trajectories and NAME-map, if the walk (`content_of`) has the content.

    `twin` names the map. Returns the paths.
    """
    figures = {}
    if walk["models"]:
        figure = new_figure((8, 4), dpi=110)
        axes = figure.add_subplot()
        for cue, model in walk["models"].items():
            centre, mean, std = (np.array(model[key]) for key in ("centre", "mean_m", "std_m"))
            axes.plot(centre, mean, color=PATHS[cue], label=cue)
            axes.fill_between(centre, mean - std, mean + std, color=PATHS[cue], alpha=0.2, lw=0)
        axes.set(xlabel="similarity", ylabel="distance [m], mean and deviation", title=name, ylim=(0, None))
        axes.legend()
        figures["models"] = figure
    if walk["paths"]:
        figure = new_figure((9, 6), dpi=110)
        axes = figure.add_subplot()
        walls_m = _walls_of(twin)
        axes.plot(*walls_m.T, color="0.8", lw=0.8, label="walls")
        for method, path in walk["paths"].items():
            axes.plot(*np.transpose(path), color=PATHS.get(method, "k"), lw=1.2, label=method)
        axes.set(xlabel="x [m]", ylabel="y [m]", title=f"{name}: paths by method, and the building")
        axes.set_aspect("equal", adjustable="datalim")
        legend_below(figure, *axes.get_legend_handles_labels())
        drawn_m = np.concatenate([walls_m, *map(np.array, walk["paths"].values())])
        wide, high = np.nanmax(drawn_m, axis=0) - np.nanmin(drawn_m, axis=0)  # walls are separated by NaN
        fit_height(figure, axes, high / wide, 9.0)
        figures["trajectories"] = figure
    for method, picture in walk["maps"].items():
        figure = new_figure((10, 7), dpi=110)
        axes = figure.add_subplot()
        cells = np.frombuffer(zlib.decompress(base64.b64decode(picture["cells"])), np.uint8).reshape(picture["shape"])
        height, width = np.array(cells.shape) * picture["resolution_m"]
        x, y = picture["origin_m"]
        extent = (x, x + width, y, y + height)
        axes.imshow(cells, cmap="gray", origin="lower", extent=extent, vmin=0, vmax=255)
        axes.plot(*transform_points(inverse(picture["start"]), _walls_of(twin)).T, color="tab:red", lw=0.4)
        axes.set(aspect="equal", xlabel="x from the start [m]", ylabel="y [m]", xlim=extent[:2], ylim=extent[2:])
        axes.set_title(f"{name}: occupancy map of {method} and, red, the true walls")
        figures["map"] = figure
    return [save_picture(figure, folder / f"{name}-{what}", kind) for what, figure in figures.items()]


def _walls_of(twin: str) -> Array:
    """(points, 2) all walls as one line, separated by NaN."""
    walls = load_map(twin).walls_m
    return np.concatenate([walls, np.full((len(walls), 1, 2), np.nan)], axis=1).reshape(-1, 2)
