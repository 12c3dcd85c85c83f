"""Buildings of identical wings: the same rooms, doors and sign texts again and again along one corridor."""

from __future__ import annotations

import math

import numpy as np

from twc_env.records.random_streams import random_stream
from twc_env.world.building.floorplan import AccessPoint, Floorplan, Sign

CORRIDOR_M, DOOR_M = 2.0, 1.0
ROOM_TEXTS = ("OFFICE", "KITCHEN", "STORE", "LAB", "ARCHIVE")
MAC_FIRST = 0x02005E220010
WALL_LOSS_DB = 6.0
WINGS, ROOMS, ROOM_WIDTH_M, ROOM_DEPTH_M = (3, 6), (2, 4), (3.5, 6.0), (3.0, 5.0)
"""Ranges from which a building is drawn: wings, rooms of a wing on each side, and the size of a room."""


def alike_wings(seed: int, has_wifi: bool) -> Floorplan:
    """A corridor with rooms on both sides; every wing has the same rooms with the same signs.

    With WiFi, every wing has an access point at the same place, with an address of its own: the only thing that tells
    wings apart, besides the ends of the corridor.
    """
    draw = random_stream(seed, "alike wings")
    wings, rooms = int(draw.integers(*WINGS)), int(draw.integers(*ROOMS))
    width_m, depth_m = (round(float(draw.uniform(*reach)), 2) for reach in (ROOM_WIDTH_M, ROOM_DEPTH_M))
    length_m = wings * rooms * width_m
    top_m, bottom_m = CORRIDOR_M + depth_m, -depth_m
    walls = _box(0.0, bottom_m, length_m, top_m)
    signs: list[Sign] = []
    for k in range(wings * rooms):
        left_m, text = k * width_m, ROOM_TEXTS[k % rooms]
        door_m = left_m + width_m / 2 - DOOR_M / 2
        for side_m, back_m, facing in ((0.0, bottom_m, math.pi / 2), (CORRIDOR_M, top_m, -math.pi / 2)):
            walls += [((left_m, side_m), (door_m, side_m)), ((door_m + DOOR_M, side_m), (left_m + width_m, side_m))]
            if k:
                walls.append(((left_m, side_m), (left_m, back_m)))
            number = 1 if side_m == 0.0 else 2
            signs.append(Sign(f"{text} {number}", np.array([door_m - 0.4, side_m]), facing))
    points = [
        AccessPoint(f"AP {k}", np.array([(k + 0.5) * rooms * width_m, CORRIDOR_M / 2]), (MAC_FIRST + 256 * k,))
        for k in range(wings if has_wifi else 0)
    ]
    return Floorplan(
        f"{wings} wings of {2 * rooms} rooms",
        np.array(walls),
        np.full(len(walls), WALL_LOSS_DB),
        signs=tuple(signs),
        access_points=tuple(points),
        interior_m=np.array([[length_m / 2, CORRIDOR_M / 2]]),
    )


def _box(left_m: float, bottom_m: float, right_m: float, top_m: float) -> list:
    corners = [(left_m, bottom_m), (right_m, bottom_m), (right_m, top_m), (left_m, top_m)]
    return list(zip(corners, corners[1:] + corners[:1], strict=True))
