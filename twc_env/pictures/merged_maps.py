"""The picture of merged maps: their grid, and the outline of each map in its own colour. Needs matplotlib."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray as Array
from scipy import ndimage

from twc_env.pictures.style import new_figure
from twc_env.records.geometry import compose
from twc_env.records.messages import GridMap
from twc_env.records.whole_file import whole_file
from twc_env.reproduce.drawing import draw_grid
from twc_env.slam.saved_maps.saved_map import SavedMap

LONG_SIDE_INCHES = 10.0
GAP_M = 0.3
"""Gaps in what a map knows, up to this width, are inside its outline."""


def draw_merged(grid: GridMap, maps: list[SavedMap], poses: Array, title: str, path: Path) -> None:
    """Write the picture of maps at the poses (n, 3) of their frames."""
    from matplotlib import colormaps
    from matplotlib.transforms import Affine2D

    size_m = np.array(grid.log_odds.shape[::-1]) * grid.resolution_m
    width, height = np.maximum(LONG_SIDE_INCHES * size_m / size_m.max(), 3.0)
    figure = new_figure((width, height + 0.8), 110)
    axes = figure.add_subplot()
    draw_grid(axes, grid)  # type: ignore[arg-type]
    for k, (saved, pose) in enumerate(zip(maps, poses, strict=True)):
        colour = colormaps["tab10"](k % 10)
        x, y, turn = compose(pose, saved.origin)
        place = Affine2D().scale(saved.resolution_m).rotate(turn).translate(x, y) + axes.transData
        axes.contour(_outlined(saved), [0.5], colors=[colour], linewidths=2.0, transform=place)
        axes.plot([], [], color=colour, lw=2.0, label=saved.name)
    (left, low), (right, top) = grid.origin_m, grid.origin_m + size_m
    axes.set(xlim=(left, right), ylim=(low, top), aspect="equal", xlabel="x [m]", ylabel="y [m]")
    axes.set_title(title, parse_math=False, fontsize=10)
    figure.legend(loc="outside lower center", ncols=min(len(maps), 4), fontsize=8, frameon=False)
    with whole_file(path) as beside:
        figure.savefig(beside)


def _outlined(saved: SavedMap) -> Array:
    """(rows, columns) of what the map knows, with gaps and holes closed."""
    rounds = max(1, round(GAP_M / saved.resolution_m / 2))
    known = np.pad(saved.free | saved.walls, rounds)
    closed = ndimage.binary_fill_holes(ndimage.binary_closing(known, iterations=rounds))
    return np.asarray(closed, float)[rounds:-rounds, rounds:-rounds]
