"""Export of floor plans: native JSON, ROS map_server, or a picture of the cells."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from twc_env.datasets.buildings.ros_map import write_ros_map
from twc_env.errors import MapError
from twc_env.records.messages import GridMap
from twc_env.records.whole_file import whole_file
from twc_env.world.building.floorplan import Floorplan
from twc_env.world.building.floorplan_file import write_floorplan

EXPORT_SUFFIXES = (".json", ".yaml", ".png")
EXPORT_RESOLUTION_M = 0.05
_FREE, _UNKNOWN, _WALL = 255, 205, 0


def export_map(plan: Floorplan, path: str | Path, resolution_m: float = EXPORT_RESOLUTION_M) -> Path:
    """Write a plan in the format of the suffix: .json, .yaml (map_server, with .pgm) or .png (white: free).

    Creates the folder. Only JSON keeps rooms, signs and access points. Raises MapError for other suffixes and on
    failure.
    """
    path = Path(path)
    if path.suffix not in EXPORT_SUFFIXES:
        raise MapError(f"cannot export to {path.name!r}; use a name that ends in {', '.join(EXPORT_SUFFIXES)}")
    if not 0.01 <= resolution_m <= 1.0:
        raise MapError(f"the resolution must be 0.01 to 1 m per pixel; got {resolution_m:g}")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        if path.suffix == ".json":
            write_floorplan(plan, path)
        elif path.suffix == ".yaml":
            write_ros_map(grid_of(plan, resolution_m), path.parent, path.stem)
        else:
            _write_png(plan, path, resolution_m)
    except OSError as error:
        raise MapError(f"cannot write {path}: {error.strerror or error}; choose another place") from error
    return path


def lost_in_export(plan: Floorplan, path: str | Path) -> str:
    """What a file with this suffix does not hold of the plan, and what becomes of it; "" if it holds everything."""
    if Path(path).suffix == ".json":
        return ""
    counts = {"rooms": plan.rooms, "signs": plan.signs, "access points": plan.access_points}
    lost = [f"{len(things)} {name if len(things) > 1 else name[:-1]}" for name, things in counts.items() if things]
    if not lost:
        return ""
    return (
        f"it holds the walls only, as pixels; left out: {', '.join(lost)}; read again, the map gets other signs and "
        "access points, placed by --seed; a .json keeps everything"
    )


def grid_of(plan: Floorplan, resolution_m: float) -> GridMap:
    """The plan as a perfect occupancy grid: free -1, wall 1, unknown 0."""
    cells = plan.cells(resolution_m)
    log_odds = np.zeros(cells.free.shape, np.int16)
    log_odds[cells.free] = -1
    log_odds[cells.wall] = 1
    return GridMap(log_odds, cells.origin_m, resolution_m)


def _write_png(plan: Floorplan, path: Path, resolution_m: float) -> None:
    try:
        from PIL import Image
    except ImportError as error:
        raise MapError("writing a .png needs Pillow; run `pip install 'twc_env[viz]'`, or export a .yaml") from error
    cells = plan.cells(resolution_m)
    shade = np.full(cells.free.shape, _UNKNOWN, np.uint8)
    shade[cells.free] = _FREE
    shade[cells.wall] = _WALL
    with whole_file(path) as beside:
        Image.fromarray(shade[::-1]).save(beside)
