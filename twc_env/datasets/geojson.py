"""Indoor GeoJSON: floors of the indoor-location-competition-20 and OpenStreetMap buildings, with real place names.

Both are longitudes and latitudes. Of a competition floor, places are closed blocks and what lies between them is
floor; an OpenStreetMap level has rooms and corridors, which meet at doors.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from twc_env.datasets.furnish import place_access_points
from twc_env.datasets.house_expo import fill_ring, interior_point
from twc_env.datasets.outline import simplified_ring
from twc_env.datasets.raster import WALL_LOSS_DB, deepest_cell, largest_part
from twc_env.errors import MapError
from twc_env.random_streams import random_stream
from twc_env.world.floorplan import SIGN_FACE_M, SIGN_FRONT_M, Floorplan, Room, Sign
from twc_env.world.floorplan_check import validate
from twc_env.world.floorplan_file import load_json

Array = NDArray

DRAWING_CLASSES = frozenset({"fuzhumian", "feikaifangquyu", "xishoujianfuzhumian", "kongpu", "zhongkong"})
"""Names that mark how an area is drawn (auxiliary, closed, vacant, void), not what a sign there says."""
SIMPLIFY_M = 0.05
ACCESS_POINT_AREA_M2 = 150.0
_RASTER_M = 0.2
_METRES_PER_DEGREE = 111_320.0
_DOOR_WIDTH_M = 1.0
_DOOR_WIDTHS_M = (0.9, 3.0)
_DOOR_WIDTH_MIN_M = 0.6
_FRAME_M = 0.05
_WALL_THICKNESS_MAX_M = 0.6
"""Two rooms whose outlines are this near share a wall."""
_PLATE_OFFSET_M = 0.3
_EXTENT_MAX_M = 2000.0


@dataclass(frozen=True, slots=True, eq=False)
class _Area:
    """One polygon of the file in metres."""

    name: str
    ring_m: Array
    """(k, 2), not closed, counter-clockwise."""


def read_geojson(path: str | Path, seed: int = 0, level: str = "0") -> Floorplan:
    """One floor of a GeoJSON file (.geojson or .json, also .gz). Place names become signs.

    `level` picks the floor of an OpenStreetMap building. Access points are placed by seed. Raises MapError for files
    that are neither kind, for unknown levels and for floors without free space.
    """
    path = Path(path)
    return geojson_plan(load_json(path), path, seed, level)


def geojson_plan(values: object, path: Path, seed: int = 0, level: str = "0") -> Floorplan:
    """Build a plan from the values of a GeoJSON file at `path`; a competition floor needs floor_info.json beside it."""
    features = values.get("features") if isinstance(values, dict) else None
    if not isinstance(features, list) or not all(isinstance(f, dict) for f in features) or not features:
        raise MapError(f"{path.name} is no GeoJSON FeatureCollection with features; export the floor again")
    name = _plan_name(path)
    if any("tags" in _properties(feature) for feature in features):
        plan = _osm_level(features, path.name, f"{name}-{level}", level)
    else:
        plan = _competition_floor(features, path, name)
    random = random_stream(seed, "furnish")
    area_m2 = plan.cells().free.sum() * plan.cells().resolution_m ** 2
    count = int(max(6, area_m2 / ACCESS_POINT_AREA_M2))
    return validate(dataclasses.replace(plan, access_points=place_access_points(plan, random, count)))


# --- indoor-location-competition-20 -----------------------------------------------------------------------------------


def _competition_floor(features: list[dict], path: Path, name: str) -> Floorplan:
    """Feature 0 is the floor's outline; all other polygons are closed."""
    size_m = _floor_size(path)
    outline = _rings(features[0], path.name)
    if not outline:
        raise MapError(f"{path.name}: feature 0 must be the polygon of the floor; put the outline first")
    low = np.min([ring.min(axis=0) for ring in outline], axis=0)
    extent = np.max([ring.max(axis=0) for ring in outline], axis=0) - low
    if (extent <= 0).any():
        raise MapError(f"{path.name}: the floor's outline has no area; export it again")
    floor = [_metric(ring, low, size_m / extent) for ring in outline]
    blocks = _distinct(
        _Area(_name(feature), _metric(ring, low, size_m / extent))
        for feature in features[1:]
        for ring in _rings(feature, path.name)[:1]
    )
    walls = np.concatenate([_ring_walls(ring) for ring in [*floor, *(block.ring_m for block in blocks)]])
    plan = Floorplan(
        name=name,
        walls_m=walls,
        wall_loss_db=np.full(len(walls), WALL_LOSS_DB / 2),
        interior_m=_point_between(floor, blocks, size_m, path.name)[None],
        rooms=(Room(_name(features[0]) or "FLOOR", floor[0]),),
    )
    named = [block for block in blocks if block.name and block.name not in DRAWING_CLASSES]
    signs = [sign for block in named if (sign := _sign_on(plan, block)) is not None]
    return dataclasses.replace(plan, signs=tuple(signs))


def _floor_size(path: Path) -> Array:
    info_path = path.with_name("floor_info.json")
    if not info_path.is_file():
        raise MapError(f"{path.name} has no floor_info.json beside it, which tells its size; put it there")
    info = load_json(info_path)
    try:
        size = np.array([float(info["map_info"][key]) for key in ("width", "height")])  # type: ignore[index]
    except (KeyError, TypeError, ValueError, OverflowError):
        raise MapError(f"{info_path.name} must hold map_info with width and height in metres; copy it again") from None
    if not ((size > 1) & (size < _EXTENT_MAX_M)).all():
        raise MapError(f"{info_path.name}: width and height must be 1 to {_EXTENT_MAX_M:g} m; got {size.tolist()}")
    return size


def _point_between(floor: list[Array], blocks: list[_Area], size_m: Array, where: str) -> Array:
    """A point deep in the largest part of the floor that no block covers."""
    columns, rows = (np.ceil(size_m / _RASTER_M).astype(int) + 2).tolist()
    free = np.zeros((rows, columns), np.bool_)
    for ring in floor:  # holes of the outline flip back
        fill_ring(np.ascontiguousarray(ring), _RASTER_M, free)
    for block in blocks:
        first = np.clip(np.floor(block.ring_m.min(axis=0) / _RASTER_M).astype(int) - 1, 0, None)
        last = np.clip(np.ceil(block.ring_m.max(axis=0) / _RASTER_M).astype(int) + 1, 0, [columns, rows])
        if (last <= first).any():
            continue
        covered = np.zeros((last[1] - first[1], last[0] - first[0]), np.bool_)
        fill_ring(np.ascontiguousarray(block.ring_m - first * _RASTER_M), _RASTER_M, covered)
        free[first[1] : last[1], first[0] : last[0]] &= ~covered
    part = largest_part(free)
    if not part.any():
        raise MapError(f"{where} leaves no floor between its places; check the outline and floor_info.json")
    row, column = deepest_cell(part)
    return (np.array([column, row]) + 0.5) * _RASTER_M


def _sign_on(plan: Floorplan, block: _Area) -> Sign | None:
    """The block's name on its longest side that faces the floor."""
    ends = np.stack([block.ring_m, np.roll(block.ring_m, -1, axis=0)], axis=1)
    lengths = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
    for i in np.argsort(-lengths):
        if lengths[i] < 0.3:
            break
        along = (ends[i, 1] - ends[i, 0]) / lengths[i]
        sign = _hung(plan, block.name, ends[i].mean(axis=0), np.array([along[1], -along[0]]))
        if sign is not None:
            return sign
    return None


def _distinct(areas: Iterable[_Area]) -> list[_Area]:
    """Coincident polygons once, under the name that one of them has."""
    found: dict[tuple, _Area] = {}
    for area in areas:
        key = tuple(np.round([*area.ring_m.min(axis=0), *area.ring_m.max(axis=0), abs(_area(area.ring_m))], 1).tolist())
        if key not in found or not found[key].name:
            found[key] = area
    return list(found.values())


# --- OpenStreetMap ----------------------------------------------------------------------------------------------------


def _osm_level(features: list[dict], where: str, name: str, level: str) -> Floorplan:
    """Rooms of one level, joined by the doors that are corners of their outlines."""
    parts = [feature for feature in features if _tag(feature, "buildingpart") not in ("", "shell")]
    levels = sorted({lvl for feature in parts for lvl in _levels(feature)})
    chosen = [feature for feature in parts if level in _levels(feature) and _rings(feature, where)]
    if not chosen:
        raise MapError(
            f"{where} has no level {level!r}; levels are {', '.join(levels) or 'not given'}: write FILE#LEVEL"
        )
    rings = [(_tag(feature, "name"), ring) for feature in chosen for ring in _rings(feature, where)[:1]]
    origin = np.mean([ring.mean(axis=0) for _, ring in rings], axis=0)
    scale = _METRES_PER_DEGREE * np.array([np.cos(np.deg2rad(origin[1])), 1.0])
    areas = [_Area(text, _metric(ring, origin, scale)) for text, ring in rings]
    if max(np.abs(area.ring_m).max() for area in areas) > _EXTENT_MAX_M:
        raise MapError(f"{where}: level {level!r} is wider than {_EXTENT_MAX_M:g} m; cut out one building")
    walls = [_ring_walls(area.ring_m) for area in areas]
    plates: list[tuple[str, Array, Array]] = []  # text, (2, 2) either side of the door, normal
    jambs = []
    for feature in features:
        if _tag(feature, "door"):
            place = _metric(_point(feature, where)[None], origin, scale)[0]
            jambs += _open_door(areas, walls, place, _width_m(feature), plates)
    table = np.concatenate([*walls, np.array(jambs).reshape(-1, 2, 2)])
    # Every room seeds the floor; then only what hangs together is kept.
    seeds = np.array([interior_point(area.ring_m, where) for area in areas])
    plan = Floorplan(name, table, np.full(len(table), WALL_LOSS_DB / 2), interior_m=seeds)
    cells = plan.cells()
    row, column = deepest_cell(largest_part(cells.free))
    plan = dataclasses.replace(
        plan, interior_m=(cells.origin_m + (np.array([column, row]) + 0.5) * cells.resolution_m)[None]
    )
    reached = plan.cells().is_free(seeds)
    rooms = [Room(area.name or f"ROOM {i + 1}", area.ring_m) for i, area in enumerate(areas) if reached[i]]
    tries = [[_hung(plan, text, at, normal) for at in sides] for text, sides, normal in plates]
    signs = [sign for both in tries for sign in [s for s in both if s is not None][:1]]
    return dataclasses.replace(plan, rooms=tuple(rooms), signs=tuple(signs))


def _open_door(
    areas: list[_Area], walls: list[Array], place: Array, width_m: float, plates: list[tuple[str, Array, Array]]
) -> list[Array]:
    """Cut a door into the room whose outline has it as a corner and into the room behind; returns the two jambs."""
    corner_gaps = [np.linalg.norm(area.ring_m - place, axis=1).min() for area in areas]
    room = int(np.argmin(corner_gaps))
    if corner_gaps[room] > 0.05:
        return []
    gaps = [np.inf if i == room else _nearest(_sides(area.ring_m), place)[1] for i, area in enumerate(areas)]
    behind = int(np.argmin(gaps))
    if gaps[behind] > _WALL_THICKNESS_MAX_M:
        return []
    side, _ = _nearest(_sides(areas[behind].ring_m), place)
    begin, end = _sides(areas[behind].ring_m)[side]
    length_m = float(np.linalg.norm(end - begin))
    along = (end - begin) / length_m
    at = float((place - begin) @ along)
    low, high = _straight_stretch(_sides(areas[room].ring_m), place, begin, along)
    first = max(at - width_m / 2, _FRAME_M, low + _FRAME_M)
    last = min(at + width_m / 2, length_m - _FRAME_M, high - _FRAME_M)
    if last - first < _DOOR_WIDTH_MIN_M:
        return []
    across = (place - begin) - at * along
    for number in (room, behind):
        walls[number] = _cut(walls[number], begin, along, first, last)
    into_behind = np.array([-along[1], along[0]])  # outlines run counter-clockwise
    for number, normal, other in ((room, into_behind, behind), (behind, -into_behind, room)):
        base = begin if other == behind else begin + across
        text = areas[number].name
        if text:
            offsets = np.array([last + _PLATE_OFFSET_M, first - _PLATE_OFFSET_M])
            plates.append((text, base + offsets[:, None] * along, normal))
    frame = _FRAME_M * into_behind  # outlines are straight to a centimetre or two; a frame leaves no gap
    return [np.stack([begin + s * along + frame, begin + s * along + across - frame]) for s in (first, last)]


def _straight_stretch(sides: Array, place: Array, begin: Array, along: Array) -> tuple[float, float]:
    """From where to where a room's outline runs straight through a place, in metres along a line."""
    normal = np.array([-along[1], along[0]])
    is_straight = (np.abs((sides - place) @ normal) < 0.1).all(axis=1)
    spans = np.sort((sides[is_straight] - begin) @ along, axis=1)
    at = float((place - begin) @ along)
    low = high = at
    for _ in spans:
        touching = (spans[:, 0] <= high + 0.02) & (spans[:, 1] >= low - 0.02)
        if touching.any():
            low, high = min(low, float(spans[touching, 0].min())), max(high, float(spans[touching, 1].max()))
    return low, high


def _cut(walls: Array, begin: Array, along: Array, first: float, last: float) -> Array:
    """Walls (w, 2, 2) without what lies between first and last along a line, close to it."""
    normal = np.array([-along[1], along[0]])
    pieces = []
    for a, b in walls:
        sa, sb = float((a - begin) @ along), float((b - begin) @ along)
        far = max(abs(float((a - begin) @ normal)), abs(float((b - begin) @ normal)))
        if far > _WALL_THICKNESS_MAX_M or max(sa, sb) <= first or min(sa, sb) >= last or abs(sb - sa) < 1e-9:
            pieces.append((a, b))
            continue
        for s0, s1 in ((min(sa, sb), first), (last, max(sa, sb))):
            if s1 - s0 > 1e-3:
                pieces.append((a + (s0 - sa) / (sb - sa) * (b - a), a + (s1 - sa) / (sb - sa) * (b - a)))
    return np.array(pieces).reshape(-1, 2, 2)


def _nearest(sides: Array, place: Array) -> tuple[int, float]:
    """Number and distance of the side (k, 2, 2) nearest to a place."""
    a, e = sides[:, 0], sides[:, 1] - sides[:, 0]
    t = np.clip(((place - a) * e).sum(axis=1) / np.maximum((e * e).sum(axis=1), 1e-12), 0, 1)
    gaps = np.linalg.norm(place - a - t[:, None] * e, axis=1)
    return int(np.argmin(gaps)), float(gaps.min())


# --- both -------------------------------------------------------------------------------------------------------------


def _hung(plan: Floorplan, text: str, at: Array, normal: Array) -> Sign | None:
    """A sign there, if open floor lies before it."""
    front = at + SIGN_FRONT_M * normal
    if not plan.cells().is_free(np.stack([front, at + 2 * SIGN_FRONT_M * normal])).all():
        return None
    face = at + SIGN_FACE_M * normal
    if plan.wall_index.crossing(front, face[None])[0][0] or plan.wall_index.distance_m(at[None], 0.3)[0] >= 0.1:
        return None
    return Sign(text, at, float(np.arctan2(normal[1], normal[0])))


def _metric(lonlat: Array, origin: Array, scale: Array) -> Array:
    return (lonlat - origin) * scale


def _sides(ring: Array) -> Array:
    return np.stack([ring, np.roll(ring, -1, axis=0)], axis=1)


def _ring_walls(ring: Array) -> Array:
    sides = _sides(simplified_ring(ring, SIMPLIFY_M))
    return sides[np.linalg.norm(sides[:, 1] - sides[:, 0], axis=1) > 1e-3]


def _area(ring: Array) -> float:
    """Positive when the ring runs counter-clockwise."""
    x, y = ring.T
    return float((x * np.roll(y, -1) - np.roll(x, -1) * y).sum() / 2)


def _properties(feature: dict) -> dict:
    properties = feature.get("properties")
    return properties if isinstance(properties, dict) else {}


def _name(feature: dict) -> str:
    name = _properties(feature).get("name")
    return name.strip() if isinstance(name, str) else ""


def _tag(feature: dict, key: str) -> str:
    tags = _properties(feature).get("tags")
    value = tags.get(key, "") if isinstance(tags, dict) else ""
    return value.strip() if isinstance(value, str) else ""


def _levels(feature: dict) -> list[str]:
    relations = _properties(feature).get("relations")
    tables = [r.get("reltags") for r in relations if isinstance(r, dict)] if isinstance(relations, list) else []
    return [t["level"] for t in tables if isinstance(t, dict) and isinstance(t.get("level"), str)]


def _width_m(feature: dict) -> float:
    try:
        width_m = float(_tag(feature, "width").removesuffix("m"))
    except ValueError:
        width_m = _DOOR_WIDTH_M
    return float(np.clip(width_m, *_DOOR_WIDTHS_M)) if np.isfinite(width_m) else _DOOR_WIDTH_M


def _rings(feature: dict, where: str) -> list[Array]:
    """Rings (k, 2) [degrees] of a polygon feature, the outer first, each counter-clockwise; [] for other shapes."""
    geometry = feature.get("geometry")
    kind = geometry.get("type") if isinstance(geometry, dict) else None
    if not isinstance(geometry, dict) or kind not in ("Polygon", "MultiPolygon"):
        return []
    try:
        polygons = [geometry["coordinates"]] if kind == "Polygon" else list(geometry["coordinates"])
        rings = [np.array(ring, dtype=float) for polygon in polygons for ring in polygon]
        if any(ring.ndim != 2 or ring.shape[1] < 2 or len(ring) < 4 for ring in rings):
            raise ValueError
        rings = [ring[:-1, :2] for ring in rings]
        if any(not (np.abs(ring) <= 360).all() for ring in rings):
            raise ValueError
    except (KeyError, TypeError, ValueError, OverflowError):
        raise MapError(f"{where}: a {kind} must hold closed rings of [longitude, latitude]; export it again") from None
    return [ring if _area(ring) > 0 else ring[::-1] for ring in rings]


def _point(feature: dict, where: str) -> Array:
    try:
        point = np.array(feature["geometry"]["coordinates"][:2], dtype=float)
        if point.shape != (2,) or not (np.abs(point) <= 360).all():
            raise ValueError
    except (KeyError, TypeError, ValueError, OverflowError):
        raise MapError(f"{where}: a door must be a Point [longitude, latitude]; export it again") from None
    return point


def _plan_name(path: Path) -> str:
    stem = path.name.split(".")[0]
    return path.parent.name if stem == "geojson_map" and path.parent.name else stem
