"""The two scenes of TWC-SLAM's tables: a floor plan, what is written on its walls, and who walks where.

The paper does not print what hangs on the walls of its scenes, but its text columns say what that must be like: of
pairs of equal texts four in five are right, so few texts repeat, and of pairs that are half alike two in three are
wrong, so many texts resemble each other. `numbered` signs are like that: a room's door, evacuation plan and desk bear
its number ("ROOM 3011", "PLAN 3011", "DESK 3011"), the numbers of two neighbours differ in one digit and all others in
two, and what repeats (exits, fire cabinets or hydrants) hangs in the first and the last room only. This rule was chosen
among a few on scene #01; #02 follows it. Signs `as-drawn` are the maps' own: every room repeats the same one or two
texts, and all other texts are unlike, which is harder for text alone and easier for text and radio together.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from twc_env.config import EnvConfig
from twc_env.maps import load_map
from twc_env.random_streams import random_stream
from twc_env.reproduce.routes import RoutePlanner, Walk, room_tour, walk
from twc_env.world.floorplan import Floorplan, Room, Sign

Array = NDArray

SCENES: dict[str, tuple[str, tuple[tuple[int, ...], ...]]] = {
    "#01": ("twin-01", ((0, 1, 2, 3), (3, 2, 1, 0))),
    "#02": ("twin-02", ((0, 2, 1, 4), (4, 6, 7, 5), (2, 3, 5, 4))),
}
"""Map, and the rooms that each robot visits in order."""
SIGNS = ("as-drawn", "numbered")
"""What is written on the walls."""
EXIT = "EXIT"
STOP_SPREAD_M = 0.25
"""How far a robot's stops differ from one seed to the next."""
BEFORE_WALL_M = 0.2


def scene_plan(scene: str, signs: str) -> Floorplan:
    """The floor plan of a scene with one of SIGNS on its walls."""
    plan = load_map(SCENES[scene][0])
    return plan if signs == "as-drawn" else numbered(plan)


def numbered(plan: Floorplan) -> Floorplan:
    """The plan with signs that bear the numbers of their rooms; the last room is the corridor, which keeps its own."""
    rooms = plan.rooms[:-1]
    texts = [sign.text for sign in plan.signs]
    changed = []
    for sign in plan.signs:
        k = _room_of(sign, rooms)
        is_repeated = texts.count(sign.text) > 1
        if k is None or (is_repeated and k in (0, len(rooms) - 1)):
            changed.append(sign)
        elif sign.text != EXIT:
            what = "ROOM" if sign.text == rooms[k].name else "DESK" if is_repeated else "PLAN"
            changed.append(dataclasses.replace(sign, text=f"{what} {room_number(k)}"))
    return dataclasses.replace(plan, signs=tuple(changed))


def room_number(k: int) -> int:
    """3011, 3012, 3023, 3024, 3035 and so on."""
    return 3011 + 12 * (k // 2) + k % 2


def _room_of(sign: Sign, rooms: Sequence[Room]) -> int | None:
    """The room that a sign hangs in, or that a door sign outside belongs to; None for the corridor's own."""
    ahead_m = BEFORE_WALL_M * np.array([math.cos(sign.facing_rad), math.sin(sign.facing_rad)])
    for point_m in (sign.position_m + ahead_m, sign.position_m - ahead_m):
        for k, room in enumerate(rooms):
            low, high = room.polygon_m.min(axis=0), room.polygon_m.max(axis=0)
            if (low < point_m).all() and (point_m < high).all():
                return k
    return None


def walk_scene(config: EnvConfig, scene: str, signs: str, seed: int) -> list[Walk]:
    """All robots' walks: through their rooms and back to the start, the corridor being the plan's last room."""
    plan = scene_plan(scene, signs)
    planner = RoutePlanner(plan)
    random = random_stream(seed, "routes")
    corridor = plan.rooms[-1].polygon_m
    middle_y = corridor[:, 1].mean()
    ends = corridor[:, 0].min() + 1.0, corridor[:, 0].max() - 1.0, corridor[:, 0].mean()
    walks = []
    for robot, order in enumerate(SCENES[scene][1]):
        start = np.array([ends[robot % 3], middle_y])
        stops = [stop for n, k in enumerate(order) for stop in room_tour(plan.rooms[k], (n + robot) % 2 == 1)]
        jittered = [stop + random.normal(0.0, STOP_SPREAD_M, 2) for stop in stops]
        walks.append(walk(config, plan, planner.route([start, *jittered, start]), robot, seed))
    return walks
