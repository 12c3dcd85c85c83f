"""Any map file as an occupancy grid: free, occupied and unknown cells, as it was saved."""

from __future__ import annotations

import dataclasses
import logging
from pathlib import Path

import numpy as np
from scipy import ndimage

from twc_env.datasets.buildings.picture import FREE_ABOVE, assumed_resolution_m
from twc_env.datasets.buildings.raster import read_grey
from twc_env.datasets.buildings.ros_map import RosMap, read_ros_cells
from twc_env.errors import MapError
from twc_env.world.building.floorplan import Floorplan

_UNKNOWN_GREY = 205
"""What map_saver paints where it knows nothing; drawn plans have other greys in and behind their walls."""
_WALLS_MIN = 0.1
"""A map_server map in which a smaller share of the floor's rim is occupied draws no walls, only where floor ends."""
_LOG = logging.getLogger(__name__)


def read_grid(path: str | Path, resolution_m: float | None = None) -> RosMap:
    """The grid of a map_server yaml, or of a .png or .pgm picture at `resolution_m` per pixel (None: said and assumed).

    In a picture white is free, the grey of map_saver unknown, and the rim of all else beside free floor a wall.
    Raises MapError if the file cannot be read or shows no free floor.
    """
    path = Path(path)
    suffixes = [suffix.lower() for suffix in path.suffixes if suffix.lower() != ".gz"]
    if suffixes[-1:] in ([".yaml"], [".yml"]):
        grid = _with_walls(read_ros_cells(path), path)
    else:
        grey = read_grey(path)[::-1]
        free = grey > FREE_ABOVE
        resolution_m = resolution_m or assumed_resolution_m(path.name, free.shape, "--resolution")
        grid = RosMap(free, ~free & (grey != _UNKNOWN_GREY) & _rim(free), resolution_m, np.zeros(3))
    if not grid.free.any():
        raise MapError(f"{path.name} shows no free floor; check the thresholds, or that floor is white")
    return grid


def _with_walls(grid: RosMap, path: Path) -> RosMap:
    """The grid; where it draws hardly a wall, the rim of its free floor becomes one."""
    rim = _rim(grid.free) & ~grid.free
    if not rim.any() or (grid.occupied & rim).sum() >= _WALLS_MIN * rim.sum():
        return grid
    _LOG.warning(
        "%s: only %.0f %% of the rim of its floor is occupied; all of it is taken for walls: check occupied_thresh",
        path.name, 100 * (grid.occupied & rim).sum() / rim.sum(),
    )  # fmt: skip
    return dataclasses.replace(grid, occupied=grid.occupied | rim)


def grid_of_plan(plan: Floorplan) -> RosMap:
    """The grid of a floor plan, all of it known."""
    cells = plan.cells()
    free = np.asarray(cells.free)
    return RosMap(free, ~free & _rim(free), cells.resolution_m, np.array([*cells.origin_m, 0.0]))


def _rim(free: np.ndarray) -> np.ndarray:
    return np.asarray(ndimage.binary_dilation(free, np.ones((3, 3))))
