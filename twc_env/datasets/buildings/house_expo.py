"""HouseExpo plans (Li et al., 2019): one JSON per flat, the contour of its free space traced from a 1 cm raster.

The free space is the inside of one contour; walls are notches about 0.1 m thick. Contours may touch themselves, and
boxes of rooms may be misplaced.
"""

from __future__ import annotations

import dataclasses
import logging
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.datasets.buildings.furnish import furnish
from twc_env.datasets.buildings.outline import sides_of, simplified_ring
from twc_env.datasets.buildings.raster import WALL_LOSS_DB, deepest_cell, largest_part, name_left_out
from twc_env.errors import UNFIT, MapError
from twc_env.kernels.compiled import kernel
from twc_env.world.building.floor_cells import CELLS_MAX, Cells
from twc_env.world.building.floorplan import Floorplan, Room
from twc_env.world.building.floorplan_check import COORDINATE_MAX_M, validate
from twc_env.world.building.floorplan_file import load_json

SIMPLIFY_M = 0.01
"""Tolerance of the simplified contour: the pixel size of its raster."""
ROOM_FREE_SHARE_MIN = 0.3
"""A box with a smaller share of free space is misplaced and left out."""
_FILL_RESOLUTION_M = 0.05
_LOG = logging.getLogger(__name__)


def read_house_expo(path: str | Path) -> Floorplan:
    """Read one HouseExpo JSON file, see `house_expo_plan`."""
    path = Path(path)
    return house_expo_plan(load_json(path), path.name)


def house_expo_plan(values: object, where: str, seed: int = 0) -> Floorplan:
    """Build a plan from the values of a HouseExpo file; `where` names the file in errors.

    Signs and access points are placed by seed. Raises MapError if the values are not of the format, or enclose no
    floor.
    """
    if not isinstance(values, dict):
        raise MapError(f"{where} must be a JSON object with 'verts'; got {type(values).__name__}")
    contour = simplified_ring(_contour(values, where), SIMPLIFY_M)
    walls = sides_of(contour)
    inside = interior_point([contour], where, is_named=True)
    if inside is None:
        raise MapError(f"{where} has no free space inside its contour; verts must go around the floor")
    name, losses_db = str(values.get("id", Path(where).stem)), np.full(len(walls), WALL_LOSS_DB / 2)
    plan = validate(Floorplan(name=name, walls_m=walls, wall_loss_db=losses_db, interior_m=inside[None]))
    rooms = _rooms(values.get("room_category", {}), plan.cells(), where)
    return validate(furnish(dataclasses.replace(plan, rooms=rooms), seed))


def _contour(values: dict, where: str) -> Array:
    try:
        contour = np.array(values["verts"], dtype=float)
        if any(isinstance(number, (bool, str)) for corner in values["verts"] for number in corner):
            raise ValueError  # numpy takes true for 1.0
    except KeyError:
        raise MapError(f"{where} lacks the key 'verts', the contour of a HouseExpo plan; add it") from None
    except UNFIT:
        contour = np.zeros(0)
    if contour.ndim != 2 or contour.shape[1] != 2 or len(contour) < 3:
        raise MapError(f"{where}: verts must be three or more corners [x, y]; got {str(values['verts'])[:60]}")
    if not np.isfinite(contour).all():
        raise MapError(f"{where}: verts holds a value that is not finite (NaN or infinity); give plain numbers")
    if np.abs(contour).max() > COORDINATE_MAX_M:
        raise MapError(f"{where}: verts reach {np.abs(contour).max():.3g} m from the origin; verts must be metres")
    return contour


def interior_point(rings: Sequence[Array], where: str, is_named: bool = False) -> Array | None:
    """(2,) a point deep inside the largest part of the first ring (k, 2) [m] without the other rings, its holes.

    The rings may touch themselves; is_named: other parts are named in a warning. None if nothing is inside.
    """
    low = rings[0].min(axis=0) - _FILL_RESOLUTION_M
    columns, rows = (np.ceil((rings[0].max(axis=0) - low) / _FILL_RESOLUTION_M).astype(int) + 2).tolist()
    if rows * columns > CELLS_MAX:
        size = f"{columns * _FILL_RESOLUTION_M:.0f} x {rows * _FILL_RESOLUTION_M:.0f} m"
        raise MapError(f"{where}: an outline spans {size}, too large for one building; lengths must be metres")
    inside = np.zeros((rows, columns), np.bool_)
    for ring in rings:  # filling a hole clears it
        fill_ring(np.ascontiguousarray(ring - low), _FILL_RESOLUTION_M, inside)
    why = "the contour touches itself, and nothing leads there"
    place = deep_point(inside, _FILL_RESOLUTION_M, where, why if is_named else "")
    return None if place is None else low + place


def deep_point(inside: Array, resolution_m: float, where: str, why: str, what: str = "of floor") -> Array | None:
    """(2,) a point [m] deep inside the largest part of the cells (rows, columns); None if there is none. why: other
    parts are left out, for a warning that calls them `what`; "": without one."""
    part = largest_part(inside)
    if not part.any():
        return None
    if why:
        all_m2, kept_m2 = (float(each.sum()) * resolution_m**2 for each in (inside, part))
        name_left_out(where, all_m2 - kept_m2, all_m2, why, what)
    row, column = deepest_cell(part)
    return (np.array([column, row]) + 0.5) * resolution_m


def _rooms(categories: object, cells: Cells, where: str) -> tuple[Room, ...]:
    """Rooms of the labelled boxes that lie on free space; a box with several labels is one room."""
    if not isinstance(categories, dict):
        raise MapError(f"{where}: room_category must map labels to boxes; got {type(categories).__name__}")
    labels: dict[tuple[float, ...], list[str]] = {}
    for label, boxes in categories.items():
        for box in _boxes(boxes, f"{where}: room_category[{label!r}]"):
            labels.setdefault(box, []).append(str(label))
    rooms = []
    for (x1, y1, x2, y2), names in labels.items():
        if _free_share(cells, x1, y1, x2, y2) >= ROOM_FREE_SHARE_MIN:
            corners = np.array([(x1, y1), (x2, y1), (x2, y2), (x1, y2)])
            rooms.append(Room(" / ".join(name.replace("_", " ") for name in names), corners))
    if len(rooms) < len(labels):
        _LOG.info(
            "%s: %d of %d labelled boxes left out: they lie off the floor", where, len(labels) - len(rooms), len(labels)
        )
    return tuple(rooms)


def _boxes(boxes: object, where: str) -> list[tuple[float, ...]]:
    try:
        table = np.array(boxes, dtype=float)
        if table.ndim == 2 and any(isinstance(n, (bool, str)) for box in boxes for n in box):  # type: ignore[attr-defined]
            raise ValueError
        if table.size and (table.ndim != 2 or table.shape[1] != 4 or not np.isfinite(table).all()):
            raise ValueError
    except UNFIT:
        raise MapError(f"{where} must be a list of boxes [x1, y1, x2, y2] in metres; got {str(boxes)[:60]}") from None
    return [tuple(row) for row in table.reshape(-1, 4).tolist()]


def _free_share(cells: Cells, x1: float, y1: float, x2: float, y2: float) -> float:
    x1, x2, y1, y2 = min(x1, x2), max(x1, x2), min(y1, y2), max(y1, y2)
    size_m = np.array(cells.free.shape[::-1]) * cells.resolution_m
    if x2 - x1 > 2 * size_m[0] or y2 - y1 > 2 * size_m[1]:
        return 0.0  # more than half of it lies outside the plan
    points = np.stack(np.meshgrid(np.arange(x1 + 0.05, x2, 0.1), np.arange(y1 + 0.05, y2, 0.1)), axis=-1)
    return float(cells.is_free(points).mean()) if points.size else 0.0


@kernel
def fill_ring(ring, resolution, inside):
    """Invert the cells whose centre lies inside the ring (k, 2): each edge inverts the cells to its right."""
    rows, columns = inside.shape
    for k in range(ring.shape[0]):
        x1, y1 = ring[k - 1, 0], ring[k - 1, 1]
        x2, y2 = ring[k, 0], ring[k, 1]
        if y1 > y2:
            x1, y1, x2, y2 = x2, y2, x1, y1
        for r in range(max(int(np.ceil(y1 / resolution - 0.5)), 0), rows):
            y = (r + 0.5) * resolution
            if y >= y2:
                break
            x = x1 + (x2 - x1) * (y - y1) / (y2 - y1)
            for c in range(max(int(np.ceil(x / resolution - 0.5)), 0), columns):
                inside[r, c] = not inside[r, c]
