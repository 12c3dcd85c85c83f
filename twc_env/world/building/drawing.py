"""Drawing of generated buildings: rectangular tiles on a 0.1 m grid, walls, doors and signs.

Lengths without a unit in their name are decimetres, here and in the other files of the generator.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.world.building.floorplan import Room, Sign

OUTER_DB, INNER_DB, FURNITURE_DB = 8.0, 4.5, 2.0
"""RSSI losses per crossing of outer walls, inner walls and furniture."""
ROOM_MIN = 25
"""Shortest side of a room [dm]."""


@dataclass(frozen=True, slots=True)
class Tile:
    """A rectangle of the floor [dm], axis-parallel."""

    x0: int
    y0: int
    x1: int
    y1: int
    use: str
    """"room", "open" (floor without walls to other open tiles) or "void" (closed, no floor)."""


@dataclass(frozen=True, slots=True)
class Edge:
    """Common edge of two tiles on the line x = line (axis 0) or y = line (axis 1); tile -1 is the outside."""

    axis: int
    line: int
    begin: int
    end: int
    low: int
    high: int

    def point_m(self, along: float) -> Array:
        """(2,) point [m] at a coordinate [dm] along the edge."""
        point = (self.line, along) if self.axis == 0 else (along, self.line)
        return np.array(point) / 10

    def facing_rad(self, tile: int) -> float:
        """Direction of the normal into the tile."""
        return (0.0 if self.high == tile else math.pi) + (math.pi / 2 if self.axis == 1 else 0.0)

    def other(self, tile: int) -> int:
        """The tile on the other side."""
        return self.low if self.high == tile else self.high

    @property
    def length(self) -> int:
        """Length [dm]."""
        return self.end - self.begin


@dataclass(frozen=True, slots=True, kw_only=True)
class Style:
    """Settings that all rooms of a building share; repeated layouts make places look alike."""

    door: int
    """Door width."""
    repeated: str
    """Text of the sign at the same position in every second room."""
    furniture: tuple[int, int] = (0, 0)
    """Depth and width of the furniture in one corner of each room; (0, 0) for none."""
    door_offset: int = 6
    """Distance of a room's door from the beginning of its wall."""
    washrooms: bool = False
    two_doors_from: int = 80
    """Least wall length for a second door."""
    connecting_share: float = 0.0
    """Share of adjacent rooms that are joined by a door."""
    outer_db: float = OUTER_DB
    void_db: float = INNER_DB
    floor_name: str = "CORRIDOR"
    along_floor: tuple[str, str] = ("FIRE EXTINGUISHER", "EXIT")
    """Texts of the signs along the walls of open floor; the second also hangs at the ends of corridors."""
    access_points_in: tuple[str, ...] = ("room", "open", "void")
    """Uses of the tiles that may contain access points."""
    label: Callable[[int], str] = lambda number: f"R{number}"


@dataclass(slots=True)
class Drawing:
    """A building under construction: tiles are added, then `fittings.finish` returns its floor plan."""

    style: Style
    tiles: list[Tile] = field(default_factory=list)
    walls: list[tuple[float, ...]] = field(default_factory=list)
    """x1, y1, x2, y2 [dm], loss [dB]."""
    doors: dict[tuple[int, int], list[tuple[int, int]]] = field(default_factory=lambda: defaultdict(list))
    """(axis, line) -> (begin, end) gaps."""
    signs: list[Sign] = field(default_factory=list)
    rooms: list[Room] = field(default_factory=list)

    def add(self, x0: int, y0: int, x1: int, y1: int, use: str) -> None:
        """Add a tile [dm] unless it has no area; use: see `Tile`."""
        if x1 > x0 and y1 > y0:
            self.tiles.append(Tile(x0, y0, x1, y1, use))

    def box(self, x0: float, y0: float, x1: float, y1: float, loss_db: float) -> None:
        """Add an obstacle [dm] of four walls."""
        corners = [(x0, y0), (x1, y0), (x1, y1), (x0, y1)]
        self.walls += [(*a, *b, loss_db) for a, b in zip(corners, corners[1:] + corners[:1], strict=True)]

    def hang(self, text: str, position_m: Array, facing_rad: float) -> None:
        """Add a sign at position_m (2,)."""
        self.signs.append(Sign(text, position_m, float(facing_rad)))

    def is_clear(self, edge: Edge, along: float) -> bool:
        """Whether a sign at a coordinate [dm] along the edge keeps its distance from corners, doors and other signs."""
        if not edge.begin + 2 <= along <= edge.end - 2:
            return False
        if any(begin - 2 < along < end + 2 for begin, end in self.doors[edge.axis, edge.line]):
            return False
        place = edge.point_m(along)
        return all(np.abs(sign.position_m - place).max() >= 0.4 for sign in self.signs)
