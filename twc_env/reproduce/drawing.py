"""Shared parts of pictures: a figure without a window, and drawing of an occupancy map."""

from __future__ import annotations

from importlib.util import find_spec
from typing import TYPE_CHECKING

import numpy as np

from twc_env.errors import DataError
from twc_env.slam.scans.occupancy_grid import OccupancyGrid

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


def can_draw() -> bool:
    """Whether matplotlib is installed, for pictures that are optional."""
    return find_spec("matplotlib") is not None


def new_figure(width: float, height: float, dpi: int = 100) -> Figure:
    """A figure of this size [inches]. Raises DataError without matplotlib."""
    if not can_draw():
        raise DataError("pictures need matplotlib; run `pip install 'twc_env[viz]'`")
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), dpi=dpi, layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def draw_grid(axes: Axes, grid: OccupancyGrid) -> None:
    """Draw a grid in metres: walls black, floor white, unknown cells grey."""
    shown = np.where(grid.log_odds > 0, 0.0, np.where(grid.log_odds < 0, 1.0, 0.6))
    (left, low), (right, top) = grid.origin_m, grid.origin_m + np.array(shown.shape[::-1]) * grid.resolution_m
    extent = (left, right, low, top)
    axes.imshow(shown, cmap="gray", vmin=0, vmax=1, origin="lower", extent=extent, interpolation="none")
