"""Buildings that change between two sessions: boxes of furniture are moved, doors are shut or opened."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.records.random_streams import random_stream
from twc_env.world.building.floorplan import Floorplan, Room

AREA_PER_BOX_M2, BOXES_MAX = 8.0, 3
"""Floor of a room per box of furniture, and the most boxes in a room."""
BOX_LENGTH_M, BOX_DEPTH_M, BEHIND_M = (0.6, 1.4), (0.4, 0.7), 0.06
"""Ranges of the sides of a box, and its distance from the wall behind it."""
BOX_APART_M, BOX_SIGN_M, BOX_DOOR_M = 0.7, 0.7, 0.8
"""Least distances of a box from others, signs and doors: robots must pass, and read."""
BOX_DB, DOOR_DB = 2.0, 3.0
DOOR_M = (0.6, 1.7)
"""Widths of gaps between two walls in line that are doors."""
INSIDE_M = 0.4
"""This far from a shut door, on both sides, is floor."""
TRIES = 200


@dataclass(frozen=True, slots=True, eq=False)
class Fittings:
    """The movable parts of a building, in its home frame."""

    boxes_m: Array
    """(boxes, 4): x and y of the lower left and of the upper right corner."""
    room_of: Array
    """(boxes,) room of each."""
    doors_m: Array
    """(doors, 2, 2): both ends of each doorway."""
    is_shut: Array
    """(doors,) bool."""


def fitted(plan: Floorplan, seed: int) -> Fittings:
    """Furniture in the rooms of a plan, drawn by the seed, and its doors, all open."""
    random, home = random_stream(seed, "furniture " + plan.name), plan.home
    doors_m = doorways(home.walls_m)
    boxes: list[Array] = []
    rooms: list[int] = []
    for number, room in enumerate(home.rooms):
        for _ in range(_boxes_of(room)):
            box = _placed(home, room, np.array(boxes).reshape(-1, 4), doors_m, random)
            if box is not None:
                boxes.append(box)
                rooms.append(number)
    return Fittings(np.array(boxes).reshape(-1, 4), np.array(rooms, int), doors_m, np.zeros(len(doors_m), bool))


def changed(plan: Floorplan, before: Fittings, seed: int, moved_share: float, shut_share: float) -> Fittings:
    """The fittings after some time: this share of the boxes stands elsewhere in its room, this share of the doors is
    shut and all others are open."""
    random, home = random_stream(seed, "changes " + plan.name), plan.home
    boxes = before.boxes_m.copy()
    left = round(moved_share * len(boxes))
    for k in random.permutation(len(boxes)).tolist():
        if left == 0:
            break
        others = np.delete(boxes, k, axis=0)
        away = np.concatenate([others, before.boxes_m[k : k + 1]])  # not where it stood
        box = _placed(home, home.rooms[before.room_of[k]], away, before.doors_m, random)
        if box is not None:  # else there is no other place for it in the room
            boxes[k], left = box, left - 1
    is_shut = np.zeros(len(before.doors_m), bool)
    is_shut[random.permutation(len(is_shut))[: round(shut_share * len(is_shut))]] = True
    return Fittings(boxes, before.room_of, before.doors_m, is_shut)


def with_fittings(plan: Floorplan, fittings: Fittings) -> Floorplan:
    """The plan with its furniture and shut doors as walls. Radio shadows and noise stay those of the building."""
    home = plan.home
    (x0, y0, x1, y1), shut = fittings.boxes_m.T, fittings.doors_m[fittings.is_shut]
    corners = [np.stack([x, y], axis=1) for x, y in ((x0, y0), (x1, y0), (x1, y1), (x0, y1))]
    sides = np.concatenate([np.stack([corners[k], corners[(k + 1) % 4]], axis=1) for k in range(4)])
    walls_m = np.concatenate([home.walls_m, sides, shut])
    loss_db = np.concatenate([home.wall_loss_db, np.full(len(sides), BOX_DB), np.full(len(shut), DOOR_DB)])
    materials = home.wall_materials and (*home.wall_materials, *[""] * (len(walls_m) - len(home.walls_m)))
    middles_m, across_m = shut.mean(axis=1), (shut[:, 1] - shut[:, 0])[:, ::-1]
    across_m = INSIDE_M * across_m / np.linalg.norm(across_m, axis=1, keepdims=True)
    interior_m = np.concatenate([home.interior_m, middles_m + across_m, middles_m - across_m])  # shut rooms stay floor
    new = dataclasses.replace(
        home, walls_m=walls_m, wall_loss_db=loss_db, wall_materials=materials, interior_m=interior_m,
        subsampled_from=plan.origin,
    )  # fmt: skip
    return new.moved(plan.pose_building_home) if plan.pose_building_home.any() else new


def doorways(walls_m: Array) -> Array:
    """(doors, 2, 2) the gaps of a door's width between walls (walls, 2, 2) in line along x or y."""
    found = []
    for axis in (0, 1):
        along, across = walls_m[:, :, axis], walls_m[:, :, 1 - axis]
        is_along = np.abs(across[:, 0] - across[:, 1]) < 1e-6
        lines: dict[float, list[tuple[float, float]]] = {}
        for line, ends in zip(across[is_along, 0], along[is_along], strict=True):
            lines.setdefault(round(float(line), 3), []).append((float(ends.min()), float(ends.max())))
        for line, spans in sorted(lines.items()):
            spans.sort()
            reached = spans[0][1]
            for begin, end in spans[1:]:
                gap = np.array([[reached, line], [begin, line]])[:, :: 1 if axis == 0 else -1]
                if DOOR_M[0] <= begin - reached <= DOOR_M[1] and not _is_crossed(gap, walls_m):
                    found.append(gap)
                reached = max(reached, end)
    return np.array(found).reshape(-1, 2, 2)


def _is_crossed(gap: Array, walls_m: Array) -> bool:
    """Whether a wall ends or passes within a gap: then it is no doorway."""
    low, high = gap.min(axis=0) + 0.05, gap.max(axis=0) - 0.05
    low, high = np.minimum(low, high) - 0.02, np.maximum(low, high) + 0.02
    return bool(((walls_m.min(axis=1) <= high) & (walls_m.max(axis=1) >= low)).all(axis=1).any())


def _boxes_of(room: Room) -> int:
    width, depth = np.ptp(room.polygon_m, axis=0)
    return min(int(width * depth / AREA_PER_BOX_M2), BOXES_MAX)


def _placed(home: Floorplan, room: Room, others: Array, doors_m: Array, random: np.random.Generator) -> Array | None:
    """(4,) a box along a wall of the room, clear of others (k, 4), doors and signs; None if none is found."""
    low, high = room.polygon_m.min(axis=0), room.polygon_m.max(axis=0)
    signs_m = np.array([sign.position_m for sign in home.signs]).reshape(-1, 2)
    for _ in range(TRIES):
        side = int(random.integers(4))
        axis = side % 2  # the wall runs along it
        sides = np.empty(2)
        sides[axis], sides[1 - axis] = random.uniform(*BOX_LENGTH_M), random.uniform(*BOX_DEPTH_M)
        room_m = high - low - sides - 2 * BEHIND_M
        if (room_m < BOX_APART_M).any():
            continue
        corner = low + BEHIND_M + room_m * random.random(2)
        corner[1 - axis] = low[1 - axis] + BEHIND_M if side < 2 else high[1 - axis] - BEHIND_M - sides[1 - axis]
        box = np.concatenate([corner, corner + sides])
        is_clear = _gap_m(box, others) >= BOX_APART_M
        doors = np.concatenate([doors_m.min(axis=1), doors_m.max(axis=1)], axis=1).reshape(-1, 4)
        is_inside = home.cells().is_free(
            np.array([corner, corner + sides, corner + [sides[0], 0], corner + [0, sides[1]]])
        )
        walls = np.concatenate([home.walls_m.min(axis=1), home.walls_m.max(axis=1)], axis=1)
        if (
            is_clear.all() and is_inside.all() and (_gap_m(box, doors) >= BOX_DOOR_M).all()
            and (_gap_m(box, np.tile(signs_m, 2)) >= BOX_SIGN_M).all() and (_gap_m(box, walls) > 0.0).all()
        ):  # fmt: skip
            return box
    return None


def _gap_m(box: Array, others: Array) -> Array:
    """(k,) distance of a box (4,) from others (k, 4)."""
    apart = np.maximum(np.maximum(others[:, :2] - box[2:], box[:2] - others[:, 2:]), 0.0)
    return np.hypot(apart[:, 0], apart[:, 1])
