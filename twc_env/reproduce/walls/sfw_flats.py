"""Small generated flats of the size of the k-visibility twins, for choosing settings without using the twins."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.world.building.floorplan import AccessPoint, Floorplan
from twc_env.world.building.floorplan_check import validate

SIDE_M, SHORT_SIDE_M = (5.0, 11.5), (3.0, 6.0)
ROOM_MIN_M = 1.9
DOOR_M = (0.9, 1.2)
STUB_M = (0.5, 1.1)
INNER_DB, OUTER_DB = 9.0, 12.0
_FROM_WALL_M = 0.5
_TRIES = 30


def flat(seed: int, routers: int = 1) -> Floorplan:
    """A rectangle divided into rooms with a door in every division, short walls, and routers near opposite ends."""
    random = np.random.default_rng([seed, 20])
    size = np.array([random.uniform(*SIDE_M), random.uniform(*SHORT_SIDE_M)]).round(1)
    inner: list[Array] = []
    doors: list[Array] = []
    rooms = _cut(np.array([[0.0, 0.0], size]), random, inner, doors)
    for room in rooms:
        if random.random() < 0.4:
            inner += _stub(room, random, doors)
    (x0, y0), (x1, y1) = np.zeros(2), size
    corners = np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]])
    outer = np.stack([corners, np.roll(corners, -1, axis=0)], axis=1)
    ends = (rooms[np.argmin([r[0].sum() for r in rooms])], rooms[np.argmax([r[1].sum() for r in rooms])])
    places = [room[0] + random.uniform(0.25, 0.75, 2) * (room[1] - room[0]) for room in ends[:routers]]
    points = tuple(
        AccessPoint(f"router-{n + 1}", np.maximum(place, _FROM_WALL_M).round(2), (0x02005E130000 + n,))
        for n, place in enumerate(places)
    )
    return validate(
        Floorplan(
            name=f"flat-{seed}",
            walls_m=np.concatenate([outer, np.array(inner).reshape(-1, 2, 2)]),
            wall_loss_db=np.concatenate([np.full(4, OUTER_DB), np.full(len(inner), INNER_DB)]),
            interior_m=places[0][None],
            access_points=points,
        )
    )


def _cut(box: Array, random: np.random.Generator, inner: list[Array], doors: list[Array]) -> list[Array]:
    """Divide a box (2, 2) low, high recursively; walls (2, 2) and door gaps (2, 2) are appended to the lists."""
    extent = box[1] - box[0]
    axis = int(np.argmax(extent * random.uniform(0.8, 1.2, 2)))
    if extent[axis] < 2 * ROOM_MIN_M or extent[1 - axis] < 1.3 or random.random() < 0.1:
        return [box]
    for _ in range(_TRIES):
        at = round(float(random.uniform(box[0, axis] + ROOM_MIN_M, box[1, axis] - ROOM_MIN_M)), 1)
        ends = np.array([[at, box[0, 1 - axis]], [at, box[1, 1 - axis]]])
        ends = ends if axis == 0 else ends[:, ::-1]
        if all(_apart(door, ends) for door in doors):
            break
    else:
        return [box]
    width = float(random.uniform(*DOOR_M))
    along = random.uniform(0.0, extent[1 - axis] - width)
    low, high = box[0, 1 - axis], box[1, 1 - axis]
    begin = low + (0.0 if along < 0.35 else min(along, high - low - width))
    for first, last in ((low, begin), (begin + width, high)):
        if last - first > 0.3:
            wall = np.array([[at, first], [at, last]])
            inner.append(wall if axis == 0 else wall[:, ::-1])
    door = np.array([[at, begin], [at, begin + width]])
    doors.append(door if axis == 0 else door[:, ::-1])
    lower, upper = box.copy(), box.copy()
    lower[1, axis] = upper[0, axis] = at
    return _cut(lower, random, inner, doors) + _cut(upper, random, inner, doors)


def _apart(door: Array, ends: Array) -> bool:
    """Whether no end of a wall is near a door."""
    middle, half = door.mean(axis=0), float(np.linalg.norm(door[1] - door[0])) / 2
    return bool((np.linalg.norm(ends - middle, axis=1) > half + 0.5).all())


def _stub(room: Array, random: np.random.Generator, doors: list[Array]) -> list[Array]:
    """A short wall from the middle of one side into the room, if it leaves passages around it."""
    axis = int(random.integers(2))
    extent = room[1] - room[0]
    length = min(float(random.uniform(*STUB_M)), extent[1 - axis] - 0.9)
    if extent[axis] < 2 * ROOM_MIN_M - 1.0 or length < STUB_M[0]:
        return []
    at = float(room[0, axis] + extent[axis] * random.uniform(0.4, 0.6))
    begin = float(room[0, 1 - axis]) if random.random() < 0.5 else float(room[1, 1 - axis]) - length
    wall = np.array([[at, begin], [at, begin + length]]).round(2)
    wall = wall if axis == 0 else wall[:, ::-1]
    return [wall] if all(_apart(door, wall) for door in doors) else []
