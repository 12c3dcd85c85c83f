"""A building while it is drawn: tiles on a grid of one decimetre, and what is put on them.

All lengths named without unit in the files that draw buildings are decimetres.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.world.floorplan import Room, Sign

OUTER_DB, INNER_DB, FURNITURE_DB = 8.0, 4.5, 2.0
"""Loss of walls."""
ROOM_MIN = 25
"""Shortest side of a room [dm]."""


@dataclass(frozen=True, slots=True)
class Tile:
    """A rectangle of the floor [dm]."""

    x0: int
    y0: int
    x1: int
    y1: int
    use: str
    """"room", "open" (floor without walls to other open tiles) or "void" (closed, no floor)."""


@dataclass(frozen=True, slots=True)
class Edge:
    """Where two tiles meet along a line: x = line (axis 0) or y = line (axis 1). Tile -1 is the outside."""

    axis: int
    line: int
    begin: int
    end: int
    low: int
    high: int

    def point_m(self, along: float) -> Array:
        """(2,) the point at a coordinate [dm] along the edge."""
        point = (self.line, along) if self.axis == 0 else (along, self.line)
        return np.array(point) / 10

    def facing_rad(self, tile: int) -> float:
        """Out of the wall, into the tile."""
        return (0.0 if self.high == tile else math.pi) + (math.pi / 2 if self.axis == 1 else 0.0)

    def other(self, tile: int) -> int:
        """The tile on the other side."""
        return self.low if self.high == tile else self.high

    @property
    def length(self) -> int:
        """In decimetres."""
        return self.end - self.begin


@dataclass(frozen=True, slots=True, kw_only=True)
class Style:
    """What one building repeats in all its rooms."""

    door: int
    """Width of every room's door."""
    repeated: str
    """Hangs at the same place in every second room."""
    furniture: tuple[int, int] = (0, 0)
    """Depth and width of what stands in the corner of each room; (0, 0) for none."""
    door_offset: int = 6
    """Of a room's door from the beginning of its wall."""
    washrooms: bool = False
    two_doors_from: int = 80
    connecting_share: float = 0.0
    """Share of neighbours with a door between them."""
    outer_db: float = OUTER_DB
    void_db: float = INNER_DB
    floor_name: str = "CORRIDOR"
    along_floor: tuple[str, str] = ("FIRE EXTINGUISHER", "EXIT")
    """Hang along the walls of open floor; the second also at the ends of corridors."""
    access_points_in: tuple[str, ...] = ("room", "open", "void")
    """Uses of the tiles that hold access points."""
    label: Callable[[int], str] = lambda number: f"R{number}"


@dataclass(slots=True)
class Drawing:
    """A building while it is drawn: tiles first, then `finish`."""

    style: Style
    tiles: list[Tile] = field(default_factory=list)
    walls: list[tuple[float, ...]] = field(default_factory=list)
    """x1, y1, x2, y2 [dm], loss [dB]."""
    doors: dict[tuple[int, int], list[tuple[int, int]]] = field(default_factory=lambda: defaultdict(list))
    """(axis, line) -> (begin, end) gaps."""
    signs: list[Sign] = field(default_factory=list)
    rooms: list[Room] = field(default_factory=list)

    def add(self, x0: int, y0: int, x1: int, y1: int, use: str) -> None:
        """A tile [dm] that is "room", "open" or "void"; one without area is left out."""
        if x1 > x0 and y1 > y0:
            self.tiles.append(Tile(x0, y0, x1, y1, use))

    def box(self, x0: float, y0: float, x1: float, y1: float, loss_db: float) -> None:
        """An obstacle: four walls."""
        corners = [(x0, y0), (x1, y0), (x1, y1), (x0, y1)]
        self.walls += [(*a, *b, loss_db) for a, b in zip(corners, corners[1:] + corners[:1], strict=True)]

    def hang(self, text: str, position_m: Array, facing_rad: float) -> None:
        """A sign."""
        self.signs.append(Sign(text, position_m, float(facing_rad)))

    def is_clear(self, edge: Edge, along: float) -> bool:
        """Whether a sign fits: on the edge, beside doors and other signs."""
        if not edge.begin + 2 <= along <= edge.end - 2:
            return False
        if any(begin - 2 < along < end + 2 for begin, end in self.doors[edge.axis, edge.line]):
            return False
        place = edge.point_m(along)
        return all(np.abs(sign.position_m - place).max() >= 0.4 for sign in self.signs)
