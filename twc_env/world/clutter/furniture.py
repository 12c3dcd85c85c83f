"""Pieces of furniture: what they are made of at the height of a scanner, and where they stand."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.world.building.floorplan import Floorplan
from twc_env.world.building.wall_index import wall_beside
from twc_env.world.motion.starts import start_places

PASSAGE_M = 0.8
"""Robots can pass between a piece and walls, doors and other pieces."""
_FROM_ROBOTS_M = 0.6
"""Least distance of a piece's rim to a robot at the start."""
_WALL_REACH_M = 3.0
_MOVED_M = 1.5
"""Pieces are pushed this far at most."""
_TRIES = 20


@dataclass(frozen=True, slots=True)
class Kind:
    """One kind of furniture."""

    size_m: tuple[float, float]
    """Of the floor under it; the second, its depth, points away from a wall."""
    leg_m: float
    """Width of its four legs; 0: it has sides down to the floor."""
    is_passable: bool = False
    """Whether small robots fit between its legs."""
    is_tall: bool = False
    """Whether it hides signs."""


TABLE, CHAIR, BOX = (
    Kind((1.2, 0.7), 0.06, is_passable=True),
    Kind((0.44, 0.44), 0.03),
    Kind((0.8, 0.45), 0.0, False, True),
)
LOW = Kind((0.6, 0.4), 0.0)
"""Lies below the plane of the scan: a platform, a box of cables."""
KINDS = TABLE, CHAIR, CHAIR, BOX
"""Of which each piece is one, drawn at random."""


def sides_of(size_m: tuple[float, float]) -> Array:
    """(4, 4) ends of the sides of a rectangle around the origin."""
    x, y = 0.5 * size_m[0], 0.5 * size_m[1]
    corners = np.array([[-x, -y], [x, -y], [x, y], [-x, y]])
    return np.hstack([corners, np.roll(corners, -1, axis=0)])


def legs_of(size_m: tuple[float, float], leg_m: float) -> Array:
    """(8, 4) ends of both diagonals of four square legs in the corners of a rectangle around the origin: as wide from
    all sides as the legs, to a seventh."""
    x, y, half = 0.5 * (size_m[0] - leg_m), 0.5 * (size_m[1] - leg_m), 0.5 * leg_m
    corners = np.array([[-x, -y], [x, -y], [x, y], [-x, y]])
    crosses = np.array([[-half, -half, half, half], [-half, half, half, -half]])
    return (np.hstack([corners, corners])[:, None] + crosses).reshape(-1, 4)


def at(pose: Array, segments: Array) -> Array:
    """Segments (k, 4) of a piece that stands at a pose (3,)."""
    c, s = math.cos(pose[2]), math.sin(pose[2])
    turned = segments.reshape(-1, 2) @ np.array([[c, s], [-s, c]]) + pose[:2]
    return turned.reshape(-1, 4)


class Places:
    """Finds room for pieces in one building."""

    def __init__(self, home: Floorplan, doorways: Array, robots: Array, random: np.random.Generator):
        """doorways (d, 4); robots (r, 3): start poses."""
        self._buckets, self._cells, self._random = home.wall_index.buckets(), home.cells(), random
        places = start_places(home)
        self._places = places[random.permutation(len(places))]
        middles = 0.5 * (doorways[:, :2] + doorways[:, 2:])
        self._taken = np.vstack([
            np.column_stack([middles, np.full(len(middles), PASSAGE_M)]),
            np.column_stack([robots[:, :2], np.full(len(robots), _FROM_ROBOTS_M)]),
        ])  # fmt: skip
        """(k, 3) x, y and the least distance of a piece's rim."""

    def room_for(self, kind: Kind, beside: Array | None = None) -> Array | None:
        """A pose (3,) for a piece that leaves passages, from now on its own; near `beside` (2,), if given."""
        places = self._places
        if beside is not None:
            places = places[np.hypot(*(places - beside).T) < _MOVED_M]
        if not len(places):
            return None
        for place in places[self._random.integers(0, len(places), _TRIES)]:
            pose = self._fitted(kind, place)
            if pose is not None:
                radius_m = 0.5 * math.hypot(*kind.size_m)
                own = beside is not None and np.hypot(*(self._taken[:, :2] - beside).T) < 1e-9
                near_m = np.hypot(*(self._taken[:, :2] - pose[:2]).T) - self._taken[:, 2] - radius_m
                if (near_m[~own] if beside is not None else near_m).min(initial=np.inf) > 0.0:
                    self._taken = np.vstack([self._taken, [*pose[:2], radius_m + PASSAGE_M]])
                    return pose
        return None

    def _fitted(self, kind: Kind, place: Array) -> Array | None:
        """The pose of a piece at a place: with its back to the wall if that is near, otherwise free on all sides."""
        wx, wy, gap_m = wall_beside(*self._buckets, float(place[0]), float(place[1]), _WALL_REACH_M)
        width_m, depth_m = kind.size_m
        radius_m = 0.5 * math.hypot(width_m, depth_m)
        if gap_m >= radius_m + PASSAGE_M:
            return np.array([*place, self._random.uniform(-math.pi, math.pi)])
        if gap_m < 1e-9:
            return None
        normal = np.array([wx, wy]) / gap_m
        centre = place - (gap_m - 0.5 * depth_m - 0.02) * normal
        ahead = centre + (0.5 * depth_m + 0.5 * PASSAGE_M) * normal
        pose = np.array([*centre, math.atan2(-normal[0], normal[1])])
        corners = at(pose, sides_of((width_m, depth_m - 0.02)))[:, :2]
        if not self._cells.is_free(np.vstack([corners, ahead])).all():
            return None
        _, _, room_m = wall_beside(*self._buckets, float(ahead[0]), float(ahead[1]), _WALL_REACH_M)
        return pose if room_m >= 0.5 * PASSAGE_M - 0.01 else None
