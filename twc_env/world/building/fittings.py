"""Completion of a drawing to a floor plan: doors, walls, room names, signs, furniture and access points."""

from __future__ import annotations

import itertools
from collections import defaultdict
from dataclasses import dataclass

import numpy as np

from twc_env.errors import MapError
from twc_env.records.geometry import farthest_first
from twc_env.world.building.drawing import FURNITURE_DB, INNER_DB, ROOM_MIN, Drawing, Edge, Tile
from twc_env.world.building.floorplan import AccessPoint, Floorplan, Room, local_macs

_PLATE_OFFSET, _CONNECTION_OFFSET = 3, 6
"""Distance [dm] of a room's sign from its door, and of doors between rooms from the corner."""


def finish(
    drawing: Drawing, name: str, random: np.random.Generator, access_points: int | None = None, macs: int | None = None
) -> Floorplan:
    """The floor plan of a drawing with `access_points` boxes and `macs` addresses (default: by floor area)."""
    edges = _edges(drawing.tiles)
    at_tile: dict[int, list[Edge]] = defaultdict(list)
    for edge in edges:
        for tile in (edge.low, edge.high):
            at_tile[tile].append(edge)
    doors = _place_doors(drawing, at_tile, random)
    _name_rooms(drawing, doors)
    _furnish_rooms(drawing, doors, at_tile)
    _hang_signs(drawing, edges, random)
    _draw_walls(drawing, edges)
    table = np.array(drawing.walls)
    start = max((t for t in drawing.tiles if t.use == "open"), key=lambda t: (t.x1 - t.x0) * (t.y1 - t.y0))
    return Floorplan(
        name=name,
        walls_m=table[:, :4].reshape(-1, 2, 2) / 10,
        wall_loss_db=table[:, 4],
        rooms=tuple(drawing.rooms),
        signs=tuple(drawing.signs),
        access_points=_access_points(drawing, random, access_points, macs),
        interior_m=np.array([[start.x0 + 5.5, start.y0 + 5.5]]) / 10,  # 0.55 m from the walls, clear of obstacles
    )


def _edges(tiles: list[Tile]) -> list[Edge]:
    """All common edges of two tiles, or of a tile and the outside."""
    sides: dict[tuple[int, int], tuple[list, list]] = defaultdict(lambda: ([], []))
    for number, tile in enumerate(tiles):
        sides[0, tile.x1][0].append((tile.y0, tile.y1, number))
        sides[0, tile.x0][1].append((tile.y0, tile.y1, number))
        sides[1, tile.y1][0].append((tile.x0, tile.x1, number))
        sides[1, tile.y0][1].append((tile.x0, tile.x1, number))
    edges = []
    for (axis, line), (lows, highs) in sorted(sides.items()):
        lows, highs = sorted(lows), sorted(highs)
        cuts = sorted({value for begin, end, _ in lows + highs for value in (begin, end)})
        for begin, end in itertools.pairwise(cuts):
            low, high = _tile_at(lows, begin), _tile_at(highs, begin)
            if low >= 0 or high >= 0:
                edges.append(Edge(axis, line, begin, end, low, high))
    return edges


def _tile_at(spans: list[tuple[int, int, int]], begin: int) -> int:
    return next((number for first, last, number in spans if first <= begin < last), -1)


def _place_doors(drawing: Drawing, at_tile: dict, random: np.random.Generator) -> dict[int, tuple[Edge, int]]:
    """Add a door to every room, to open floor if possible; (edge, begin) of each room's own door.

    Raises MapError if a room cannot be reached.
    """
    tiles, style = drawing.tiles, drawing.style
    doors: dict[int, tuple[Edge, int]] = {}
    waiting = [number for number, tile in enumerate(tiles) if tile.use == "room"]
    reached = {number for number, tile in enumerate(tiles) if tile.use == "open"}
    while waiting:
        late = []
        for number in waiting:
            ways = [e for e in at_tile[number] if e.other(number) in reached and e.length >= style.door + 4]
            if not ways:
                late.append(number)
                continue
            edge = max(ways, key=lambda e: (tiles[e.other(number)].use == "open", e.length))
            begin = edge.begin + min(style.door_offset, (edge.length - style.door) // 2)
            doors[number] = (edge, begin)
            drawing.doors[edge.axis, edge.line].append((begin, begin + style.door))
            if edge.length >= style.two_doors_from:
                last = edge.end - style.door_offset
                drawing.doors[edge.axis, edge.line].append((last - style.door, last))
        reached |= set(waiting) - set(late)
        if len(late) == len(waiting):
            raise MapError(f"{len(late)} rooms touch no open floor; use another seed")
        waiting = late
    _connect_neighbours(drawing, at_tile, doors, random)
    return doors


def _connect_neighbours(drawing: Drawing, at_tile: dict, doors: dict, random: np.random.Generator) -> None:
    """Add doors between adjacent rooms, at least one: they close loops in the paths of robots."""
    style, pairs = drawing.style, []
    if not style.connecting_share:
        return
    for number, (way, _) in doors.items():
        for edge in at_tile[number]:
            other = edge.high
            if edge.low != number or other not in doors or edge.axis == way.axis:
                continue
            theirs = doors[other][0]
            if (theirs.axis, theirs.line) == (way.axis, way.line) and edge.length >= ROOM_MIN:
                pairs.append((edge, way.line))
    if not pairs:
        return
    chosen = random.random(len(pairs)) < style.connecting_share
    chosen[int(random.integers(len(pairs)))] = True
    for (edge, line), is_chosen in zip(pairs, chosen, strict=True):
        if is_chosen:
            begin = edge.begin + _CONNECTION_OFFSET if line == edge.begin else edge.end - _CONNECTION_OFFSET - 10
            drawing.doors[edge.axis, edge.line].append((begin, begin + 10))


def _name_rooms(drawing: Drawing, doors: dict[int, tuple[Edge, int]]) -> None:
    """Name rooms and open floors; rooms get a sign beside the door."""
    rooms = opens = 0
    for number, tile in enumerate(drawing.tiles):
        if tile.use == "void":
            continue
        corners = np.array([(tile.x0, tile.y0), (tile.x1, tile.y0), (tile.x1, tile.y1), (tile.x0, tile.y1)]) / 10
        if tile.use == "open":
            opens += 1
            drawing.rooms.append(Room(f"{drawing.style.floor_name} {opens}", corners))
            continue
        name = drawing.style.label(rooms)
        rooms += 1
        drawing.rooms.append(Room(name, corners))
        edge, begin = doors[number]
        if drawing.tiles[edge.other(number)].use != "open":
            continue
        for along in (begin + drawing.style.door + _PLATE_OFFSET, begin - _PLATE_OFFSET):
            if edge.begin + 1 <= along <= edge.end - 1:
                drawing.hang(name, edge.point_m(along), edge.facing_rad(edge.other(number)))
                break


def _furnish_rooms(drawing: Drawing, doors: dict[int, tuple[Edge, int]], at_tile: dict) -> None:
    """Add furniture, washroom and repeated sign at the same position in every room."""
    style = drawing.style
    for number, (edge, _) in doors.items():
        tile = drawing.tiles[number]
        room = _Corner(tile, edge, into=1 if edge.high == number else -1)
        is_alike = (edge.begin, edge.end) == room.span
        if style.furniture[0] and min(room.depth, room.width) >= ROOM_MIN and is_alike:
            room.enclose(drawing, (room.depth - style.furniture[0], room.depth), style.furniture[1], FURNITURE_DB)
        if style.washrooms and room.width >= 38 and room.depth >= 44 and is_alike:
            room.enclose(drawing, (0, 16), 16, INNER_DB, door=9)
        if number % 2 == 0 and is_alike:
            far = edge.line + room.into * room.depth
            wall = next((e for e in at_tile[number] if e.axis == edge.axis and e.line == far), None)
            if wall is not None and drawing.is_clear(wall, edge.begin + 5):
                drawing.hang(style.repeated, wall.point_m(edge.begin + 5), wall.facing_rad(number))


@dataclass(frozen=True, slots=True)
class _Corner:
    """The corner of a room, in coordinates of the wall with its door: width along the wall, depth away from it."""

    tile: Tile
    edge: Edge
    into: int

    @property
    def span(self) -> tuple[int, int]:
        tile = self.tile
        return (tile.y0, tile.y1) if self.edge.axis == 0 else (tile.x0, tile.x1)

    @property
    def width(self) -> int:
        return self.span[1] - self.span[0]

    @property
    def depth(self) -> int:
        tile = self.tile
        return tile.x1 - tile.x0 if self.edge.axis == 0 else tile.y1 - tile.y0

    def enclose(self, drawing: Drawing, depths: tuple[int, int], width: int, loss_db: float, door: int = 0) -> None:
        """Add the walls that, with those of the room, enclose the corner at the end of the span between two depths."""
        begin, end = self.span[1] - width, self.span[1]
        along_from = self.edge.line + self.into * depths[0]
        along_to = self.edge.line + self.into * depths[1]
        inner = along_from if depths[0] else along_to
        self._wall(drawing, (inner, begin), (inner, end), loss_db)
        low, high = sorted((along_from, along_to))
        if door:
            gap = (low + high - door) // 2
            self._wall(drawing, (low, begin), (gap, begin), loss_db)
            self._wall(drawing, (gap + door, begin), (high, begin), loss_db)
        else:
            self._wall(drawing, (low, begin), (high, begin), loss_db)

    def _wall(self, drawing: Drawing, a: tuple[int, int], b: tuple[int, int], loss_db: float) -> None:
        (ax, ay), (bx, by) = (a, b) if self.edge.axis == 0 else (a[::-1], b[::-1])
        drawing.walls.append((ax, ay, bx, by, loss_db))


def _hang_signs(drawing: Drawing, edges: list[Edge], random: np.random.Generator) -> None:
    """Add the signs of `Style.along_floor` to corridors: one of each per 24 m of wall, the second also at ends."""
    tiles = drawing.tiles
    places = []
    for edge in edges:
        for number in (edge.low, edge.high):
            other = edge.other(number)
            is_wall = number >= 0 and tiles[number].use == "open" and (other < 0 or tiles[other].use != "open")
            if not is_wall or edge.length < 8:
                continue
            tile = tiles[number]
            across = tile.y1 - tile.y0 if edge.axis == 0 else tile.x1 - tile.x0
            if other < 0 and across == edge.length < 100:
                drawing.hang(
                    drawing.style.along_floor[1], edge.point_m((edge.begin + edge.end) / 2), edge.facing_rad(number)
                )
                continue
            steps = range(edge.begin + 5, edge.end - 3, 40) if edge.length > 12 else [(edge.begin + edge.end) / 2]
            places += [(edge, number, along) for along in steps]
    texts = drawing.style.along_floor * max(2, len(places) // 6)
    spots = iter([places[i] for i in random.permutation(len(places))])
    for text in texts:
        for edge, number, along in spots:
            if drawing.is_clear(edge, along):
                drawing.hang(text, edge.point_m(along), edge.facing_rad(number))
                break


def _draw_walls(drawing: Drawing, edges: list[Edge]) -> None:
    """Add walls on all edges except between open tiles, merged along straight lines and cut by doors."""
    runs: dict[tuple[int, int, float], list[list[int]]] = defaultdict(list)
    for edge in edges:
        uses = {drawing.tiles[number].use if number >= 0 else "outside" for number in (edge.low, edge.high)}
        if uses == {"open"}:
            continue
        style = drawing.style
        loss_db = style.outer_db if "outside" in uses else style.void_db if "void" in uses else INNER_DB
        row = runs[edge.axis, edge.line, loss_db]
        if row and row[-1][1] == edge.begin:
            row[-1][1] = edge.end
        else:
            row.append([edge.begin, edge.end])
    for (axis, line, loss_db), row in runs.items():
        gaps = sorted(drawing.doors[axis, line])
        for begin, end in row:
            for first, last in [*gaps, (end, end)]:
                if first >= end or (last > begin and first < end):
                    piece = (begin, min(first, end))
                    if piece[1] > piece[0]:
                        a, b = (
                            ((line, piece[0]), (line, piece[1])) if axis == 0 else ((piece[0], line), (piece[1], line))
                        )
                        drawing.walls.append((*a, *b, loss_db))
                    begin = max(begin, last)
                    if first >= end:
                        break


def _access_points(
    drawing: Drawing, random: np.random.Generator, count: int | None, macs: int | None
) -> tuple[AccessPoint, ...]:
    """Access points at candidate positions in the tiles, chosen by farthest point sampling."""
    pool = []
    for tile in (tile for tile in drawing.tiles if tile.use in drawing.style.access_points_in):
        columns, rows = max(1, (tile.x1 - tile.x0) // 30), max(1, (tile.y1 - tile.y0) // 30)
        xs = tile.x0 + (np.arange(columns) + 0.5) * (tile.x1 - tile.x0) / columns
        ys = tile.y0 + (np.arange(rows) + 0.5) * (tile.y1 - tile.y0) / rows
        pool.append(np.stack(np.meshgrid(xs, ys), axis=-1).reshape(-1, 2) / 10)
    points = np.concatenate(pool)
    area_m2 = sum((t.x1 - t.x0) * (t.y1 - t.y0) for t in drawing.tiles) / 100
    count = count or (max(6, round(area_m2 / 25)) if area_m2 <= 1000 else 40 + round((area_m2 - 1000) / 100))
    chosen = farthest_first(points, count, int(random.integers(len(points))))
    places = np.round(points[chosen] + random.uniform(-0.6, 0.6, (len(chosen), 2)), 2)
    boxes = random.choice(1 << 16, size=len(chosen), replace=False)
    shares = random.integers(2, 4, len(chosen)) if macs is None else _split_evenly(macs, len(chosen))
    return tuple(
        AccessPoint(f"ap-{i + 1:03d}", place, local_macs(box, int(share)))
        for i, (place, box, share) in enumerate(zip(places, boxes, shares, strict=True))
    )


def _split_evenly(total: int, count: int) -> list[int]:
    return [total // count + (i < total % count) for i in range(count)]
