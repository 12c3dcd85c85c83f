"""The two scenes of TWC-SLAM's tables: a floor plan, what is written on its walls, and who walks where.

The paper does not print what hangs on the walls of its scenes, but its text columns say what that must be like. Of
pairs of equal texts on #01 four in five are right: few texts repeat. Of pairs alike by 0.8 half are right: a text
resembles another one or two, not those of all rooms. Of pairs alike by 0.5 a third are right, and radio cannot tell
many of the others apart: they hang a few metres from each other.

Signs of `departments` are like that: two neighbouring rooms belong to one department, a door bears its room's number
and the department ("A301 OPTICS LAB", "A302 OPTICS LAB"), the evacuation plan behind it the same and "PLAN", and what
repeats (exits, fire cabinets or hydrants) hangs in the first and the last room only, and in the corridor. With them
goes radio that loses less in walls than drawn: identical sets of transmitters (beta = 1) in two of three pairs of one
place ask for transmitters that are heard well everywhere. Both were chosen by the print's columns of #01 alone, and of
what fits alike within the spread of walks this is the simplest; #02 follows them.

Signs `as-drawn` are the maps' own: every room repeats the same one or two texts, and all other texts are unlike, which
is harder for text alone and easier for text and radio together.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence

import numpy as np

from twc_env.config import EnvConfig, override
from twc_env.maps import load_map
from twc_env.random_streams import random_stream
from twc_env.reproduce.routes import RoutePlanner, Walk, room_tour, walk
from twc_env.world.floorplan import Floorplan, Room, Sign

SCENES: dict[str, tuple[str, tuple[tuple[int, ...], ...]]] = {
    "#01": ("twin-01", ((0, 1, 2, 3), (3, 2, 1, 0))),
    "#02": ("twin-02", ((0, 2, 1, 4), (4, 6, 7, 5), (2, 3, 5, 4))),
}
"""Map, and the rooms that each robot visits in order."""
AS_DRAWN, DEPARTMENTS = SIGNS = ("as-drawn", "departments")
"""What is written on the walls."""
DEPARTMENT_ROOMS = 2
WALL_LOSS_SCALE = 0.7
"""Of the walls' losses as drawn, where signs are those of departments."""
STOP_SPREAD_M = 0.25
"""How far a robot's stops differ from one seed to the next."""
BEFORE_WALL_M = 0.2


def scene_config(scene: str) -> EnvConfig:
    """The default settings, on a scene's map with its robots."""
    map_name, orders = SCENES[scene]
    return EnvConfig(map=map_name, robots=len(orders))


def scene_plan(scene: str, signs: str) -> Floorplan:
    """The floor plan of a scene with one of SIGNS on its walls."""
    plan = load_map(SCENES[scene][0])
    return plan if signs == AS_DRAWN else with_departments(plan)


def with_departments(plan: Floorplan) -> Floorplan:
    """The plan with the signs of departments; the last room is the corridor, which keeps its own."""
    rooms = plan.rooms[:-1]
    texts = [sign.text for sign in plan.signs]
    kept = []
    for sign in plan.signs:
        k = _room_of(sign, rooms)
        if texts.count(sign.text) > 1:
            if k in (None, 0, len(rooms) - 1):
                kept.append(sign)
        elif k is None:
            kept.append(sign)
        else:
            door = room_text(rooms, k)
            kept.append(dataclasses.replace(sign, text=door if sign.text == rooms[k].name else f"{door} PLAN"))
    return dataclasses.replace(plan, signs=tuple(kept))


def room_text(rooms: Sequence[Room], k: int) -> str:
    """A room's own number and the name of its department's first room."""
    number, first = rooms[k].name.split(" ", 1)[0], rooms[k - k % DEPARTMENT_ROOMS]
    return f"{number} {first.name.split(' ', 1)[1]}"


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
    if signs == DEPARTMENTS:
        config = override(config, {"radio.wall_loss_scale": WALL_LOSS_SCALE})
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
