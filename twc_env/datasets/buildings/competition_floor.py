"""A floor of the indoor-location-competition-20: places are closed blocks, and the area between them is floor."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.datasets.buildings.furnish import hung_sign
from twc_env.datasets.buildings.geojson_features import EXTENT_MAX_M, Area, distinct, name_of, polygons_of, walls_of
from twc_env.datasets.buildings.house_expo import deep_point, fill_ring
from twc_env.datasets.buildings.outline import sides_of
from twc_env.datasets.buildings.raster import WALL_LOSS_DB
from twc_env.errors import UNFIT, MapError
from twc_env.world.building.floor_cells import CELLS_MAX
from twc_env.world.building.floorplan import Floorplan, Room, Sign
from twc_env.world.building.floorplan_file import load_json

DRAWING_CLASSES = frozenset({"fuzhumian", "feikaifangquyu", "xishoujianfuzhumian", "kongpu", "zhongkong"})
"""Names of drawing classes (auxiliary, closed, vacant, void), which are not texts of signs."""
_RASTER_M = 0.2


def competition_floor(features: list[dict], path: Path, name: str) -> Floorplan:
    """The floor plan: feature 0 is the outline of the floor, all other polygons are closed blocks.

    path: the .geojson, beside which floor_info.json tells the size [m]. Raises MapError for an outline without area,
    and for coordinates that are none.
    """
    size_m = _floor_size(path)
    outline = [ring for polygon in polygons_of(features[0], f"{path.name}: feature 0") for ring in polygon]
    if not outline:
        raise MapError(f"{path.name}: feature 0 must be the polygon of the floor; put the outline first")
    low = np.min([ring.min(axis=0) for ring in outline], axis=0)
    extent = np.max([ring.max(axis=0) for ring in outline], axis=0) - low
    if (extent <= 0).any():
        raise MapError(f"{path.name}: the floor's outline has no area; export it again")
    scale = size_m / extent  # metres per degree
    floor = [(ring - low) * scale for ring in outline]
    blocks = distinct(
        Area(name_of(feature), (rings[0] - low) * scale)
        for number, feature in enumerate(features[1:], 1)
        for rings in polygons_of(feature, f"{path.name}: feature {number}")
    )
    walls = np.concatenate([walls_of(ring) for ring in [*floor, *(block.ring_m for block in blocks)]])
    plan = Floorplan(
        name=name,
        walls_m=walls,
        wall_loss_db=np.full(len(walls), WALL_LOSS_DB / 2),
        interior_m=_point_between(floor, blocks, size_m, path.name)[None],
        rooms=(Room(name_of(features[0]) or "FLOOR", floor[0]),),
    )
    named = [block for block in blocks if block.name and block.name not in DRAWING_CLASSES]
    signs = [sign for block in named if (sign := _sign_on(plan, block)) is not None]
    return dataclasses.replace(plan, signs=tuple(signs))


def _floor_size(path: Path) -> Array:
    info_path = path.with_name("floor_info.json")
    if not info_path.is_file():
        raise MapError(
            f"{path.name} has no OpenStreetMap tags (indoor or buildingpart=room), and no floor_info.json beside it, "
            "which tells the size of a floor of the competition: put it there"
        )
    info = load_json(info_path)
    try:
        size = np.array([float(info["map_info"][key]) for key in ("width", "height")])  # type: ignore[index]
    except (KeyError, *UNFIT):
        raise MapError(f"{info_path.name} must hold map_info with width and height in metres; copy it again") from None
    if not ((size > 1) & (size < EXTENT_MAX_M)).all():
        raise MapError(f"{info_path.name}: width and height must be 1 to {EXTENT_MAX_M:g} m; got {size.tolist()}")
    return size


def _point_between(floor: list[Array], blocks: list[Area], size_m: Array, where: str) -> Array:
    """A point deep in the largest part of the floor that no block covers."""
    columns, rows = (np.ceil(size_m / _RASTER_M).astype(int) + 2).tolist()
    if rows * columns > CELLS_MAX:
        raise MapError(f"{where}: a floor of {size_m[0]:g} x {size_m[1]:g} m is too large; check floor_info.json")
    free = np.zeros((rows, columns), np.bool_)
    for ring in floor:  # filling a hole clears it
        fill_ring(np.ascontiguousarray(ring), _RASTER_M, free)
    for block in blocks:
        first = np.clip(np.floor(block.ring_m.min(axis=0) / _RASTER_M).astype(int) - 1, 0, None)
        last = np.clip(np.ceil(block.ring_m.max(axis=0) / _RASTER_M).astype(int) + 1, 0, [columns, rows])
        if (last <= first).any():
            continue
        covered = np.zeros((last[1] - first[1], last[0] - first[0]), np.bool_)
        fill_ring(np.ascontiguousarray(block.ring_m - first * _RASTER_M), _RASTER_M, covered)
        free[first[1] : last[1], first[0] : last[0]] &= ~covered
    place = deep_point(free, _RASTER_M, where, "they are closed in by places", "between its places")
    if place is None:
        raise MapError(f"{where} leaves no floor between its places; check the outline and floor_info.json")
    return place


def _sign_on(plan: Floorplan, block: Area) -> Sign | None:
    """A sign with the name of the block, on its longest side that faces the floor."""
    ends = sides_of(block.ring_m)
    lengths = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
    for i in np.argsort(-lengths):
        if lengths[i] < 0.3:
            break
        along = (ends[i, 1] - ends[i, 0]) / lengths[i]
        sign = hung_sign(plan, block.name, ends[i].mean(axis=0), np.array([along[1], -along[0]]))
        if sign is not None:
            return sign
    return None
