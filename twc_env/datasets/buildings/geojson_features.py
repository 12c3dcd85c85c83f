"""Features of a GeoJSON file: names, tags, and rings of longitudes and latitudes as areas in metres."""

from __future__ import annotations

import logging
import re
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.datasets.buildings.outline import sides_of, simplified_ring, without_repeats
from twc_env.errors import UNFIT, MapError

SIMPLIFY_M = 0.05
EXTENT_MAX_M = 2000.0
"""Maximum extent of one floor."""
_DOOR_WIDTH_M = 1.0
_DOOR_WIDTHS_M = (0.9, 3.0)
_DEGREES = ("CRS84", ":4326")
"""Last parts of the names of WGS 84 in degrees."""
_NUMBER_MAX = 1e15
"""Greater numbers are no level, width or name."""
_NO_FLOOR = ("shell", "wall", "door", "yes", "no")
"""Tags of outlines and openings, which are not floor."""
_LEVEL = r"[+-]?\d+(?:\.\d+)?"
_LEVEL_RANGE = re.compile(rf"({_LEVEL})\s*-\s*({_LEVEL})")
_LEVELS_MAX = 200
"""Storeys of the highest building."""
_WIDTH = re.compile(r"""(\d+(?:[.,]\d+)?)\s*(mm|cm|m|ft|in|'|")?""")
_WIDTH_UNIT_M = {"mm": 0.001, "cm": 0.01, "m": 1.0, "ft": 0.3048, "'": 0.3048, "in": 0.0254, '"': 0.0254}
_NO = ("", "no")
_LOG = logging.getLogger(__name__)
_REMEDY = "export it in longitude and latitude (WGS 84, EPSG:4326)"


@dataclass(frozen=True, slots=True, eq=False)
class Area:
    """One polygon of the file in metres."""

    name: str
    ring_m: Array
    """(k, 2), not closed, counter-clockwise."""
    holes_m: tuple[Array, ...] = ()
    """Holes, clockwise."""
    is_open: bool = False
    """Whether it has no walls of its own."""


def walls_of(ring: Array) -> Array:
    """(j, 2, 2) ends of the walls along a ring (k, 2), straightened to `SIMPLIFY_M`."""
    sides = sides_of(simplified_ring(ring, SIMPLIFY_M))
    return sides[np.linalg.norm(sides[:, 1] - sides[:, 0], axis=1) > 1e-3]


def signed_area_m2(ring: Array) -> float:
    """Area of a ring (k, 2), positive if it is counter-clockwise."""
    (x, y), (after_x, after_y) = ring.T, np.concatenate([ring[1:], ring[:1]]).T
    return float((x * after_y - after_x * y).sum() / 2)


def distinct(areas: Iterable[Area]) -> list[Area]:
    """Areas without duplicates; of coincident ones a named one is kept."""
    found: dict[tuple, Area] = {}
    for area in areas:
        key = tuple(
            np.round([*area.ring_m.min(axis=0), *area.ring_m.max(axis=0), abs(signed_area_m2(area.ring_m))], 1).tolist()
        )
        if key not in found or not found[key].name:
            found[key] = area
    return list(found.values())


def properties_of(feature: dict) -> dict:
    """The properties of a feature, or an empty dictionary."""
    properties = feature.get("properties")
    return properties if isinstance(properties, dict) else {}


def name_of(feature: dict) -> str:
    """The name in the properties, or ""."""
    name = properties_of(feature).get("name")
    return name.strip() if isinstance(name, str) else ""


def tag_of(feature: dict, key: str) -> str:
    """An OpenStreetMap tag, from `tags` or from the properties themselves, or ""."""
    own = properties_of(feature)
    tags = own.get("tags")
    value = (tags if isinstance(tags, dict) else own).get(key, "")
    if isinstance(value, (int, float)) and not isinstance(value, bool):
        return f"{value:g}" if abs(value) < _NUMBER_MAX else ""
    return value.strip() if isinstance(value, str) else ""


def part_of(feature: dict) -> str:
    """The kind of building part of an OpenStreetMap feature, in either tagging scheme, or ""."""
    kind = tag_of(feature, "buildingpart") or tag_of(feature, "indoor")
    return kind if kind not in _NO_FLOOR else ""


def is_open(feature: dict) -> bool:
    """Whether a part has no walls of its own, only those of the rooms beside it: indoor=area or corridor."""
    return tag_of(feature, "indoor") in ("area", "corridor")


def is_door(feature: dict) -> bool:
    """Whether a point or line is a door in one of the taggings in use."""
    geometry = feature.get("geometry")
    if isinstance(geometry, dict) and geometry.get("type") in ("Polygon", "MultiPolygon"):
        return False  # a room that has doors
    if tag_of(feature, "door") == "no":
        return False
    return tag_of(feature, "indoor") == "door" or any(tag_of(feature, key) not in _NO for key in ("door", "entrance"))


def levels_of(feature: dict) -> list[str]:
    """The levels of an OpenStreetMap feature: those of its relations, or its own, as in "0;1", "0-2" or ["0", "1"]."""
    relations = properties_of(feature).get("relations")
    tables = [r.get("reltags") for r in relations if isinstance(r, dict)] if isinstance(relations, list) else []
    related = [t["level"] for t in tables if isinstance(t, dict) and isinstance(t.get("level"), str)]
    return list(dict.fromkeys(level for text in related or _level_texts(feature) for level in _levels(text)))


def _level_texts(feature: dict) -> list[str]:
    own = properties_of(feature)
    tags = own.get("tags")
    value = (tags if isinstance(tags, dict) else own).get("level")
    if isinstance(value, list):
        return [f"{item}" for item in value if isinstance(item, (str, int, float)) and not isinstance(item, bool)]
    return [tag_of(feature, "level")]


def _levels(text: str) -> list[str]:
    """The levels of a list of single ones and ranges, with one spelling for each."""
    found = []
    for part in re.split("[;,]", text):
        if ends := _LEVEL_RANGE.fullmatch(part.strip()):
            first, last = float(ends[1][:9]), float(ends[2][:9])
            count = int(min(last - first, _LEVELS_MAX)) + 1 if last >= first else 0
            found += [f"{first + k:g}" for k in range(count)]
        elif part.strip():
            found.append(f"{float(part):g}" if re.fullmatch(_LEVEL, part.strip()[:9]) else part.strip())
    return found


def width_m_of(feature: dict, where: str, named: set[str]) -> float:
    """Width of a door, as tagged or by default, within plausible limits; a width that is not taken as it is, is said
    once, and added to `named`."""
    text = tag_of(feature, "width")
    told = _WIDTH.fullmatch(text.lower())
    if told is None:
        taken_m, remedy = _DOOR_WIDTH_M, "write metres as '1.5'"
        is_taken = not text
    else:
        width_m = float(told[1].replace(",", ".")) * _WIDTH_UNIT_M[told[2] or "m"]
        taken_m = float(np.clip(width_m, *_DOOR_WIDTHS_M))
        low_m, high_m = _DOOR_WIDTHS_M
        remedy = f"widths are {low_m:g} to {high_m:g} m, in metres if no unit is given"
        is_taken = taken_m == width_m
    if not is_taken and text[:40] not in named:
        named.add(text[:40])
        _LOG.warning("%s: doors of width %r are taken as %g m wide; %s", where, text[:40], taken_m, remedy)
    return taken_m


def lines_of(feature: dict, where: str) -> list[Array]:
    """Lines of a feature, each (k, 2) [degrees]: those of a line, or the rings of a polygon; [] for points.

    Raises MapError, which names `where`, for coordinates that are no longitude and latitude.
    """
    geometry = feature.get("geometry")
    if not isinstance(geometry, dict) or geometry.get("type") not in ("LineString", "MultiLineString"):
        return [np.concatenate([ring, ring[:1]]) for rings in polygons_of(feature, where) for ring in rings]
    try:
        parts = geometry["coordinates"] if geometry["type"] == "MultiLineString" else [geometry["coordinates"]]
        lines = [np.array(part, dtype=float)[:, :2] for part in parts]
        if not all(line.shape[1] == 2 and len(line) > 1 and np.isfinite(line).all() for line in lines):
            raise ValueError
    except (LookupError, *UNFIT):
        raise MapError(f"{where}: a line must hold two or more [longitude, latitude]; export it again") from None
    for line in lines:
        _check_degrees(line, where)
    return lines


def polygons_of(feature: dict, where: str) -> list[list[Array]]:
    """Polygons of a feature, each as its rings (k, 2) [degrees]; [] for other shapes.

    The outer ring comes first, counter-clockwise; the others are holes, clockwise. A line that ends where it begins is
    a polygon, as exports of OpenStreetMap have them. Rings of fewer than three corners are left out, with their holes.
    Raises MapError, which names `where`, for coordinates that are no longitude and latitude.
    """
    geometry = feature.get("geometry")
    kind = geometry.get("type") if isinstance(geometry, dict) else None
    if not isinstance(geometry, dict) or not (kind in ("Polygon", "MultiPolygon") or _is_closed_line(geometry)):
        return []
    try:
        drawn = geometry["coordinates"]
        polygons = list(drawn) if kind == "MultiPolygon" else [[drawn] if kind == "LineString" else drawn]
        rings = [[np.array(ring, dtype=float) for ring in polygon] for polygon in polygons]
        if not all(_is_ring(ring) for polygon in rings for ring in polygon):
            raise ValueError
    except (KeyError, *UNFIT):
        raise MapError(f"{where}: a {kind} must hold closed rings of [longitude, latitude]; export it again") from None
    opened = [[_opened(ring, k == 0, where) for k, ring in enumerate(polygon)] for polygon in rings]
    return [[ring for ring in polygon if len(ring) > 2] for polygon in opened if polygon and len(polygon[0]) > 2]


def _is_closed_line(geometry: dict) -> bool:
    line = geometry.get("coordinates")
    is_line = geometry.get("type") == "LineString" and isinstance(line, list)
    return is_line and len(line) >= 4 and line[0] == line[-1]  # type: ignore[arg-type, index]


def _is_ring(values: Array) -> bool:
    return values.ndim == 2 and values.shape[1] >= 2 and len(values) >= 4 and bool(np.isfinite(values).all())


def _opened(ring: Array, is_outer: bool, where: str) -> Array:
    """Corners (k, 2) of a ring without the repeated first one, in the required direction."""
    is_closed = np.array_equal(ring[0, :2], ring[-1, :2])
    ring = without_repeats(ring[: -1 if is_closed else len(ring), :2])
    _check_degrees(ring, where)
    return ring if (signed_area_m2(ring) > 0) == is_outer else ring[::-1]


def point_of(feature: dict, where: str) -> Array:
    """(2,) longitude and latitude [degrees] of a door; the middle of one drawn as a line. MapError if it has none."""
    geometry = feature.get("geometry")
    if isinstance(geometry, dict) and geometry.get("type") == "LineString":
        line = lines_of(feature, where)[0]
        return (line[0] + line[-1]) / 2
    try:
        point = np.array(feature["geometry"]["coordinates"][:2], dtype=float)
        if point.shape != (2,):
            raise ValueError
    except (KeyError, *UNFIT):
        raise MapError(
            f"{where}: a door must be a Point [longitude, latitude] or a LineString; export it again"
        ) from None
    _check_degrees(point[None], where)
    return point


def check_reference(values: dict, where: str) -> None:
    """Raise MapError if the `crs` of a file (first version of the format only) is not WGS 84 in degrees."""
    crs = values.get("crs")
    if crs is None:
        return
    table = crs.get("properties") if isinstance(crs, dict) else None
    name = str(table.get("name") if isinstance(table, dict) else crs)
    if not name.upper().endswith(_DEGREES):
        raise MapError(f"{where} is drawn in {name[:60]}; {_REMEDY}")


def _check_degrees(places: Array, where: str) -> None:
    """Raise MapError if points (k, 2) cannot be longitudes and latitudes."""
    is_odd = ~(np.abs(places) <= (180.0, 90.0)).all(axis=1)
    if is_odd.any():
        x, y = places[is_odd][0]
        raise MapError(f"{where}: [{x:.9g}, {y:.9g}] is not a longitude and latitude in degrees; {_REMEDY}")
