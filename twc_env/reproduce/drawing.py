"""Shared parts of pictures: their files, and drawing of an occupancy map."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from twc_env.pictures.style import save_figure
from twc_env.running.options import picture_options
from twc_env.slam.scans.occupancy_grid import OccupancyGrid

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Kind = tuple[str, float | None]
"""Format of pictures and dots per inch, as `picture_options` reads them."""


class Pictures(NamedTuple):
    """Where a table draws its parts while it works them out."""

    folder: Path
    kind: Kind


def pictures_of(options: argparse.Namespace) -> Pictures | None:
    """Those that `--out` and `picture_options` say; None without matplotlib."""
    kind = picture_options(options)
    return kind and Pictures(options.out, kind)


def save_picture(figure: Any, place: Path, kind: Kind | None) -> Path:
    """Write a figure in its own resolution or that of `kind`, whose format is added to the place; returns the path."""
    suffix, dpi = kind or ("png", None)
    return save_figure(figure, place.with_name(f"{place.name}.{suffix}"), dpi or figure.dpi)


def draw_grid(axes: Axes, grid: OccupancyGrid) -> None:
    """Draw a grid in metres: walls black, floor white, unknown cells grey."""
    shown = np.where(grid.log_odds > 0, 0.0, np.where(grid.log_odds < 0, 1.0, 0.6))
    (left, low), (right, top) = grid.origin_m, grid.origin_m + np.array(shown.shape[::-1]) * grid.resolution_m
    extent = (left, right, low, top)
    axes.imshow(shown, cmap="gray", vmin=0, vmax=1, origin="lower", extent=extent, interpolation="none")
