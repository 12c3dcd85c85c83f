"""Layouts of generated buildings: rooms, corridors and halls of each kind. Lengths in decimetres."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from twc_env.world.building.drawing import FURNITURE_DB, ROOM_MIN, Drawing, Style
from twc_env.world.building.room_names import letters, room_label, shop_label, ward_label

_RACK_DB = 3.0


def _office(area_m2: float, random: np.random.Generator) -> Drawing:
    """Rooms on both sides of parallel corridors, which are joined by cross corridors."""
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
    """Racetrack plan: two or more corridors around service rooms; patient rooms with washrooms outside."""
    style = Style(
        door=_between(random, 11, 14),
        door_offset=_between(random, 4, 8),
        repeated="HAND WASH",
        furniture=(8, 16),
        washrooms=True,
        label=ward_label,
    )
    drawing = Drawing(style)
    width, height = _sides(area_m2, random.uniform(0.55, 0.85), 107 + _between(random, 0, 6))
    corridor = 16 if height < 130 else _between(random, 18, 26)
    bands(drawing, width, height, corridor, _between(random, 46, 58), _between(random, 38, 46), random, count_min=2)
    return drawing


def _ring(area_m2: float, random: np.random.Generator) -> Drawing:
    """Concentric ring corridors with rooms on both sides."""
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
    depth = min(_between(random, 40, 60), max(ROOM_MIN, (height - 2 * corridor) // 4))
    _rings(drawing, (0, 0, width, height), depth, corridor, _between(random, 30, 46), is_inner=False)
    return drawing


def _mall(area_m2: float, random: np.random.Generator) -> Drawing:
    """Shops along a wide ring concourse with kiosks."""
    style = Style(
        door=_between(random, 12, 14),
        door_offset=_between(random, 4, 8),
        repeated="SALE",
        floor_name="CONCOURSE",
        label=shop_label(random),
    )
    drawing = Drawing(style)
    width, height = _sides(area_m2, random.uniform(0.7, 0.95), 94 + _between(random, 0, 6))
    corridor = int(np.clip(round(height * random.uniform(0.09, 0.13)), 18, 90))
    depth = int(np.clip(round(height * random.uniform(0.16, 0.22)), ROOM_MIN, 150))
    module = int(np.clip(round(depth * random.uniform(0.7, 1.0)), 30, 120))
    _rings(drawing, (0, 0, width, height), depth, corridor, module, is_inner=False)
    if corridor >= 48:
        _kiosks(drawing, side=corridor - 30 if corridor < 60 else 24, pitch=_between(random, 100, 150))
    return drawing


def _warehouse(area_m2: float, random: np.random.Generator) -> Drawing:
    """A hall with equal racks and aisles, offices along one side."""
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
                drawing.hang(f"RACK {letters(column)}{row + 1:02d} {side}", np.array([end, y + depth / 2]) / 10, facing)
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
    """Add parallel corridors with rooms on both sides, and cross corridors between them.

    corridor: width; depth: of the outer rooms; module: width of a room; count_min: of corridors.
    """
    count = max(count_min, round(height / (2 * depth + corridor)))
    depth = max(ROOM_MIN, (height - count * corridor) // (2 * count))
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
            rows = [(y, y + inner // 2), (y + inner // 2, y + inner)] if inner >= 2 * ROOM_MIN else [(y, y + inner)]
            for low, high in rows:
                for x0, x1 in zip(begins, ends, strict=True):
                    _row(drawing, x0, x1, low, high, module)
            y += inner
    _row(drawing, 0, width, y, height, module)


def _rings(drawing: Drawing, box: tuple[int, int, int, int], depth: int, corridor: int, module: int, is_inner: bool):
    """Add rooms along the sides of a box (x0, y0, x1, y1), a ring corridor inside them, and a smaller ring or core."""
    x0, y0, x1, y1 = box
    if min(x1 - x0, y1 - y0) < (2 * depth + 2 * corridor + ROOM_MIN if is_inner else 0):
        _core(drawing, box, corridor, depth, module)
        return
    middle_x, middle_y = (x0 + x1 - corridor) // 2, (y0 + y1 - corridor) // 2
    for low, high in ((y0, y0 + depth), (y1 - depth, y1)):
        if is_inner:
            _row(drawing, x0, middle_x, low, high, module)
            drawing.add(middle_x, low, middle_x + corridor, high, "open")
            _row(drawing, middle_x + corridor, x1, low, high, module)
        else:  # a corner room touches the corridor only beyond the corner
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
    """Add the centre of a ring: one or two rows of rooms, or a void if no room fits."""
    x0, y0, x1, y1 = box
    if min(x1 - x0, y1 - y0) < ROOM_MIN:
        drawing.add(*box, "void")
        return
    cross = (x0 + x1 - corridor) // 2
    halves = [(x0, x1)] if x1 - x0 < 2 * module + 2 * depth + corridor else [(x0, cross), (cross + corridor, x1)]
    if len(halves) == 2:
        drawing.add(cross, y0, cross + corridor, y1, "open")
    middle = (y0 + y1) // 2
    rows = [(y0, middle), (middle, y1)] if y1 - y0 >= 2 * ROOM_MIN else [(y0, y1)]
    for low, high in rows:
        for left, right in halves:
            _row(drawing, left, right, low, high, module)


def _row(drawing: Drawing, x0: int, x1: int, y0: int, y1: int, module: int, first_extra=0, last_extra=0) -> int:
    for begin, end in _split(x0, x1, module, first_extra, last_extra):
        drawing.add(begin, y0, end, y1, "room" if end - begin >= ROOM_MIN else "void")
    return y1


def _column(drawing: Drawing, x0: int, x1: int, y0: int, y1: int, module: int) -> None:
    for begin, end in _split(y0, y1, module):
        drawing.add(x0, begin, x1, end, "room" if end - begin >= ROOM_MIN else "void")


def _split(begin: int, end: int, module: int, first_extra: int = 0, last_extra: int = 0) -> list[tuple[int, int]]:
    """Intervals of length `module`, the first and last longer by their extras; the rest extends or follows the last."""
    length = end - begin
    if length <= 0:
        return []
    if length < first_extra + last_extra + 2 * ROOM_MIN:
        return [(begin, end)]
    if length < first_extra + last_extra + 2 * module:
        middle = (begin + first_extra + end - last_extra) // 2
        return [(begin, middle), (middle, end)]
    cuts = [begin, *range(begin + first_extra + module, end - last_extra - module + 1, module)]
    if end - cuts[-1] >= ROOM_MIN + last_extra + module:
        cuts.append(cuts[-1] + module)
    return list(zip(cuts, [*cuts[1:], end], strict=True))


def _kiosks(drawing: Drawing, side: int, pitch: int) -> None:
    """Add equal boxes every `pitch` along the centre line of every open tile."""
    for tile in list(drawing.tiles):
        width, height = tile.x1 - tile.x0, tile.y1 - tile.y0
        if tile.use != "open" or max(width, height) < 2 * pitch:
            continue
        for at in range(pitch, max(width, height) - pitch // 2, pitch):
            x, y = (at, height / 2) if width > height else (width / 2, at)
            x, y = tile.x0 + x - side / 2, tile.y0 + y - side / 2
            drawing.box(x, y, x + side, y + side, FURNITURE_DB)


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


LAYOUTS: dict[str, Callable[[float, np.random.Generator], Drawing]] = {
    "office": _office,
    "ring": _ring,
    "mall": _mall,
    "ward": _ward,
    "warehouse": _warehouse,
}
KINDS = tuple(LAYOUTS)
"""Kinds of generated buildings."""
