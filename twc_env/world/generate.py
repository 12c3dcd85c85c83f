"""Buildings by kind, area and seed: repeated rooms, corridors that close loops, repeated signs and unique room names.

A floor is a set of tiles (rooms, open floor, voids) on a grid of one decimetre. Walls are where tiles meet, doors are
gaps in them. Equal arguments give equal buildings in every process and on every machine.
"""

from __future__ import annotations

import hashlib
import itertools
import math
from collections import defaultdict
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from twc_env.errors import MapError
from twc_env.random_streams import random_stream
from twc_env.world.floorplan import AccessPoint, Floorplan, Room, Sign, validate

Array = NDArray

AREA_MIN_M2, AREA_MAX_M2 = 100, 10_000
"""Gross floor area of a generated building."""
SPLITS = {"train": 1000, "validation": 100, "test": 100}
"""Buildings of each fixed split, named `train/0000` and so on."""
SPLIT_AREA_M2 = (100.0, 2000.0)
"""Areas in the splits are drawn from this range, evenly on a logarithmic scale."""
ROBOT_RADIUS_M = 0.2
"""Every room can be reached by a robot of this radius."""
_NAMED_MAX = 5
_SPLIT_SEEDS = {"train": 0, "validation": 1_000_000, "test": 2_000_000}
_OUTER_DB, _INNER_DB, _FURNITURE_DB, _RACK_DB = 8.0, 4.5, 2.0, 3.0
_ROOM_MIN = 25
"""Shortest side of a room [dm]; all lengths named without unit in this file are decimetres."""
_PLATE_OFFSET, _CONNECTION_OFFSET = 3, 6
_MAC_VENDOR = 0x02005E
_NOUNS = (
    "ARCHIVE", "BINDERY", "CERAMICS", "DARKROOM", "ELECTRONICS", "FOUNDRY", "GEOLOGY", "HERBARIUM", "IMAGING",
    "JOINERY", "KITCHEN", "LIBRARY", "MAILROOM", "NETWORKS", "OPTICS", "PRINTING", "QUALITY", "ROBOTICS", "SEMINAR",
    "TEXTILES", "UTILITY", "VACUUM LAB", "WORKSHOP", "X-RAY", "YEAST LAB", "ZOOLOGY",
)  # fmt: skip
_WARD_NOUNS = (
    "BURNS", "CARDIOLOGY", "DIALYSIS", "ENDOSCOPY", "FRACTURES", "GENETICS", "HAND CLINIC", "INFUSION", "LINEN",
    "MATERNITY", "NEUROLOGY", "ONCOLOGY", "PHARMACY", "RECOVERY", "SURGERY", "TRAUMA", "UROLOGY", "VISITORS",
)  # fmt: skip
_SYLLABLES = (
    "BA",
    "CO",
    "DE",
    "FI",
    "GU",
    "HO",
    "JA",
    "KE",
    "LU",
    "MI",
    "NO",
    "PA",
    "RE",
    "SO",
    "TI",
    "VE",
    "WI",
    "ZA",
)


@dataclass(frozen=True, slots=True)
class _Tile:
    """A rectangle of the floor [dm]."""

    x0: int
    y0: int
    x1: int
    y1: int
    use: str
    """"room", "open" (floor without walls to other open tiles) or "void" (closed, no floor)."""

    @property
    def centre_m(self) -> tuple[float, float]:
        return (self.x0 + self.x1) / 20, (self.y0 + self.y1) / 20


@dataclass(frozen=True, slots=True)
class _Edge:
    """Where two tiles meet along a line: x = line (axis 0) or y = line (axis 1). Tile -1 is the outside."""

    axis: int
    line: int
    begin: int
    end: int
    low: int
    high: int

    def point_m(self, along: float) -> Array:
        point = (self.line, along) if self.axis == 0 else (along, self.line)
        return np.array(point) / 10

    def facing_rad(self, tile: int) -> float:
        """Out of the wall, into the tile."""
        return (0.0 if self.high == tile else math.pi) + (math.pi / 2 if self.axis == 1 else 0.0)

    def other(self, tile: int) -> int:
        return self.low if self.high == tile else self.high

    @property
    def length(self) -> int:
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
    outer_db: float = _OUTER_DB
    void_db: float = _INNER_DB
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
    tiles: list[_Tile] = field(default_factory=list)
    walls: list[tuple[float, ...]] = field(default_factory=list)
    """x1, y1, x2, y2 [dm], loss [dB]."""
    doors: dict[tuple[int, int], list[tuple[int, int]]] = field(default_factory=lambda: defaultdict(list))
    """(axis, line) -> (begin, end) gaps."""
    signs: list[Sign] = field(default_factory=list)
    rooms: list[Room] = field(default_factory=list)

    def add(self, x0: int, y0: int, x1: int, y1: int, use: str) -> None:
        """A tile [dm] that is "room", "open" or "void"; one without area is left out."""
        if x1 > x0 and y1 > y0:
            self.tiles.append(_Tile(x0, y0, x1, y1, use))

    def box(self, x0: float, y0: float, x1: float, y1: float, loss_db: float) -> None:
        """An obstacle: four walls."""
        corners = [(x0, y0), (x1, y0), (x1, y1), (x0, y1)]
        self.walls += [(*a, *b, loss_db) for a, b in zip(corners, corners[1:] + corners[:1], strict=True)]

    def hang(self, text: str, position_m: Array, facing_rad: float) -> None:
        """A sign."""
        self.signs.append(Sign(text, position_m, float(facing_rad)))

    def is_clear(self, edge: _Edge, along: float, gap: float = 4) -> bool:
        """Whether a sign fits: on the edge, beside doors and other signs."""
        if not edge.begin + 2 <= along <= edge.end - 2:
            return False
        if any(begin - 2 < along < end + 2 for begin, end in self.doors[edge.axis, edge.line]):
            return False
        place = edge.point_m(along)
        return all(np.abs(sign.position_m - place).max() >= gap / 10 for sign in self.signs)


# --- the public door -------------------------------------------------------------------------------------------------


def generate(kind: str, area_m2: float, seed: int, check: bool = True) -> Floorplan:
    """A building of a kind, gross floor area [m2] and seed; its name is `gen:KIND:AREA:SEED`.

    Raises MapError for an unknown kind, an area outside 100 .. 10,000 m2 or a negative seed.
    """
    if kind not in KINDS:
        raise MapError(f"no buildings of kind {kind!r}; kinds are {', '.join(KINDS)}")
    if not AREA_MIN_M2 <= area_m2 <= AREA_MAX_M2:
        raise MapError(f"the floor area must be {AREA_MIN_M2} to {AREA_MAX_M2} m2; got {area_m2:g}")
    if seed < 0:
        raise MapError(f"the seed of a building must be 0 or more; got {seed}")
    random = random_stream(seed, f"generate-{kind}-{area_m2:g}")
    drawing = _KINDS[kind](area_m2, random)
    plan = finish(drawing, f"gen:{kind}:{area_m2:g}:{seed}", random)
    return check_reachable(validate(plan)) if check else plan


def generate_by_name(name: str, check: bool = True) -> Floorplan | None:
    """The building of a name such as `gen:office:800:7` or `train/0007`; None for names of another form.

    Raises MapError when the form fits and a part of it does not.
    """
    head, _, rest = name.partition(":")
    if head == "gen":
        return _cached(*_parts(name, rest), name, check)
    split, _, number = name.partition("/")
    if split not in SPLITS or not number.isdigit() or len(number) != 4:
        return None
    if int(number) >= SPLITS[split]:
        raise MapError(f"no building {name!r}: {split} holds {SPLITS[split]}, {split}/0000 to {_last(split)}")
    return _cached(*split_recipe(split, int(number)), name, check)


def split_names(split: str) -> tuple[str, ...]:
    """The names of all buildings of a split."""
    if split not in SPLITS:
        raise MapError(f"no split {split!r}; splits are {', '.join(SPLITS)}")
    return tuple(f"{split}/{number:04d}" for number in range(SPLITS[split]))


def split_recipe(split: str, number: int) -> tuple[str, float, int]:
    """Kind, area [m2] and seed of one building of a split: kinds take turns, areas are drawn."""
    seed = _SPLIT_SEEDS[split] + number
    low, high = (math.log(area) for area in SPLIT_AREA_M2)
    area_m2 = round(math.exp(random_stream(seed, "split-area").uniform(low, high)))
    return KINDS[number % len(KINDS)], float(area_m2), seed


def layout_digest(plan: Floorplan) -> str:
    """Twelve hex digits of the walls alone, the same for moved, quarter-turned and mirrored copies."""
    walls = np.round(plan.home.walls_m * 100).astype(np.int64)
    copies = []
    for mirror in (1, -1):
        for turn in ([[1, 0], [0, 1]], [[0, -1], [1, 0]], [[-1, 0], [0, -1]], [[0, 1], [-1, 0]]):
            copy = walls * np.array([mirror, 1]) @ np.array(turn)
            copy -= copy.reshape(-1, 2).min(axis=0)
            # The ends of a wall, and the walls, in one order.
            is_swapped = (copy[:, 0, 0] > copy[:, 1, 0]) | (
                (copy[:, 0, 0] == copy[:, 1, 0]) & (copy[:, 0, 1] > copy[:, 1, 1])
            )
            copy[is_swapped] = copy[is_swapped][:, ::-1]
            rows = copy.reshape(-1, 4)
            copies.append(rows[np.lexsort(rows.T)].tobytes())
    return hashlib.sha256(min(copies)).hexdigest()[:12]


def split_digest(split: str) -> str:
    """One digest over the layouts of a split, in order; pinned by a test."""
    return digest_of_layouts(layout_digest(plan) for plan in _drawn(split))


def digest_of_layouts(layouts: Iterator[str]) -> str:
    """One digest over a sequence of layout digests."""
    return hashlib.sha256("\n".join(layouts).encode()).hexdigest()[:12]


def split_layouts(split: str) -> list[str]:
    """Layout digest of every building of a split."""
    return [layout_digest(plan) for plan in _drawn(split)]


def check_reachable(plan: Floorplan, radius_m: float = ROBOT_RADIUS_M) -> Floorplan:
    """Return the plan if a disc of this radius can drive from any room to any other; otherwise raise MapError."""
    from scipy import ndimage  # slow to import, and needed for generated buildings alone

    cells = plan.cells()
    gap_m = ndimage.distance_transform_edt(~cells.wall) * cells.resolution_m
    labels, _ = ndimage.label(cells.free & (gap_m > radius_m + cells.resolution_m / 2))
    sizes = np.bincount(labels.ravel())
    if len(sizes) < 2:
        raise MapError(f"map {plan.name!r} has no room for a robot of radius {radius_m:g} m; widen the floor")
    largest = 1 + int(np.argmax(sizes[1:]))
    out_of_reach = []
    for room in plan.rooms:
        low = np.floor((room.polygon_m.min(axis=0) - cells.origin_m) / cells.resolution_m).astype(int).clip(0)
        high = np.ceil((room.polygon_m.max(axis=0) - cells.origin_m) / cells.resolution_m).astype(int)
        if not (labels[low[1] : high[1], low[0] : high[0]] == largest).any():
            out_of_reach.append(repr(room.name))
    if out_of_reach:
        raise MapError(
            f"map {plan.name!r}: {len(out_of_reach)} of {len(plan.rooms)} rooms cannot be reached by a robot of radius "
            f"{radius_m:g} m ({', '.join(out_of_reach[:_NAMED_MAX])}"
            f"{', ...' if len(out_of_reach) > _NAMED_MAX else ''}); widen their doors or clear the way"
        )
    return plan


@lru_cache(maxsize=32)
def _cached(kind: str, area_m2: float, seed: int, name: str, check: bool) -> Floorplan:
    plan = generate(kind, area_m2, seed, check)
    object.__setattr__(plan, "name", name)  # not yet seen by anyone; its caches stay warm
    return plan


def _drawn(split: str) -> Iterator[Floorplan]:
    for number in range(len(split_names(split))):
        yield generate(*split_recipe(split, number), check=False)


def _last(split: str) -> str:
    return split_names(split)[-1]


def _parts(name: str, rest: str) -> tuple[str, float, int]:
    parts = rest.split(":")
    try:
        kind, area_m2, seed = parts[0], float(parts[1]), int(parts[2])
        if len(parts) != 3 or not math.isfinite(area_m2):
            raise ValueError
    except (IndexError, ValueError):
        raise MapError(
            f"{name!r} names no building; write gen:KIND:AREA:SEED, for example gen:office:800:7 "
            f"(kinds: {', '.join(KINDS)})"
        ) from None
    return kind, area_m2, seed


# --- kinds -----------------------------------------------------------------------------------------------------------


def _office(area_m2: float, random: np.random.Generator) -> Drawing:
    """Rooms on both sides of parallel corridors, which cross corridors join to loops."""
    style = Style(
        door=_door(random),
        door_offset=_between(random, 4, 8),
        repeated="FIRE EXTINGUISHER",
        furniture=_furniture(random),
        connecting_share=0.15,
        label=room_label,
    )
    drawing = Drawing(style)
    width, height = _sides(area_m2, random.uniform(0.5, 0.8), 68 + _between(random, 0, 6))
    bands(drawing, width, height, _between(random, 16, 24), _between(random, 42, 62), _between(random, 30, 48), random)
    return drawing


def _ward(area_m2: float, random: np.random.Generator) -> Drawing:
    """A racetrack: two corridors or more around service rooms, patient rooms with washrooms outside."""
    style = Style(
        door=_between(random, 11, 14),
        door_offset=_between(random, 4, 8),
        repeated="HAND WASH",
        furniture=(8, 16),
        washrooms=True,
        label=_ward_label,
    )
    drawing = Drawing(style)
    width, height = _sides(area_m2, random.uniform(0.55, 0.85), 107 + _between(random, 0, 6))
    corridor = 16 if height < 130 else _between(random, 18, 26)
    bands(drawing, width, height, corridor, _between(random, 46, 58), _between(random, 38, 46), random, count_min=2)
    return drawing


def _ring(area_m2: float, random: np.random.Generator) -> Drawing:
    """Rooms inside and outside ring corridors, one within the other."""
    style = Style(
        door=_door(random),
        door_offset=_between(random, 4, 8),
        repeated="NO SMOKING",
        furniture=_furniture(random),
        connecting_share=0.15,
        label=room_label,
    )
    drawing = Drawing(style)
    width, height = _sides(area_m2, random.uniform(0.75, 1.0), 84 + _between(random, 0, 6))
    corridor = 14 if height < 110 else _between(random, 16, 26)
    depth = min(_between(random, 40, 60), max(_ROOM_MIN, (height - 2 * corridor) // 4))
    _rings(drawing, (0, 0, width, height), depth, corridor, _between(random, 30, 46), is_inner=False)
    return drawing


def _mall(area_m2: float, random: np.random.Generator) -> Drawing:
    """Shops along a wide ring concourse with kiosks."""
    style = Style(
        door=_between(random, 12, 14),
        door_offset=_between(random, 4, 8),
        repeated="SALE",
        floor_name="CONCOURSE",
        label=_shop_label(random),
    )
    drawing = Drawing(style)
    width, height = _sides(area_m2, random.uniform(0.7, 0.95), 94 + _between(random, 0, 6))
    corridor = int(np.clip(round(height * random.uniform(0.09, 0.13)), 18, 90))
    depth = int(np.clip(round(height * random.uniform(0.16, 0.22)), _ROOM_MIN, 150))
    module = int(np.clip(round(depth * random.uniform(0.7, 1.0)), 30, 120))
    _rings(drawing, (0, 0, width, height), depth, corridor, module, is_inner=False)
    if corridor >= 48:
        _kiosks(drawing, side=corridor - 30 if corridor < 60 else 24, pitch=_between(random, 100, 150))
    return drawing


def _warehouse(area_m2: float, random: np.random.Generator) -> Drawing:
    """One hall of alike racks with aisles between them, offices along one side."""
    style = Style(
        door=_door(random),
        door_offset=_between(random, 4, 8),
        repeated="FIRE EXTINGUISHER",
        floor_name="HALL",
        label=room_label,
    )
    drawing = Drawing(style)
    width, height = _sides(area_m2, random.uniform(0.55, 0.9), 75 + _between(random, 0, 6))
    strip = _between(random, 26, 40) if width >= 110 else 0
    for y0, y1 in _split(0, height, _between(random, 30, 50)) if strip else []:
        drawing.add(0, y0, strip, y1, "room")
    drawing.add(strip, 0, width, height, "open")
    aisle, cross, depth = _between(random, 14, 30), _between(random, 16, 34), _between(random, 8, 14)
    length = int(np.clip(_between(random, 60, 160), 20, max(20, (width - strip - 3 * cross) // 2)))
    rows = max(1, (height - 2 * cross + aisle) // (depth + aisle))
    columns = max(1, (width - strip - cross) // (length + cross))
    left = strip + (width - strip - columns * (length + cross) + cross) // 2
    bottom = (height - rows * (depth + aisle) + aisle) // 2
    for row in range(rows):
        for column in range(columns):
            x, y = left + column * (length + cross), bottom + row * (depth + aisle)
            drawing.box(x, y, x + length, y + depth, _RACK_DB)
            for end, facing, side in ((x, math.pi, "W"), (x + length, 0.0, "E")):
                drawing.hang(
                    f"RACK {_letters(column)}{row + 1:02d} {side}", np.array([end, y + depth / 2]) / 10, facing
                )
    return drawing


def bands(
    drawing: Drawing,
    width: int,
    height: int,
    corridor: int,
    depth: int,
    module: int,
    random: np.random.Generator,
    count_min: int = 1,
) -> None:
    """Parallel corridors with rooms on both sides; cross corridors through the blocks between them."""
    count = max(count_min, round(height / (2 * depth + corridor)))
    depth = max(_ROOM_MIN, (height - count * corridor) // (2 * count))
    inner = (height - count * corridor - 2 * depth) // max(count - 1, 1)
    crossings = max(2, 1 + round(width / _between(random, 280, 420)))
    edge = module * int(random.integers(0, 3)) if width > 8 * module else 0
    cross = [round(x) for x in np.linspace(edge, width - edge - corridor, crossings)]
    y = _row(drawing, 0, width, 0, depth, module)
    for number in range(count):
        top = height - depth if number == count - 1 else y + corridor
        drawing.add(0, y, width, top, "open")
        y = top
        if number < count - 1:
            for x in cross:
                drawing.add(x, y, x + corridor, y + inner, "open")
            begins, ends = [0, *(x + corridor for x in cross)], [*cross, width]
            rows = [(y, y + inner // 2), (y + inner // 2, y + inner)] if inner >= 2 * _ROOM_MIN else [(y, y + inner)]
            for low, high in rows:
                for x0, x1 in zip(begins, ends, strict=True):
                    _row(drawing, x0, x1, low, high, module)
            y += inner
    _row(drawing, 0, width, y, height, module)


def _rings(drawing: Drawing, box: tuple[int, int, int, int], depth: int, corridor: int, module: int, is_inner: bool):
    """Rooms around, a ring corridor within, and inside it more rooms, a smaller ring or a closed core."""
    x0, y0, x1, y1 = box
    if min(x1 - x0, y1 - y0) < (2 * depth + 2 * corridor + _ROOM_MIN if is_inner else 0):
        _core(drawing, box, corridor, depth, module)
        return
    middle_x, middle_y = (x0 + x1 - corridor) // 2, (y0 + y1 - corridor) // 2
    for low, high in ((y0, y0 + depth), (y1 - depth, y1)):
        if is_inner:
            _row(drawing, x0, middle_x, low, high, module)
            drawing.add(middle_x, low, middle_x + corridor, high, "open")
            _row(drawing, middle_x + corridor, x1, low, high, module)
        else:  # a corner room meets the corridor only beyond the corner
            _row(drawing, x0, x1, low, high, module, first_extra=depth, last_extra=depth)
    for left, right in ((x0, x0 + depth), (x1 - depth, x1)):
        if is_inner:
            _column(drawing, left, right, y0 + depth, middle_y, module)
            drawing.add(left, middle_y, right, middle_y + corridor, "open")
            _column(drawing, left, right, middle_y + corridor, y1 - depth, module)
        else:
            _column(drawing, left, right, y0 + depth, y1 - depth, module)
    x0, y0, x1, y1 = x0 + depth, y0 + depth, x1 - depth, y1 - depth
    drawing.add(x0, y0, x1, y0 + corridor, "open")
    drawing.add(x0, y1 - corridor, x1, y1, "open")
    drawing.add(x0, y0 + corridor, x0 + corridor, y1 - corridor, "open")
    drawing.add(x1 - corridor, y0 + corridor, x1, y1 - corridor, "open")
    core = (x0 + corridor, y0 + corridor, x1 - corridor, y1 - corridor)
    _rings(drawing, core, depth, corridor, module, is_inner=True)


def _core(drawing: Drawing, box: tuple[int, int, int, int], corridor: int, depth: int, module: int) -> None:
    """The middle of a ring: one or two rows of rooms, or a closed shaft where no room fits."""
    x0, y0, x1, y1 = box
    if min(x1 - x0, y1 - y0) < _ROOM_MIN:
        drawing.add(*box, "void")
        return
    cross = (x0 + x1 - corridor) // 2
    halves = [(x0, x1)] if x1 - x0 < 2 * module + 2 * depth + corridor else [(x0, cross), (cross + corridor, x1)]
    if len(halves) == 2:
        drawing.add(cross, y0, cross + corridor, y1, "open")
    middle = (y0 + y1) // 2
    rows = [(y0, middle), (middle, y1)] if y1 - y0 >= 2 * _ROOM_MIN else [(y0, y1)]
    for low, high in rows:
        for left, right in halves:
            _row(drawing, left, right, low, high, module)


def _row(drawing: Drawing, x0: int, x1: int, y0: int, y1: int, module: int, first_extra=0, last_extra=0) -> int:
    for begin, end in _split(x0, x1, module, first_extra, last_extra):
        drawing.add(begin, y0, end, y1, "room" if end - begin >= _ROOM_MIN else "void")
    return y1


def _column(drawing: Drawing, x0: int, x1: int, y0: int, y1: int, module: int) -> None:
    for begin, end in _split(y0, y1, module):
        drawing.add(x0, begin, x1, end, "room" if end - begin >= _ROOM_MIN else "void")


def _split(begin: int, end: int, module: int, first_extra: int = 0, last_extra: int = 0) -> list[tuple[int, int]]:
    """Pieces as long as the module, what is left over in a piece of its own or with the last one."""
    length = end - begin
    if length <= 0:
        return []
    if length < first_extra + last_extra + 2 * _ROOM_MIN:
        return [(begin, end)]
    if length < first_extra + last_extra + 2 * module:
        middle = (begin + first_extra + end - last_extra) // 2
        return [(begin, middle), (middle, end)]
    cuts = [begin, *range(begin + first_extra + module, end - last_extra - module + 1, module)]
    if end - cuts[-1] >= _ROOM_MIN + last_extra + module:
        cuts.append(cuts[-1] + module)
    return list(zip(cuts, [*cuts[1:], end], strict=True))


def _kiosks(drawing: Drawing, side: int, pitch: int) -> None:
    """Alike boxes along the middle of every open tile."""
    for tile in list(drawing.tiles):
        width, height = tile.x1 - tile.x0, tile.y1 - tile.y0
        if tile.use != "open" or max(width, height) < 2 * pitch:
            continue
        for at in range(pitch, max(width, height) - pitch // 2, pitch):
            x, y = (at, height / 2) if width > height else (width / 2, at)
            x, y = tile.x0 + x - side / 2, tile.y0 + y - side / 2
            drawing.box(x, y, x + side, y + side, _FURNITURE_DB)


# --- from tiles to a plan --------------------------------------------------------------------------------------------


def finish(
    drawing: Drawing, name: str, random: np.random.Generator, access_points: int | None = None, macs: int | None = None
) -> Floorplan:
    """Doors, walls, names, signs, furniture and access points for the tiles of a drawing."""
    edges = _edges(drawing.tiles)
    at_tile: dict[int, list[_Edge]] = defaultdict(list)
    for edge in edges:
        for tile in (edge.low, edge.high):
            at_tile[tile].append(edge)
    doors = _place_doors(drawing, at_tile, random)
    _name_rooms(drawing, doors)
    _furnish_rooms(drawing, doors, at_tile)
    _repeat_signs(drawing, edges, random)
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
        interior_m=_clear_point(drawing, start),
    )


def _edges(tiles: list[_Tile]) -> list[_Edge]:
    """Every stretch along which one tile meets another or the outside."""
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
            low, high = _owner(lows, begin), _owner(highs, begin)
            if low >= 0 or high >= 0:
                edges.append(_Edge(axis, line, begin, end, low, high))
    return edges


def _owner(spans: list[tuple[int, int, int]], begin: int) -> int:
    return next((number for first, last, number in spans if first <= begin < last), -1)


def _place_doors(drawing: Drawing, at_tile: dict, random: np.random.Generator) -> dict[int, tuple[_Edge, int]]:
    """A door for every room, onto open floor where it can; (edge, begin) of each room's own door."""
    tiles, style = drawing.tiles, drawing.style
    doors: dict[int, tuple[_Edge, int]] = {}
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
    """Doors between rooms side by side: further loops; one at least, so that the smallest building has a loop."""
    style, pairs = drawing.style, []
    if not style.connecting_share:
        return
    for number, (way, _) in doors.items():
        for edge in at_tile[number]:
            other = edge.high
            if edge.low != number or other not in doors or edge.axis == way.axis:
                continue
            theirs = doors[other][0]
            if (theirs.axis, theirs.line) == (way.axis, way.line) and edge.length >= _ROOM_MIN:
                pairs.append((edge, way.line))
    if not pairs:
        return
    chosen = random.random(len(pairs)) < style.connecting_share
    chosen[int(random.integers(len(pairs)))] = True
    for (edge, line), is_chosen in zip(pairs, chosen, strict=True):
        if is_chosen:
            begin = edge.begin + _CONNECTION_OFFSET if line == edge.begin else edge.end - _CONNECTION_OFFSET - 10
            drawing.doors[edge.axis, edge.line].append((begin, begin + 10))


def _name_rooms(drawing: Drawing, doors: dict[int, tuple[_Edge, int]]) -> None:
    """Rooms get unique names and a plate beside the door; open floors are named too."""
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


def _furnish_rooms(drawing: Drawing, doors: dict[int, tuple[_Edge, int]], at_tile: dict) -> None:
    """The same corner piece, washroom and sign at the same place in every room."""
    style = drawing.style
    for number, (edge, _) in doors.items():
        tile = drawing.tiles[number]
        room = _Corner(tile, edge, into=1 if edge.high == number else -1)
        is_alike = (edge.begin, edge.end) == room.span
        if style.furniture[0] and min(room.depth, room.width) >= _ROOM_MIN and is_alike:
            room.enclose(drawing, (room.depth - style.furniture[0], room.depth), style.furniture[1], _FURNITURE_DB)
        if style.washrooms and room.width >= 38 and room.depth >= 44 and is_alike:
            room.enclose(drawing, (0, 16), 16, _INNER_DB, door=9)
        if number % 2 == 0 and is_alike:
            far = edge.line + room.into * room.depth
            wall = next((e for e in at_tile[number] if e.axis == edge.axis and e.line == far), None)
            if wall is not None and drawing.is_clear(wall, edge.begin + 5):
                drawing.hang(style.repeated, wall.point_m(edge.begin + 5), wall.facing_rad(number))


@dataclass(frozen=True, slots=True)
class _Corner:
    """A room seen from its door: depth away from the door's wall, width along it; pieces go to the far end."""

    tile: _Tile
    edge: _Edge
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
        """Walls off the corner at the end of the span, from depth to depth; the room's own walls close it."""
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


def _repeat_signs(drawing: Drawing, edges: list[_Edge], random: np.random.Generator) -> None:
    """EXIT at the ends of corridors, EXIT and FIRE EXTINGUISHER along them: one of each per 24 m of wall."""
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


def _draw_walls(drawing: Drawing, edges: list[_Edge]) -> None:
    """Edges between tiles that are not both open become walls, joined along straight lines and cut by doors."""
    runs: dict[tuple[int, int, float], list[list[int]]] = defaultdict(list)
    for edge in edges:
        uses = {drawing.tiles[number].use if number >= 0 else "outside" for number in (edge.low, edge.high)}
        if uses == {"open"}:
            continue
        style = drawing.style
        loss_db = style.outer_db if "outside" in uses else style.void_db if "void" in uses else _INNER_DB
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
    """Spread over rooms, corridors and closed blocks, each as far as possible from those before it."""
    pool = []
    for tile in (tile for tile in drawing.tiles if tile.use in drawing.style.access_points_in):
        columns, rows = max(1, (tile.x1 - tile.x0) // 30), max(1, (tile.y1 - tile.y0) // 30)
        xs = tile.x0 + (np.arange(columns) + 0.5) * (tile.x1 - tile.x0) / columns
        ys = tile.y0 + (np.arange(rows) + 0.5) * (tile.y1 - tile.y0) / rows
        pool.append(np.stack(np.meshgrid(xs, ys), axis=-1).reshape(-1, 2) / 10)
    points = np.concatenate(pool)
    area_m2 = sum((t.x1 - t.x0) * (t.y1 - t.y0) for t in drawing.tiles) / 100
    count = count or (max(6, round(area_m2 / 25)) if area_m2 <= 1000 else 40 + round((area_m2 - 1000) / 100))
    chosen = [int(random.integers(len(points)))]
    gaps = np.linalg.norm(points - points[chosen[0]], axis=1)
    while len(chosen) < min(count, len(points)):
        chosen.append(int(np.argmax(gaps)))
        gaps = np.minimum(gaps, np.linalg.norm(points - points[chosen[-1]], axis=1))
    places = np.round(points[chosen] + random.uniform(-0.6, 0.6, (len(chosen), 2)), 2)
    boxes = random.choice(1 << 16, size=len(chosen), replace=False)
    shares = random.integers(2, 4, len(chosen)) if macs is None else _shares(macs, len(chosen))
    return tuple(
        AccessPoint(f"ap-{i + 1:03d}", place, tuple(_MAC_VENDOR << 24 | int(box) << 8 | k for k in range(int(share))))
        for i, (place, box, share) in enumerate(zip(places, boxes, shares, strict=True))
    )


def _shares(total: int, count: int) -> list[int]:
    return [total // count + (i < total % count) for i in range(count)]


def _clear_point(drawing: Drawing, tile: _Tile) -> Array:
    """A point of an open tile that lies on no box: near its lower left corner, half a metre off its walls."""
    return np.array([[tile.x0 + 5.5, tile.y0 + 5.5]]) / 10


# --- sizes and names -------------------------------------------------------------------------------------------------


def _sides(area_m2: float, aspect: float, side_min: int) -> tuple[int, int]:
    """(width, height) [dm] of a floor with this area."""
    height = max(side_min, round(10 * math.sqrt(area_m2 * aspect)))
    return round(100 * area_m2 / height), height


def _between(random: np.random.Generator, low: int, high: int) -> int:
    return int(random.integers(low, high + 1))


def _door(random: np.random.Generator) -> int:
    return _between(random, 9, 14)


def _furniture(random: np.random.Generator) -> tuple[int, int]:
    return _between(random, 5, 8), _between(random, 8, 15)


def _letters(number: int) -> str:
    return chr(65 + number % 26) if number < 26 else _letters(number // 26 - 1) + chr(65 + number % 26)


def room_label(number: int) -> str:
    """ "A101 ARCHIVE", "A102 HERBARIUM", ...: every number another text."""
    wing, place = divmod(number, 40)
    noun = _NOUNS[(number * 7 + wing) % len(_NOUNS)]
    return f"{_letters(wing)}{101 + place} {noun}"


def _ward_label(number: int) -> str:
    wing, place = divmod(number, 30)
    return f"{_letters(wing)}{11 + place} {_WARD_NOUNS[(number * 5 + wing) % len(_WARD_NOUNS)]}"


def _shop_label(random: np.random.Generator) -> Callable[[int], str]:
    """Invented shop names of two or three syllables, each once."""
    names: list[str] = []

    def label(number: int) -> str:
        while len(names) <= number:
            syllables = random.integers(0, len(_SYLLABLES), _between(random, 2, 4))
            name = "".join(_SYLLABLES[i] for i in syllables)
            if name not in names:
                names.append(name)
        return names[number]

    return label


_KINDS: dict[str, Callable[[float, np.random.Generator], Drawing]] = {
    "office": _office,
    "ring": _ring,
    "mall": _mall,
    "ward": _ward,
    "warehouse": _warehouse,
}
KINDS = tuple(_KINDS)
"""Kinds of generated buildings."""
