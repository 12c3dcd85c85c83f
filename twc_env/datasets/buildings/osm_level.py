"""A level of an OpenStreetMap building: rooms and corridors connected by doors."""

from __future__ import annotations

import dataclasses
import logging

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.datasets.buildings.furnish import hung_sign
from twc_env.datasets.buildings.geojson_features import (
    EXTENT_MAX_M,
    Area,
    distinct,
    is_door,
    is_open,
    levels_of,
    lines_of,
    part_of,
    point_of,
    polygons_of,
    tag_of,
    walls_of,
    width_m_of,
)
from twc_env.datasets.buildings.house_expo import interior_point
from twc_env.datasets.buildings.outline import sides_of
from twc_env.datasets.buildings.raster import WALL_LOSS_DB, deepest_cell, largest_part, name_left_out
from twc_env.errors import MapError
from twc_env.world.building.floorplan import Floorplan, Room

_EQUATOR_M, _SQUARED_ECCENTRICITY = 6_378_137.0, 0.006694379990
"""Semi-major axis and squared eccentricity of the ellipsoid of WGS 84."""
_DOOR_WIDTH_MIN_M = 0.6
_FRAME_M = 0.05
_WALL_THICKNESS_MAX_M = 0.6
"""Rooms whose outlines are at most this far apart share a wall."""
_PLATE_OFFSET_M = 0.3
_SHARED_M, _PARALLEL = 0.1, 0.05
"""Sides of areas this near and (sine) this parallel are one border."""
ROOMS_MAX, DOORS_MAX = 600, 1200
"""Of one level; the largest real one in `docs/real_data.md` has 34 rooms."""
_NEIGHBOURS_MAX, PAIRS_MAX = 50, 6000
"""Outlines around one door, and pairs of areas without walls that touch: rooms do not lie upon one another."""
_LOG = logging.getLogger(__name__)


def osm_level(features: list[dict], where: str, name: str, level: str | None = None) -> Floorplan:
    """The floor plan of one level, by default "0" or the only one, on which rooms without a level are too.

    Doors lie on the outlines of rooms. Areas and corridors have no walls between them. What no door leads to, doors
    that open no wall and rooms that are no polygon are left out, with a warning. Raises MapError if there are no rooms
    or no such level, or if its rooms span too much or have no area.
    """
    parts = [(number, feature) for number, feature in enumerate(features) if part_of(feature)]
    if not parts:
        raise MapError(f"{where} has no rooms: polygons tagged indoor=room or buildingpart=room; export these too")
    levels = sorted({lvl for _, feature in parts for lvl in levels_of(feature)})
    usual = levels[0] if len(levels) == 1 else "0"
    if level is None:
        level = usual
    name = f"{name}-{level}"
    level = f"{float(level):g}" if level not in levels and _is_number(level) else level
    own = [(number, feature) for number, feature in parts if level in (levels_of(feature) or (usual,))]
    if len(own) > ROOMS_MAX:
        raise MapError(f"{where}: level {level!r} has {len(own)} rooms, {ROOMS_MAX} are possible; cut out one building")
    drawn_as = [(feature, polygons_of(feature, f"{where}: feature {number}")) for number, feature in own]
    polygons = [(tag_of(feature, "name"), is_open(feature), rings) for feature, of in drawn_as for rings in of]
    _name_guesses(sum(not of for _, of in drawn_as), parts, where, usual if levels else "")
    if not polygons:
        raise MapError(f"{where} has no level {level!r}; levels are {', '.join(levels) or '0'}: write FILE#LEVEL")
    origin = np.mean([rings[0].mean(axis=0) for *_, rings in polygons], axis=0)
    scale = metres_per_degree(origin[1])
    drawn = distinct(
        Area(text, *_in_metres(rings, origin, scale), is_open=is_without_walls)
        for text, is_without_walls, rings in polygons
    )
    if max(np.abs(area.ring_m).max() for area in drawn) > EXTENT_MAX_M:
        raise MapError(
            f"{where}: level {level!r} is wider than {EXTENT_MAX_M:g} m; cut out one building, or, "
            "if its numbers are metres, export it in longitude and latitude (WGS 84, EPSG:4326)"
        )
    inside = [(area, interior_point([area.ring_m, *area.holes_m], where)) for area in drawn]
    areas, seeds = [area for area, seed in inside if seed is not None], [seed for _, seed in inside if seed is not None]
    if not areas:
        raise MapError(f"{where}: the rooms of level {level!r} have no area; export it again")
    outlines = [Area(area.name, ring, is_open=area.is_open) for area in areas for ring in (area.ring_m, *area.holes_m)]
    boxes = np.array([[*outline.ring_m.min(axis=0), *outline.ring_m.max(axis=0)] for outline in outlines])
    upon_one_another = f"{where}: many rooms of level {level!r} lie upon one another; draw each once"
    pairs = _open_pairs(outlines, boxes)
    if len(pairs) > PAIRS_MAX:
        raise MapError(upon_one_another)
    walls = _without_open_borders([walls_of(outline.ring_m) for outline in outlines], outlines, boxes, pairs)
    walls.append(_drawn_walls(features, where, level, origin, scale))
    plates: list[tuple[str, Array, Array]] = []  # text, (2, 2) either side of the door, normal
    jambs = []
    opened: set[tuple[float, ...]] = set()
    named: set[str] = set()
    unopened = 0
    for number, feature in enumerate(features):
        if is_door(feature) and level in (levels_of(feature) or [level]):
            place = (point_of(feature, f"{where}: feature {number}") - origin) * scale
            if (key := tuple(np.round(place, 2).tolist())) in opened:
                continue
            opened.add(key)
            if len(opened) > DOORS_MAX:
                raise MapError(f"{where}: level {level!r} has more than {DOORS_MAX} doors; cut out one building")
            reach_m = 2 * _WALL_THICKNESS_MAX_M
            is_near = (boxes[:, :2] <= place + reach_m).all(axis=1) & (boxes[:, 2:] >= place - reach_m).all(axis=1)
            near = np.flatnonzero(is_near).tolist()
            if len(near) > _NEIGHBOURS_MAX:
                raise MapError(upon_one_another)
            made = _open_door(
                [outlines[k] for k in near], near, walls, place, width_m_of(feature, where, named), plates
            )
            jambs += made
            unopened += not made
    if unopened:
        _LOG.warning(
            "%s: %d of %d doors stay closed: they lead outside, lie further than %g m from the walls, or have less "
            "than %g m of straight wall", where, unopened, len(opened), _WALL_THICKNESS_MAX_M, _DOOR_WIDTH_MIN_M,
        )  # fmt: skip
    table = np.concatenate([*walls, np.array(jambs).reshape(-1, 2, 2)])
    # First all rooms are interior points, then only the largest connected part is kept.
    losses_db = np.full(len(table), WALL_LOSS_DB / 2)
    losses_db[len(table) - len(jambs) - len(walls[-1]) : len(table) - len(jambs)] = WALL_LOSS_DB
    plan = Floorplan(name, table, losses_db, interior_m=np.array(seeds))
    cells = plan.cells()
    kept = largest_part(cells.free)
    inside_m = cells.centre_of(np.array([deepest_cell(kept)]))
    all_m2, kept_m2 = (part.sum() * cells.resolution_m**2 for part in (cells.free, kept))
    why = "no door leads there; add points tagged door=yes on the walls"
    name_left_out(where, all_m2 - kept_m2, all_m2, why)
    plan = dataclasses.replace(plan, interior_m=inside_m)
    reached = plan.cells().is_free(np.array(seeds))
    rooms = [Room(area.name or f"ROOM {i + 1}", area.ring_m) for i, area in enumerate(areas) if reached[i]]
    tries = [[hung_sign(plan, text, at, normal) for at in sides] for text, sides, normal in plates]
    signs = [sign for both in tries for sign in [s for s in both if s is not None][:1]]
    return dataclasses.replace(plan, rooms=tuple(rooms), signs=tuple(signs))


def _name_guesses(odd: int, parts: list[tuple[int, dict]], where: str, usual: str) -> None:
    """Warn of so many parts that are no polygon, and of those whose level is assumed ("": none has any)."""
    if odd:
        _LOG.warning("%s: %d rooms left out: their outlines are not closed; draw them as polygons", where, odd)
    if usual and (assumed := sum(not levels_of(feature) for _, feature in parts)):
        _LOG.warning("%s: %d rooms tell no level and are taken to be on %s; tag them", where, assumed, usual)


def _is_number(text: str) -> bool:
    try:
        return bool(np.isfinite(float(text)))
    except ValueError:
        return False


def _drawn_walls(features: list[dict], where: str, level: str, origin: Array, scale: Array) -> Array:
    """(w, 2, 2) the walls of the level that are drawn as such."""
    pieces = [np.zeros((0, 2, 2))]
    for number, feature in enumerate(features):
        if tag_of(feature, "indoor") == "wall" and level in (levels_of(feature) or [level]):
            for line in lines_of(feature, f"{where}: feature {number}"):
                places = (line - origin) * scale
                pieces.append(np.stack([places[:-1], places[1:]], axis=1))
    walls = np.concatenate(pieces)
    return walls[np.linalg.norm(walls[:, 1] - walls[:, 0], axis=1) > 1e-3]


def _open_pairs(outlines: list[Area], boxes: Array) -> Array:
    """(p, 2) numbers of outlines without walls of their own whose boxes touch, in both orders."""
    numbers = np.flatnonzero([outline.is_open for outline in outlines])
    low, high = boxes[numbers, :2] - _SHARED_M, boxes[numbers, 2:] + _SHARED_M
    touch = ((low[:, None] <= high) & (high[:, None] >= low)).all(axis=2) & ~np.eye(len(numbers), dtype=bool)
    return numbers[np.argwhere(touch)]


def _without_open_borders(walls: list[Array], outlines: list[Area], boxes: Array, pairs: Array) -> list[Array]:
    """The walls (w, 2, 2) of each outline, without those between two areas that have no walls of their own."""
    out = list(walls)
    for k, other in pairs.tolist():
        sides = sides_of(outlines[other].ring_m)
        is_near = (sides.min(axis=1) <= boxes[k, 2:] + _SHARED_M) & (sides.max(axis=1) >= boxes[k, :2] - _SHARED_M)
        for begin, end in sides[is_near.all(axis=1)]:
            out[k] = _without_border(out[k], begin, end)
    return out


def _without_border(walls: Array, begin: Array, end: Array) -> Array:
    """Walls (w, 2, 2) without the parts that run along a side."""
    length = float(np.linalg.norm(end - begin))
    if length < 1e-9 or not len(walls):
        return walls
    along = (end - begin) / length
    normal = np.array([-along[1], along[0]])
    ways = walls[:, 1] - walls[:, 0]
    is_beside = (np.abs((walls - begin) @ normal) < _SHARED_M).all(axis=1)
    if not is_beside.any():
        return walls
    is_beside &= np.abs(ways @ normal) < _PARALLEL * np.linalg.norm(ways, axis=1)
    return np.concatenate([walls[~is_beside], _cut(walls[is_beside], begin, along, 0.0, length)])


def metres_per_degree(latitude_deg: float) -> Array:
    """(2,) lengths [m] of a degree of longitude and of one of latitude, on the ellipsoid of WGS 84.

    On a sphere with the radius of the equator a degree of latitude would be up to 0.7 % too long.
    """
    latitude = np.deg2rad(latitude_deg)
    shrunk = 1.0 - _SQUARED_ECCENTRICITY * np.sin(latitude) ** 2
    across_m, along_m = _EQUATOR_M / np.sqrt(shrunk), _EQUATOR_M * (1.0 - _SQUARED_ECCENTRICITY) / shrunk**1.5
    return np.deg2rad(1.0) * np.array([across_m * np.cos(latitude), along_m])


def _in_metres(rings: list[Array], origin: Array, scale: Array) -> tuple[Array, tuple[Array, ...]]:
    """The outer ring, and the holes."""
    outer, *holes = ((ring - origin) * scale for ring in rings)
    return outer, tuple(holes)


def _open_door(
    areas: list[Area],
    numbers: list[int],
    walls: list[Array],
    place: Array,
    width_m: float,
    plates: list[tuple[str, Array, Array]],
) -> list[Array]:
    """Cut a door into the outline it lies on, best as a corner, and into the one behind; returns the two jambs.

    areas: the outlines near the door, and their numbers in walls, the last of which are walls drawn as such. A hole of
    a room is a separate outline with the opposite direction.
    """
    if not areas:
        return []
    corner_gaps: list[float] = [np.linalg.norm(area.ring_m - place, axis=1).min() for area in areas]
    room = int(np.argmin(corner_gaps))
    if corner_gaps[room] > 0.05:  # a door within a side, or within the thickness of the wall
        found = [_nearest(sides_of(area.ring_m), place) for area in areas]
        room = int(np.argmin([gap for _, gap in found]))
        if found[room][1] > _WALL_THICKNESS_MAX_M:
            return []
        side_begin, side_end = sides_of(areas[room].ring_m)[found[room][0]]
        place = _foot(side_begin, side_end, place)
    gaps = [np.inf if i == room else _nearest(sides_of(area.ring_m), place)[1] for i, area in enumerate(areas)]
    behind = int(np.argmin(gaps))
    if gaps[behind] > _WALL_THICKNESS_MAX_M:
        return []
    side, _ = _nearest(sides_of(areas[behind].ring_m), place)
    begin, end = sides_of(areas[behind].ring_m)[side]
    along = (end - begin) / np.linalg.norm(end - begin)
    at = float((place - begin) @ along)
    across = (place - begin) - at * along
    # Both outlines may have further corners on the straight segment around the door, such as the door itself.
    ends = [
        _straight_stretch(sides_of(areas[number].ring_m), at_wall, begin, along)
        for number, at_wall in ((room, place), (behind, place - across))
    ]
    first = max(at - width_m / 2, max(low for low, _ in ends) + _FRAME_M)
    last = min(at + width_m / 2, min(high for _, high in ends) - _FRAME_M)
    if last - first < _DOOR_WIDTH_MIN_M:
        return []
    for number in (numbers[room], numbers[behind], len(walls) - 1):
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
    """Start and end of the straight part of an outline through a point, in metres along a line."""
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
    """Walls (w, 2, 2) without the parts near a line between first and last along it."""
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


def _foot(begin: Array, end: Array, place: Array) -> Array:
    """The point of a side nearest to a place."""
    way = end - begin
    return begin + np.clip((place - begin) @ way / max(way @ way, 1e-12), 0.0, 1.0) * way


def _nearest(sides: Array, place: Array) -> tuple[int, float]:
    """Number and distance of the side (k, 2, 2) nearest to a place."""
    a, e = sides[:, 0], sides[:, 1] - sides[:, 0]
    t = np.clip(((place - a) * e).sum(axis=1) / np.maximum((e * e).sum(axis=1), 1e-12), 0, 1)
    gaps = np.linalg.norm(place - a - t[:, None] * e, axis=1)
    return int(np.argmin(gaps)), float(gaps.min())
