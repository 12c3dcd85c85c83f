"""The picture of merged maps: their grid, and the outline of each map in its own colour. Needs matplotlib."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray as Array
from scipy import ndimage

from twc_env.errors import ConfigError, DataError
from twc_env.exploration.drawing.episode_map import draw_smoothly
from twc_env.exploration.drawing.palette import FLOOR, UNKNOWN, WALL, rgb, robot_colour
from twc_env.pictures.style import legend_below, new_figure, save_figure, set_title, settle, style
from twc_env.records.geometry import compose
from twc_env.records.messages import GridMap
from twc_env.slam.saved_maps.saved_map import SavedMap

LONG_SIDE_INCHES = 10.0
GAP_M = 0.3
"""Gaps in what a map knows, up to this width, are inside its outline."""


def draw_merged(grid: GridMap, maps: list[SavedMap], poses: Array, title: str, path: Path) -> None:
    """Write the picture of maps at the poses (n, 3) of their frames. Raises DataError without matplotlib."""
    try:
        with style():
            save_figure(_figure(grid, maps, poses, title), path)
    except ConfigError as error:
        raise DataError(str(error)) from error


def _figure(grid: GridMap, maps: list[SavedMap], poses: Array, title: str) -> Any:
    from matplotlib.lines import Line2D
    from matplotlib.transforms import Affine2D

    size_m = np.array(grid.log_odds.shape[::-1]) * grid.resolution_m
    width, height = np.maximum(LONG_SIDE_INCHES * size_m / size_m.max(), 3.0)
    figure = new_figure((width, height + 0.8))
    axes = figure.add_subplot(facecolor=UNKNOWN)
    draw_smoothly(axes, grid, np.zeros(3), rgb(FLOOR))
    handles = {"mapped walls": Line2D([], [], color=WALL, lw=2.6)}
    for k, (saved, pose) in enumerate(zip(maps, poses, strict=True)):
        x, y, turn = compose(pose, saved.origin)
        place = Affine2D().scale(saved.resolution_m).rotate(turn).translate(x, y) + axes.transData
        axes.contour(_outlined(saved), [0.5], colors=[robot_colour(k)], linewidths=1.6, transform=place)
        handles[saved.name] = Line2D([], [], color=robot_colour(k), lw=1.6)
    (left, low), (right, top) = grid.origin_m, grid.origin_m + size_m
    axes.set(xlim=(left, right), ylim=(low, top), aspect="equal", xlabel="x [m]", ylabel="y [m]")
    set_title(figure, [title])
    legend_below(figure, list(handles.values()), list(handles))
    settle(figure)
    return figure


def _outlined(saved: SavedMap) -> Array:
    """(rows, columns) of what the map knows, with gaps and holes closed."""
    rounds = max(1, round(GAP_M / saved.resolution_m / 2))
    known = np.pad(saved.free | saved.walls, rounds)
    closed = ndimage.binary_fill_holes(ndimage.binary_closing(known, iterations=rounds))
    return np.asarray(closed, float)[rounds:-rounds, rounds:-rounds]
