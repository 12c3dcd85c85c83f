"""Signs and access points on maps: placed by seed on maps without any, or at given places."""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray as Array
from scipy.spatial import cKDTree

from twc_env.records.geometry import farthest_first
from twc_env.records.random_streams import random_stream
from twc_env.world.building.floorplan import SIGN_FACE_M, SIGN_FRONT_M, AccessPoint, Floorplan, Sign, local_macs
from twc_env.world.building.floorplan_check import hangs_well, validate

AREA_PER_ACCESS_POINT_M2 = 25.0
ACCESS_POINTS_MIN, ACCESS_POINTS_MAX = 6, 40
ACCESS_POINT_CLEARANCE_M = 0.4
AREA_PER_LABEL_M2 = 20.0
AREA_PER_REPEATED_SIGN_M2 = 40.0
SIGN_SPACING_M = 1.5
REPEATED = ("EXIT", "FIRE EXTINGUISHER")
"""Texts of repeated signs, as in every building, which mislead text-only place recognition."""
_WALL_STEP_M = 0.5
_STAIR_REACH_M, _STAIR_REACH_PIXELS = 0.6, 6.0
"""The direction of a slanted wall is fitted to its stairs this far around a place."""
_STAIR_DEPTH_M, _STAIR_DEPTH_PIXELS = 0.15, 2.3
"""Stairs of a straight wall, both faces of a thin one included, lie within this depth; those at a corner do not."""
_STAIR_TRIES = 50
"""Places tried per sign."""
_STAIR_ROUNDS = 4
_POOL_MAX = 300_000
"""On larger floors only every second, third, ... cell is a candidate for an access point."""
_NOUNS = (
    "ARCHIVE", "BAKERY", "CERAMICS", "DARKROOM", "ELECTRONICS", "FOUNDRY", "GREENHOUSE", "HERBARIUM", "INTAKE",
    "JOINERY", "KITCHEN", "LIBRARY", "MAILROOM", "NURSERY", "OPTICS", "PHARMACY", "QUIET STUDY", "RECORDS", "SEMINAR",
    "TEXTILES", "UTILITY", "VAULT", "WORKSHOP", "X-RAY", "YOGA", "ZOOLOGY",
)  # fmt: skip


def furnish(plan: Floorplan, seed: int = 0) -> Floorplan:
    """The plan with unique room labels, repeated signs and access points, which depend only on the seed."""
    random = random_stream(seed, "furnish")
    _, signs = place_signs(plan, random)
    return dataclasses.replace(plan, signs=signs, access_points=place_access_points(plan, random))


def furnish_picture(plan: Floorplan, seed: int, pixel_m: float, pose: Array) -> Floorplan:
    """`furnish` for a plan made of pixels of this size, which then moves by `pose` (3,).

    Slanted walls are stairs of pixels there; they get the signs for which the straight walls have no place. So do signs
    that lose theirs as the building moves, beside a corner or in a narrow floor.
    """
    random = random_stream(seed, "furnish")
    texts, signs = place_signs(plan, random)
    plan = dataclasses.replace(plan, access_points=place_access_points(plan, random))
    moved, random = _moved(plan, pose), random_stream(seed, "furnish-stairs")
    for number in range(_STAIR_ROUNDS):
        turned = _moved(dataclasses.replace(plan, signs=signs), pose).signs
        is_sound = [hangs_well(moved, sign) for sign in turned]
        texts += [sign.text for sign, stays in zip(signs, is_sound, strict=True) if not stays]
        signs = tuple(sign for sign, stays in zip(signs, is_sound, strict=True) if stays)
        if not texts or number == _STAIR_ROUNDS - 1:
            break
        more = _signs_on_stairs(plan, texts, signs, pixel_m, random)
        signs, texts = signs + more, texts[len(more) :]
    return _moved(dataclasses.replace(plan, signs=signs), pose)


def _moved(plan: Floorplan, pose: Array) -> Floorplan:
    return plan.moved(pose) if np.any(pose) else plan


def place_signs(plan: Floorplan, random: np.random.Generator) -> tuple[list[str], tuple[Sign, ...]]:
    """Signs on walls that face free space, some metres apart: about one unique label per 20 m2 of floor.

    Returns also the texts for which the walls have no place.
    """
    cells = plan.cells()
    area_m2 = cells.free.sum() * cells.resolution_m**2
    places, facings = _wall_faces(plan)
    order = _spread(places, random, SIGN_SPACING_M)
    label_count = max(4, round(area_m2 / AREA_PER_LABEL_M2))
    repeat_count = max(2, round(area_m2 / AREA_PER_REPEATED_SIGN_M2))
    texts = [room_label(i) for i in range(label_count)]
    texts += [text for text in REPEATED for _ in range(repeat_count)]
    texts = [texts[i] for i in random.permutation(len(texts))]
    signs = tuple(Sign(text, places[i], float(facings[i])) for text, i in zip(texts, order, strict=False))
    return texts[len(signs) :], signs


def place_access_points(
    plan: Floorplan, random: np.random.Generator, count: int | None = None
) -> tuple[AccessPoint, ...]:
    """Access points far from each other over the free space, with 2 or 3 addresses each.

    `count` of them, or one per 25 m2, at least 6 and at most 40.
    """
    cells = plan.cells()
    free = np.argwhere(cells.free)
    if not len(free):
        validate(plan)  # says why nothing is free
    area_m2 = len(free) * cells.resolution_m**2
    if count is None:
        count = int(np.clip(round(area_m2 / AREA_PER_ACCESS_POINT_M2), ACCESS_POINTS_MIN, ACCESS_POINTS_MAX))
    centres = cells.centre_of(free[:: 1 + len(free) // _POOL_MAX])
    gaps_m = plan.wall_index.distance_m(centres, ACCESS_POINT_CLEARANCE_M)
    centres = centres[gaps_m >= min(ACCESS_POINT_CLEARANCE_M, gaps_m.max())]
    pool = centres[random.permutation(len(centres))[:4000]]
    chosen = pool[farthest_first(pool, count)]
    boxes = random.choice(1 << 16, size=len(chosen), replace=False)
    return tuple(
        AccessPoint(f"ap-{i + 1:02d}", position, local_macs(box, int(random.integers(2, 4))))
        for i, (position, box) in enumerate(zip(chosen, boxes, strict=True))
    )


def hung_sign(plan: Floorplan, text: str, at: Array, normal: Array) -> Sign | None:
    """A sign at this point of a wall, or None if there is no open floor in front of it."""
    front = at + SIGN_FRONT_M * normal
    if not plan.cells().is_free(np.stack([front, at + 2 * SIGN_FRONT_M * normal])).all():
        return None
    face = at + SIGN_FACE_M * normal
    if plan.wall_index.crossing(front, face[None])[0][0] or plan.wall_index.distance_m(at[None], 0.3)[0] >= 0.1:
        return None
    return Sign(text, at, float(np.arctan2(normal[1], normal[0])))


def room_label(number: int) -> str:
    """The label of room `number`, unique for every number."""
    wing, place = divmod(number, 40)
    noun = _NOUNS[(number * 7) % len(_NOUNS)]
    second = (number // len(_NOUNS)) % len(_NOUNS)
    tail = f" {_NOUNS[(number * 7 + 3 + second) % len(_NOUNS)]}" if number >= len(_NOUNS) else ""
    return f"{chr(65 + wing % 26)}{101 + place + 100 * (wing // 26)} {noun}{tail}"


def _wall_faces(plan: Floorplan) -> tuple[Array, Array]:
    """Possible places of signs: (k, 2) points on walls, (k,) directions into the free space in front."""
    begins, ends = plan.walls_m[:, 0], plan.walls_m[:, 1]
    lengths = np.linalg.norm(ends - begins, axis=1)
    walls, places = [], []
    for i in np.flatnonzero(lengths >= _WALL_STEP_M):
        count = int(lengths[i] / _WALL_STEP_M)
        share = (np.arange(count)[:, None] + 0.5) / count
        places.append(begins[i] + share * (ends[i] - begins[i]))
        walls.append(np.full(count, i))
    if not walls:
        return np.zeros((0, 2)), np.zeros(0)
    wall, place = np.concatenate(walls), np.concatenate(places)
    along = (ends[wall] - begins[wall]) / lengths[wall, None]
    normal = np.column_stack([-along[:, 1], along[:, 0]])
    wall, place, normal = np.tile(wall, 2), np.tile(place, (2, 1)), np.concatenate([normal, -normal])
    cells = plan.cells()
    is_open = cells.is_free(place + SIGN_FRONT_M * normal) & cells.is_free(place + 2 * SIGN_FRONT_M * normal)
    place, normal = place[is_open], normal[is_open]
    fronts, faces = place + 2 * SIGN_FRONT_M * normal, place + SIGN_FACE_M * normal
    crossed = [plan.wall_index.crossing(front, face[None])[0][0] for front, face in zip(fronts, faces, strict=True)]
    is_seen = np.array(crossed, int) == 0
    return place[is_seen], np.arctan2(normal[is_seen, 1], normal[is_seen, 0])


def _signs_on_stairs(
    plan: Floorplan, texts: list[str], hung: tuple[Sign, ...], pixel_m: float, random: np.random.Generator
) -> tuple[Sign, ...]:
    """Signs with the first of these texts on walls of any direction, away from those that hang already."""
    ends = plan.walls_m
    lengths, middles = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1), ends.mean(axis=1)
    pieces = np.ceil(lengths / pixel_m).astype(int)  # a wall of n pixels is n points
    wall = np.repeat(np.arange(len(ends)), pieces)
    share = (np.arange(len(wall)) - np.repeat(np.cumsum(pieces) - pieces, pieces) + 0.5) / pieces[wall]
    points = ends[wall, 0] + share[:, None] * (ends[wall, 1] - ends[wall, 0])
    tree = cKDTree(points)
    reach_m = max(_STAIR_REACH_M, _STAIR_REACH_PIXELS * pixel_m)
    depth_m = max(_STAIR_DEPTH_M, _STAIR_DEPTH_PIXELS * pixel_m)
    taken: list[Array] = [sign.position_m for sign in hung]
    signs: list[Sign] = []
    for i in random.permutation(len(ends))[: _STAIR_TRIES * len(texts)]:
        if len(signs) == len(texts):
            break
        if taken and (np.linalg.norm(np.array(taken) - middles[i], axis=1) < SIGN_SPACING_M + reach_m / 2).any():
            continue
        offsets = points[tree.query_ball_point(middles[i], reach_m)] - middles[i]
        _, axes = np.linalg.eigh(np.cov(offsets.T))
        along, across = offsets @ axes[:, 1], offsets @ axes[:, 0]
        if np.ptp(across) > depth_m or min(-along.min(), along.max()) < reach_m / 2:
            continue
        for normal, depths in ((axes[:, 0], across), (-axes[:, 0], -across)):
            # In front of the outermost stair, so that none of them hides the sign.
            sign = hung_sign(plan, texts[len(signs)], middles[i] + depths.max() * normal, normal)
            if sign is not None:
                signs.append(sign)
                taken.append(sign.position_m)
                break
    return tuple(signs)


def _spread(places: Array, random: np.random.Generator, spacing_m: float) -> list[int]:
    """Indices of places in random order, each at least `spacing_m` from all before it."""
    order: list[int] = []
    is_near = np.zeros(len(places), bool)
    for i in random.permutation(len(places)):
        if not is_near[i]:
            order.append(int(i))
            is_near |= np.linalg.norm(places - places[i], axis=1) < spacing_m
    return order
