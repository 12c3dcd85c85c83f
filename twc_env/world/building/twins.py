"""Floor plans with the areas and transmitter counts of the sites of the radio SLAM paper (papers.md R14).

The paper has no floor plans: the layouts are our own.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from functools import lru_cache

import numpy as np

from twc_env.records.random_streams import random_stream
from twc_env.world.building.drawing import Drawing, Style
from twc_env.world.building.fittings import finish
from twc_env.world.building.floorplan import Floorplan
from twc_env.world.building.floorplan_check import validate
from twc_env.world.building.generate import check_reachable
from twc_env.world.building.layouts import bands
from twc_env.world.building.room_names import room_label

_MACS_PER_ACCESS_POINT = 8
"""Four networks on two bands each."""
_FACES = {"WEST": (0, 0.5, 180), "EAST": (1, 0.5, 0), "SOUTH": (0.5, 0, -90), "NORTH": (0.5, 1, 90)}


@lru_cache(maxsize=3)
def radio_twin(name: str) -> Floorplan:
    """The twin of a name in `RADIO_TWINS`."""
    random = random_stream(0, name)
    draw, macs = _TWINS[name]
    plan = finish(draw(random), name, random, access_points=macs // _MACS_PER_ACCESS_POINT, macs=macs)
    return check_reachable(validate(plan))


def _sutd_indoor(random: np.random.Generator) -> Drawing:
    """5,000 m2 of classrooms along wide corridors."""
    style = Style(door=12, repeated="FIRE EXTINGUISHER", furniture=(8, 16), connecting_share=0.1, label=room_label)
    drawing = Drawing(style)
    bands(drawing, 1000, 500, corridor=30, depth=75, module=70, random=random)
    return drawing


def _ntu(random: np.random.Generator) -> Drawing:
    """5,100 m2: covered walks around blocks of rooms and open courts, whose railings have little radio loss."""
    style = Style(
        door=12, repeated="NO SMOKING", furniture=(8, 16), void_db=1.0, floor_name="WALK",
        access_points_in=("room", "open"), label=room_label,
    )  # fmt: skip
    drawing = Drawing(style)
    blocks = _streets(drawing, 850, 600, columns=3, rows=2, street=40)
    for number, (x0, y0, x1, y1) in enumerate(blocks):
        if number % 2:
            drawing.add(x0, y0, x1, y1, "void")
            continue
        cuts = np.linspace(x0, x1, 5).astype(int).tolist()
        middle = (y0 + y1) // 2
        for left, right in itertools.pairwise(cuts):
            drawing.add(left, y0, right, middle, "room")
            drawing.add(left, middle, right, y1, "room")
    return drawing


def _sutd_outdoor(random: np.random.Generator) -> Drawing:
    """75,000 m2: fenced streets with lamp posts between closed buildings."""
    style = Style(
        door=12, repeated="", outer_db=1.0, void_db=10.0, floor_name="STREET", along_floor=("BUS STOP", "NO PARKING"),
        access_points_in=("void",),
    )  # fmt: skip
    drawing = Drawing(style)
    for number, (x0, y0, x1, y1) in enumerate(_streets(drawing, 3000, 2500, columns=5, rows=4, street=160)):
        drawing.add(x0, y0, x1, y1, "void")
        for face, (along_x, along_y, facing_deg) in _FACES.items():
            place = np.array([x0 + along_x * (x1 - x0), y0 + along_y * (y1 - y0)]) / 10
            drawing.hang(f"BUILDING {number + 1} {face}", place, np.deg2rad(facing_deg))
    for tile in [tile for tile in drawing.tiles if tile.use == "open"]:
        is_wide = tile.x1 - tile.x0 > tile.y1 - tile.y0
        for along in range(100, max(tile.x1 - tile.x0, tile.y1 - tile.y0) - 100, 240):
            across = int(random.integers(30, 60))
            x, y = (tile.x0 + along, tile.y0 + across) if is_wide else (tile.x0 + across, tile.y0 + along)
            drawing.box(x, y, x + 4, y + 4, 0.5)
    return drawing


def _streets(drawing: Drawing, width: int, height: int, columns: int, rows: int, street: int):
    """Open floor around a grid of blocks; the blocks' corners (x0, y0, x1, y1) [dm]."""
    lefts = np.linspace(0, width - street, columns + 1).astype(int).tolist()
    lows = np.linspace(0, height - street, rows + 1).astype(int).tolist()
    for y in lows:
        drawing.add(0, y, width, y + street, "open")
    blocks = []
    for low, high in itertools.pairwise(lows):
        for left in lefts:
            drawing.add(left, low + street, left + street, high, "open")
        blocks += [(a + street, low + street, b, high) for a, b in itertools.pairwise(lefts)]
    return blocks


_TWINS: dict[str, tuple[Callable[[np.random.Generator], Drawing], int]] = {
    "radio-sutd-indoor": (_sutd_indoor, 1921),
    "radio-ntu": (_ntu, 1046),
    "radio-sutd-outdoor": (_sutd_outdoor, 4488),
}
"""Layout, and number of addresses received in total (papers.md R14)."""
RADIO_TWINS = tuple(_TWINS)
"""Names of the twins."""
