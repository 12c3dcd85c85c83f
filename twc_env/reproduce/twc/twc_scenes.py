"""The two scenes of TWC-SLAM's tables: floor plans, signs, and routes of the robots.

The paper does not state the signs of its scenes, but its text columns constrain them. On #01 four of five pairs of
equal texts are correct: few texts repeat. Half of the pairs with similarity 0.8 are correct: a text resembles one or
two others, not those of all rooms. A third of the pairs with similarity 0.5 are correct, and radio cannot separate many
of the others: they are a few metres apart.

Signs `departments` meet this: two neighbouring rooms belong to one department; a door has the number of its room and
the department ("A301 OPTICS LAB", "A302 OPTICS LAB"), the evacuation plan behind it the same text and "PLAN"; repeated
signs (exits, fire cabinets or hydrants) are only in the first and the last room and in the corridor. With these signs
the wall loss is reduced, because equal sets of transmitters (beta = 1) in two of three pairs of the same place require
transmitters that are received well everywhere. Both were chosen from the published columns of #01 only, as the simplest
of equally good choices within the spread of walks; #02 uses the same.

Signs `as-drawn` are those of the maps: every room repeats the same one or two texts, and all other texts are
dissimilar, which is harder for text alone and easier for text and radio together.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence

import numpy as np

from twc_env.config import TEAM_PRESETS, EnvConfig, override, robot_configs
from twc_env.maps import load_map
from twc_env.records.random_streams import random_stream
from twc_env.reproduce.routes import RoutePlanner, Walk, room_tour, walk
from twc_env.world.building.floorplan import Floorplan, Room, Sign

SCENES: dict[str, tuple[str, tuple[tuple[int, ...], ...]]] = {
    "#01": ("twin-01", ((0, 1, 2, 3), (3, 2, 1, 0))),
    "#02": ("twin-02", ((0, 2, 1, 4), (4, 6, 7, 5), (2, 3, 5, 4))),
}
"""Map, and the rooms that each robot visits in order."""
AS_DRAWN, DEPARTMENTS = SIGNS = ("as-drawn", "departments")
"""Sets of signs."""
DEPARTMENT_ROOMS = 2
WALL_LOSS_SCALE = 0.7
"""Factor on the wall losses with signs of departments."""
STOP_SPREAD_M = 0.25
"""Standard deviation of the stops of a robot between seeds."""
BEFORE_WALL_M = 0.2


def scene_config(scene: str) -> EnvConfig:
    """The default settings with the map and number of robots of a scene."""
    map_name, orders = SCENES[scene]
    return EnvConfig(map=map_name, robots=len(orders))


def mixed_config(scene: str) -> EnvConfig:
    """The same for the paper's own team, as many of its robots as the scene has: handheld, wheeled, legged."""
    config = scene_config(scene)
    return override(config, {"robot": list(TEAM_PRESETS["twc-slam"][: config.robots])})


def scene_plan(scene: str, signs: str) -> Floorplan:
    """The floor plan of a scene with one of SIGNS."""
    plan = load_map(SCENES[scene][0])
    return plan if signs == AS_DRAWN else with_departments(plan)


def with_departments(plan: Floorplan) -> Floorplan:
    """The plan with the signs of departments; the last room is the corridor, whose signs are kept."""
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
    """The number of a room and the name of the first room of its department."""
    number, first = rooms[k].name.split(" ", 1)[0], rooms[k - k % DEPARTMENT_ROOMS]
    return f"{number} {first.name.split(' ', 1)[1]}"


def _room_of(sign: Sign, rooms: Sequence[Room]) -> int | None:
    """The room of a sign, inside or at its door outside; None for signs of the corridor."""
    ahead_m = BEFORE_WALL_M * np.array([math.cos(sign.facing_rad), math.sin(sign.facing_rad)])
    for point_m in (sign.position_m + ahead_m, sign.position_m - ahead_m):
        for k, room in enumerate(rooms):
            low, high = room.polygon_m.min(axis=0), room.polygon_m.max(axis=0)
            if (low < point_m).all() and (point_m < high).all():
                return k
    return None


def walk_scene(config: EnvConfig, scene: str, signs: str, seed: int) -> list[Walk]:
    """The walks of all robots: through their rooms and back to the start; the last room of the plan is the corridor."""
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
        walks.append(walk(robot_configs(config)[robot], plan, planner.route([start, *jittered, start]), robot, seed))
    return walks
