"""Shared parts of pictures: figures in the style of all pictures, their files, and drawing of an occupancy map."""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from twc_env.errors import DataError
from twc_env.pictures.style import new_figure as new_canvas
from twc_env.pictures.style import save_figure
from twc_env.slam.scans.occupancy_grid import OccupancyGrid

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Kind = tuple[str, float | None]
"""Format of pictures and dots per inch, as `picture_options` reads them."""


def can_draw() -> bool:
    """Whether matplotlib is installed, for pictures that are optional."""
    return find_spec("matplotlib") is not None


def new_figure(width: float, height: float, dpi: int = 100) -> Any:
    """A figure of this size [inches]. Raises DataError without matplotlib."""
    if not can_draw():
        raise DataError("pictures need matplotlib; run `pip install 'twc_env[viz]'`")
    return new_canvas((width, height), dpi)


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
