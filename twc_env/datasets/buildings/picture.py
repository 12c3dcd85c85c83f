"""Pictures as maps: white floor, and rooms if a second picture beside it separates them."""

from __future__ import annotations

import dataclasses
import logging
from pathlib import Path

import numpy as np
from numpy.typing import NDArray as Array
from scipy import ndimage

from twc_env.datasets.buildings.furnish import furnish_picture
from twc_env.datasets.buildings.outline import outer_ring, simplified_ring
from twc_env.datasets.buildings.raster import checked_floor, name_marks, parts, plan_from_free, read_grey
from twc_env.errors import MapError
from twc_env.world.building.floorplan import Floorplan, Room
from twc_env.world.building.floorplan_check import validate

PICTURE_RESOLUTION_M = 0.05
"""Default pixel size."""
FREE_ABOVE = 250
"""Pixels brighter than this are free."""
ROOMS_SUFFIX = "_gt_segmentation"
"""`NAME_gt_segmentation.png` beside `NAME.png` is the same floor with rooms separated by dark lines."""
ROOM_MIN_M2 = 1.0
"""Smaller pieces lie between the lines at a door or behind a stray beam."""
_ROOM_FREE_SHARE_MIN = 0.5
_SIMPLIFY_PIXELS = 2.0
_LOG = logging.getLogger(__name__)


def read_picture(path: str | Path, seed: int = 0, resolution_m: float | None = None) -> Floorplan:
    """A .png or .pgm(.gz) picture with white free space; signs and access points are placed by seed.

    A picture without resolution_m has PICTURE_RESOLUTION_M, which is said.
    Rooms come from the picture named with ROOMS_SUFFIX, if it exists. Raises MapError if a picture cannot be read or
    shows no free space, or if the two differ in size.
    """
    path = Path(path)
    free = read_grey(path)[::-1] > FREE_ABOVE
    if resolution_m is None:
        resolution_m = assumed_resolution_m(path.name, free.shape, "`maps import --resolution`")
    floor = checked_floor(free, resolution_m, path.name)
    name_marks(floor, resolution_m, path.name)
    plan = validate(plan_from_free(floor, resolution_m, path.name.split(".")[0]))
    plan = dataclasses.replace(plan, rooms=_rooms_beside(path, plan, free.shape, resolution_m))
    return validate(furnish_picture(plan, seed, resolution_m, np.zeros(3)))


def assumed_resolution_m(where: str, shape: tuple[int, ...], remedy: str) -> float:
    """The scale of a picture of this shape that tells none, with a warning."""
    _LOG.warning(
        "%s: a picture tells no scale; %g m per pixel assumed, %.1f x %.1f m in all; if it is another, use %s",
        where, PICTURE_RESOLUTION_M, *np.array(shape[::-1]) * PICTURE_RESOLUTION_M, remedy,
    )  # fmt: skip
    return PICTURE_RESOLUTION_M


def _rooms_beside(path: Path, plan: Floorplan, shape: tuple[int, ...], resolution_m: float) -> tuple[Room, ...]:
    stem, dot, suffix = path.name.partition(".")
    beside = path.with_name(f"{stem}{ROOMS_SUFFIX}{dot}{suffix}")
    if not beside.is_file():
        return ()
    cut = read_grey(beside)[::-1] > FREE_ABOVE
    if cut.shape != shape:
        raise MapError(
            f"{beside.name} has {cut.shape[1]} x {cut.shape[0]} pixels, {path.name} {shape[1]} x {shape[0]}; "
            "the rooms must be drawn on the same picture"
        )
    return rooms_of(cut, plan, resolution_m)


def rooms_of(cut: Array, plan: Floorplan, resolution_m: float) -> tuple[Room, ...]:
    """Rooms from a picture (rows, columns) of separate pieces, numbered from the top left; pieces off the plan are left
    out."""
    labels, sizes = parts(cut)
    cells, rooms = plan.cells(), []
    for part, box in enumerate(ndimage.find_objects(labels), 1):
        if sizes[part - 1] * resolution_m**2 < ROOM_MIN_M2:
            continue
        low = np.array([box[1].start, box[0].start])
        mask = labels[box] == part
        if cells.is_free((np.argwhere(mask)[:, ::-1] + low + 0.5) * resolution_m).mean() >= _ROOM_FREE_SHARE_MIN:
            ring = simplified_ring(outer_ring(mask), _SIMPLIFY_PIXELS)
            rooms.append((-box[0].stop, box[1].start, (ring + low) * resolution_m))
    rooms.sort(key=lambda room: room[:2])
    return tuple(Room(f"room {number}", corners) for number, (_, _, corners) in enumerate(rooms, 1))
