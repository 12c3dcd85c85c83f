"""Doors and furniture of one episode: where they are, who bumps into them, and what sensors notice of them."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.config.clutter import ClutterConfig
from twc_env.records.geometry import inverse, transform_points
from twc_env.records.random_streams import random_stream
from twc_env.world.building.floor_cells import Cells
from twc_env.world.building.floorplan import Floorplan
from twc_env.world.building.wall_index import is_blocked
from twc_env.world.clutter.contact import (
    ANGLE,
    CLOSED_RAD,
    COLUMNS,
    GOAL,
    HINGE_X,
    HINGE_Y,
    LEFT_S,
    LENGTH,
    OPEN_RAD,
    SIDE,
    away_from,
    bump,
    place_leaf,
    shorten,
    swing,
)
from twc_env.world.clutter.doorways import EGRESS_M, doorways_of
from twc_env.world.clutter.furniture import KINDS, LOW, Kind, Places, at, legs_of, sides_of
from twc_env.world.sensors.noise import NormalPools

_TIMES = 64
"""Times drawn per door, after which they repeat."""
_PLACES = 4
"""Places between which a piece is pushed."""
_LEAF_DISCS = 3
"""Discs in a row by which cameras and radio notice a leaf."""
_GAP_M = 0.02
"""Between the leaf and the frame."""
_MARGIN_M = 0.1
"""Floor this close to a piece is not scored either: about a cell of the map."""
_CLEAR_M = 0.5
_NO_WALKERS = np.zeros((0, 2))


class Clutter:
    """Moves doors and furniture; everything is in the home frame of the building."""

    def __init__(
        self, config: ClutterConfig, plan: Floorplan, robots: Array, radii_m: Array, time_step_s: float, seed: int
    ):
        """robots (r, 3): start poses; radii_m (r,): of each robot."""
        home = plan.home
        doorways = doorways_of(home)
        self._doors, times = _doors_of(config, home, doorways, robots, radii_m, random_stream(seed, "doors"))
        self._kinds, self._poses, self._is_low = _pieces_of(config, home, doorways, robots, seed)
        self._turn = np.zeros(len(self._kinds), np.int64)
        """Number of each piece's present place."""
        self._moves, self._chance = random_stream(seed, "furniture-moves"), config.moves_per_min * time_step_s / 60.0
        leaves = np.zeros((len(self._doors), 4))
        for k in range(len(leaves)):
            place_leaf(self._doors, k, self._doors[k, ANGLE], leaves)
        parts = [_parts(kind, low) for kind, low in zip(self._kinds, self._is_low, strict=True)]
        ends = [len(leaves) + np.cumsum([0, *(len(part[k]) for part in parts)]) for k in (0, 1)]
        self._rows = [[slice(a, b) for a, b in pairwise(end.tolist())] for end in ends]
        """Rows in `seen` and `rims` of each piece."""
        self._parts = parts
        self.seen = np.vstack([leaves, np.zeros((int(ends[0][-1]) - len(leaves), 4))])
        """(k, 4) ends [m] of what scanners see; the leaves come first."""
        self.rims = np.vstack([leaves, np.zeros((int(ends[1][-1]) - len(leaves), 4))])
        """(k, 4) ends [m] of what stops robots and people."""
        self._tall = np.array([k for k, kind in enumerate(self._kinds) if kind.is_tall and not self._is_low[k]], int)
        discs = _LEAF_DISCS * len(leaves) + len(self._tall)
        self.obstructions = np.tile([0.0, 0.0, 0.0, config.loss_db, math.inf], (discs, 1))
        """(k, 5) what hides signs and weakens signals, as of `sensors.mean_rssi.lose_in_bodies`; updated in place."""
        for piece in range(len(self._kinds)):
            self._put(piece)
        self._show_leaves()
        self.is_touched = np.zeros(len(robots), np.bool_)
        """(robots,) whether each robot drove against something in the last step."""
        self._radii_m, self._time_step_s = radii_m, time_step_s
        self._arrays = self._doors, times, np.zeros(len(leaves), np.int64)
        self._noise = NormalPools([random_stream(seed, "clutter-lidar", robot) for robot in range(len(robots))], 4096)
        self.cells = self._scored(plan)
        """The building's cells without the floor that is covered at some time; in the frame of the plan."""

    @property
    def hiding(self) -> Array:
        """(k, 3) x, y and radius [m] of what hides signs."""
        return self.obstructions[:, :3]

    @property
    def open_leaves(self) -> Array:
        """(doors, 4) ends [m] of the leaves when they are open."""
        leaves = np.zeros((len(self._doors), 4))
        for k in range(len(leaves)):
            place_leaf(self._doors, k, OPEN_RAD, leaves)
        return leaves

    def step(self, poses: Array, commands: Array, walkers: Array | None, state: Array, limits: Array) -> Array:
        """Advance one time step; poses (r, 3) of the robots before it. The commands (r, 2) that bumpers leave.

        walkers (k, 2): people who open doors. state, limits: of `Dynamics`; robots that are stopped lose their speed.
        """
        if self._chance:
            self._push(poses)
        if len(self._doors):
            walkers = _NO_WALKERS if walkers is None else walkers
            swing(*self._arrays, walkers, poses, self._radii_m, self._time_step_s, self.seen, self.rims)
            self._show_leaves()
        left = commands.copy()
        bump(self.rims, poses, state, limits, self._radii_m, self._time_step_s, left, self.is_touched)
        return left

    def meet(self, poses: Array) -> None:
        """Robots that bump are known from `step`."""

    def show(self, poses: Array, directions: Array, range_max_m: float, range_std_m: float, ranges: Array) -> None:
        """Shorten the ranges (r, beams) of beams that end at doors and furniture; directions (2, beams)."""
        now = self.seen, poses, directions, range_max_m, range_std_m, *self._noise.arguments, ranges
        while not shorten(*now):
            self._noise.refill(directions.shape[1])

    def is_clear(self, points_m: Array) -> Array:
        """(k, 2) points -> (k,) whether robots may be put down there: no piece comes near, and no door."""
        is_clear = np.ones(len(points_m), bool)
        for kind, poses in zip(self._kinds, self._poses, strict=True):
            for pose in poses:
                is_clear &= np.hypot(*(points_m - pose[:2]).T) > 0.5 * math.hypot(*kind.size_m) + _CLEAR_M
        for door in self._doors:
            is_clear &= np.hypot(*(points_m - door[:2]).T) > door[LENGTH] + _CLEAR_M
        return is_clear

    def _push(self, poses: Array) -> None:
        """Push pieces to their next places, at random times, unless a robot is there."""
        for piece in np.flatnonzero(self._moves.random(len(self._kinds)) < self._chance).tolist():
            places = self._poses[piece]
            turn = (self._turn[piece] + 1) % len(places)
            reach_m = 0.5 * math.hypot(*self._kinds[piece].size_m) + self._radii_m + _MARGIN_M
            if (np.hypot(*(poses[:, :2] - places[turn][:2]).T) > reach_m).all():
                self._turn[piece] = turn
                self._put(piece)

    def _put(self, piece: int) -> None:
        """Let a piece stand at its present place."""
        pose = self._poses[piece][self._turn[piece]]
        self.seen[self._rows[0][piece]] = at(pose, self._parts[piece][0])
        self.rims[self._rows[1][piece]] = at(pose, self._parts[piece][1])
        for k in np.flatnonzero(self._tall == piece).tolist():
            width_m, depth_m = self._kinds[piece].size_m
            self.obstructions[k - len(self._tall), :3] = *pose[:2], 0.25 * (width_m + depth_m)

    def _show_leaves(self) -> None:
        """Lay discs along the leaves."""
        count = len(self._doors)
        begin, extent = self.rims[:count, :2], self.rims[:count, 2:] - self.rims[:count, :2]
        for k in range(_LEAF_DISCS):
            rows = self.obstructions[k * count : (k + 1) * count]
            rows[:, :2] = begin + (k + 0.5) / _LEAF_DISCS * extent
            rows[:, 2] = 0.5 / _LEAF_DISCS * self._doors[:, LENGTH]

    def _scored(self, plan: Floorplan) -> Cells:
        cells = plan.cells()
        covered = np.zeros_like(cells.free)
        for kind, poses in zip(self._kinds, self._poses, strict=True):
            half = 0.5 * np.array(kind.size_m) + _MARGIN_M
            for pose in poses:
                _cover(covered, cells, plan, pose[:2], float(np.hypot(*half)), _Inside(pose, half))
        for door in self._doors:
            _cover(covered, cells, plan, door[:2], door[LENGTH] + _MARGIN_M, _Sector(door))
        covered &= cells.free
        return dataclasses.replace(cells, free=cells.free & ~covered, unscored=covered)


@dataclasses.dataclass(frozen=True, slots=True)
class _Inside:
    """Whether points lie in a rectangle at a pose."""

    pose: Array
    half: Array

    def __call__(self, points: Array) -> Array:
        own = transform_points(inverse(self.pose), points)
        return (np.abs(own) <= self.half).all(axis=-1)


@dataclasses.dataclass(frozen=True, slots=True)
class _Sector:
    """Whether points lie where a door leaf swings."""

    door: Array

    def __call__(self, points: Array) -> Array:
        offset = points - self.door[:2]
        away_m = np.hypot(offset[:, 0], offset[:, 1])
        turn = self.door[SIDE] * (np.arctan2(offset[:, 1], offset[:, 0]) - self.door[CLOSED_RAD])
        turn = (turn - 0.25 * math.pi + math.pi) % (2.0 * math.pi) - math.pi
        margin = np.arcsin(np.minimum(_MARGIN_M / np.maximum(away_m, 1e-9), 1.0))
        return (away_m <= self.door[LENGTH] + _MARGIN_M) & (np.abs(turn) <= 0.25 * math.pi + margin)


def _cover(covered: Array, cells: Cells, plan: Floorplan, centre: Array, reach_m: float, is_inside: Callable) -> None:
    """Mark the cells within reach_m of a place (home frame) that lie inside."""
    middle = transform_points(plan.pose_building_home, centre[None])[0]
    low, high = (np.floor((middle + side * reach_m - cells.origin_m) / cells.resolution_m) for side in (-1, 1))
    (c0, r0), (c1, r1) = np.maximum(low, 0).astype(int).tolist(), (np.maximum(high, -1).astype(int) + 1).tolist()
    window = covered[r0:r1, c0:c1]
    numbers = np.argwhere(np.ones_like(window))
    if len(numbers):
        points = transform_points(inverse(plan.pose_building_home), cells.centre_of(numbers + [r0, c0]))
        window |= is_inside(points).reshape(window.shape)


def _parts(kind: Kind, is_low: bool) -> tuple[Array, Array]:
    """Segments (k, 4) of a piece that scanners see, and that stop robots, around its middle."""
    sides = sides_of(kind.size_m)
    legs = legs_of(kind.size_m, kind.leg_m) if kind.leg_m else sides
    return (legs[:0] if is_low else legs), (legs if kind.is_passable else sides)


def _doors_of(
    config: ClutterConfig, home: Floorplan, doorways: Array, robots: Array, radii_m: Array, random: np.random.Generator
) -> tuple[Array, Array]:
    """Doors (d, columns) at the start, and times (d, k) for which each stays closed and open, in turns."""
    has_door = random.random(len(doorways)) < config.door_share
    is_turned, sides = random.random((2, len(doorways))) < 0.5
    means = np.tile([config.door_closed_mean_s, config.door_open_mean_s], _TIMES // 2)
    times = random.exponential(means, (len(doorways), _TIMES))
    share = config.door_open_mean_s / (config.door_open_mean_s + config.door_closed_mean_s)
    is_open, buckets = random.random(len(doorways)) < share, home.wall_index.buckets()
    found: list[tuple[Array, Array, Array]] = []
    """Each door, its times, and its leaf when it is open."""
    for k in np.flatnonzero(has_door).tolist():
        ends = doorways[k] if is_turned[k] else doorways[k, [2, 3, 0, 1]]
        along = ends[2:] - ends[:2]
        width_m = float(np.hypot(*along))
        door = np.zeros(COLUMNS)
        door[[HINGE_X, HINGE_Y]] = ends[:2] + _GAP_M * along / width_m
        door[CLOSED_RAD], door[LENGTH] = math.atan2(along[1], along[0]), width_m - 2.0 * _GAP_M
        door[ANGLE] = door[GOAL] = OPEN_RAD if is_open[k] else 0.0
        door[LEFT_S] = times[k, 1 if is_open[k] else 0]
        leaf, ways = np.zeros((1, 4)), []
        others = np.array([other for *_, other in found]).reshape(-1, 4)
        for side in (1.0, -1.0) if sides[k] else (-1.0, 1.0):
            door[SIDE] = side
            place_leaf(door[None], 0, OPEN_RAD, leaf)
            along = (leaf[0, 2:] - leaf[0, :2]) / door[LENGTH]
            begin = leaf[0, :2] + 0.1 * along
            is_free = home.cells().is_free(leaf[0, 2:]) and not is_blocked(*buckets, *begin, *leaf[0, 2:])
            way_m = _way_m(buckets, leaf[0, 2:], along) if is_free else 0.0
            ways.append((min(way_m, _apart_m(leaf, others)), side, leaf[0].copy()))
        for way_m, side, opened in ways:  # not into the way along a corridor
            door[SIDE] = side
            if way_m < EGRESS_M:
                continue
            place_leaf(door[None], 0, door[ANGLE], leaf)
            if all(away_from(leaf, 0, x, y) > r for (x, y, _), r in zip(robots, radii_m, strict=True)):
                found.append((door.copy(), times[k], opened))
                break
    doors, kept = np.array([door for door, *_ in found]), np.array([own for _, own, _ in found])
    return doors.reshape(-1, COLUMNS), kept.reshape(-1, _TIMES)


def _way_m(buckets: tuple, tip: Array, along: Array) -> float:
    """Least free way [m] beyond the tip of an open leaf, up to a metre to both sides, to 0.1 m, at most a metre."""
    across, way_m = 0.2 * np.array([-along[1], along[0]]), 1.0
    for side in (across, -across):
        begin = tip
        for _ in range(6):
            while way_m > 0.0 and is_blocked(*buckets, *begin, *(begin + way_m * along)):
                way_m -= 0.1
            if is_blocked(*buckets, *begin, *(begin + side)):
                break
            begin = begin + side
    return way_m


def _apart_m(leaf: Array, others: Array) -> float:
    """Distance [m] of an open leaf (1, 4) to the nearest of other open ones (k, 4) that point at it across the way."""
    along, theirs = leaf[0, 2:] - leaf[0, :2], others[:, 2:] - others[:, :2]
    points_back = theirs @ along < -0.5 * np.hypot(*theirs.T) * math.hypot(*along)
    opposite = others[points_back & ((others[:, :2] - leaf[0, :2]) @ along > 0.1 * math.hypot(*along))]
    apart = [away_from(leaf, 0, *end) for other in opposite for end in (other[:2], other[2:])]
    apart += [away_from(opposite, k, *end) for k in range(len(opposite)) for end in (leaf[0, :2], leaf[0, 2:])]
    return min(apart, default=math.inf)


def _pieces_of(
    config: ClutterConfig, home: Floorplan, doorways: Array, robots: Array, seed: int
) -> tuple[list[Kind], list[Array], list[bool]]:
    """Kind of each piece, the places (k, 3) between which it is pushed, and whether it lies below the scan."""
    random, places = random_stream(seed, "furniture"), None
    kinds, poses, lows = [], [], []
    for _ in range(config.furniture):
        places = places or Places(home, doorways, robots, random)
        is_low, kind = random.random() < config.hidden_share, KINDS[random.integers(len(KINDS))]
        kind = LOW if is_low else kind
        pose = places.room_for(kind)
        if pose is None:
            continue
        others = [places.room_for(kind, pose[:2]) for _ in range(_PLACES - 1 if config.moves_per_min else 0)]
        kinds.append(kind)
        poses.append(np.array([pose, *(other for other in others if other is not None)]))
        lows.append(bool(is_low))
    return kinds, poses, lows
