"""The people of one episode: where they are, and which robots touch them."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.config.people import PeopleConfig
from twc_env.errors import MapError
from twc_env.kernels.compiled import BindsAnew, Lent, bound
from twc_env.records.random_streams import random_stream
from twc_env.world.building.floorplan import Floorplan
from twc_env.world.clutter.doorways import EGRESS_M, doorways_of
from twc_env.world.motion.starts import start_places
from twc_env.world.people.destinations import destinations_of
from twc_env.world.people.sight import shorten
from twc_env.world.people.walking import (
    BODY_RADIUS_M,
    COLUMNS,
    FACING,
    GAIT,
    HOME_X,
    HOME_Y,
    LEFT,
    PAUSE,
    SEAT_RADIUS_M,
    SITTING,
    SPEED,
    STANDING,
    VX,
    VY,
    WALKING,
    X,
    Y,
    place_legs,
    touch,
    walk,
)
from twc_env.world.sensors.noise import NormalPools

HIDING_RADIUS_M = BODY_RADIUS_M
"""Half width of what a body hides from cameras and radio."""
_TRIPS = 64
"""Places drawn per person, after which they repeat."""
_FROM_ROBOTS_M = 1.0
"""Least distance of people to robots at the start ..."""
_APART_M = 0.5
"""... and to each other."""
_GROUP = 3
"""People who stand together, facing each other ..."""
_GROUP_RADIUS_M = 0.6
"""... on a circle of this radius."""
_SEAT_CLEARANCE_M = 0.9
"""People sit no further from a wall than this."""
_FROM_DOORWAYS_M = 0.8
"""Nobody sits or stands nearer to the middle of a doorway for the whole episode ..."""
_FROM_LEAVES_M = EGRESS_M + BODY_RADIUS_M
"""... or to an open leaf."""
_ROOM_M, _POCKET_M2 = 0.05, 1.0
"""People who sit leave this room on either side of the largest robot on its way past to more floor than this ..."""
_SEATS_TRIED = 50
"""... if one of so many places does."""
_SPEED_MIN_M_S = 0.3


class Crowd(BindsAnew):
    """Moves the people; everything is in the home frame of the building."""

    def __init__(
        self,
        config: PeopleConfig,
        home: Floorplan,
        robots: Array,
        robot_radius_m: float | Array,
        time_step_s: float,
        seed: int,
        rims: Array | None = None,
        leaves: Array | None = None,
    ):
        """robots (r, 3): start poses; robot_radius_m: of all robots, or of each (r,); rims (k, 4): ends of the sides of
        furniture and doors, updated in place; leaves (d, 4): ends of the doors when they are open.

        Raises MapError if the people do not fit into the building.
        """
        random, count = random_stream(seed, "people"), config.count
        radii_m = np.full(len(robots), robot_radius_m, float)
        ways = destinations_of(home, () if leaves is None else tuple(map(tuple, leaves.tolist())))
        self._state, self._kinds = _placed(config, home, robots, radii_m, random, leaves)
        trips = random.integers(0, max(len(ways.places_m), 1), (count, _TRIPS))
        pauses = random.exponential(config.pause_mean_s, (count, _TRIPS))
        # Some are on their way when the episode begins, the others still pause.
        self._state[:, PAUSE] = np.where(random.random(count) < 0.5, 0.0, pauses[:, -1])
        shape = len(robots), count
        self.discs = np.empty((2 * count, 3))
        """(2 people, 3) x, y [m] and radius [m] of the legs."""
        self.bodies = self._state[:, :2]
        """(people, 2) positions."""
        upright = self._state[self._kinds != SITTING, :2]
        self.hiding = np.column_stack([upright, np.full(len(upright), HIDING_RADIUS_M)])
        """(k, 3) x, y and radius [m] of the people who do not sit: they hide signs; updated in place."""
        self.obstructions = np.column_stack([
            self.hiding, np.tile([config.body_loss_db, 0.0], (len(upright), 1))
        ])[: len(upright) if config.body_loss_db else 0]  # fmt: skip
        """The same as of `sensors.mean_rssi.lose_in_bodies`, if they weaken signals."""
        self.is_touched = np.zeros(len(robots), np.bool_)
        """(robots,) whether each robot touches a person."""
        self.collisions = np.zeros(len(robots), np.int64)
        """(robots,) contacts with people that each robot began by driving."""
        self._arrays = (
            self._state, self._kinds, trips, np.zeros(count, np.int64), pauses, ways.distances_m, ways.origin_m,
            ways.cell_m, home.wall_index.buckets(), np.column_stack([robots[:, :2], np.zeros((len(robots), 2))]),
            radii_m, time_step_s, self.discs, np.zeros(shape, np.bool_), self.collisions,
            np.zeros((0, 4)) if rims is None else rims, self.hiding, self.obstructions,
        )  # fmt: skip
        self._noise = NormalPools([random_stream(seed, "people-lidar", robot) for robot in range(len(robots))], 4096)
        place_legs(self._state, self._kinds, self.discs)
        self._walk: Callable[..., None] | None = None
        self._touch: Callable[..., None] | None = None
        self._shorten: Callable[..., bool] | None = None
        """`walk`, `touch` and `shorten` bound to the arrays."""

    def __getstate__(self) -> dict:
        return super().__getstate__() | {"bodies": None}

    def __setstate__(self, state: dict) -> None:
        self.__dict__.update(state)
        self.bodies = self._state[:, :2]  # a view again

    @property
    def facing_rad(self) -> Array:
        """(people,) directions of the bodies."""
        return self._state[:, FACING]

    @property
    def walkers(self) -> Array:
        """(k, 2) positions of the people who walk."""
        return np.ascontiguousarray(self._state[self._kinds == WALKING, :2])

    def step(self, poses: Array, commands: Array) -> Array:
        """Advance one time step; poses (r, 3) of the robots before it. The commands (r, 2) that bumpers leave."""
        left = commands.copy()
        if self._walk is None:
            lent = Lent(self._arrays)
            self._walk = bound(walk, lent, poses, left)
        self._walk(poses, left)
        return left

    def meet(self, poses: Array) -> None:
        """Note who is touched by the robots, now at poses (r, 3)."""
        if self._touch is None:
            self._touch = bound(touch, Lent(self._arrays), poses, self.is_touched)
        self._touch(poses, self.is_touched)

    def show(self, poses: Array, directions: Array, range_max_m: float, range_std_m: float, ranges: Array) -> None:
        """Shorten the ranges (r, beams) of beams that end at legs; directions (2, beams) of the beams."""
        now = poses, directions, range_max_m, range_std_m, *self._noise.arguments, ranges
        if self._shorten is None:
            self._shorten = bound(shorten, self.discs, *now)
        while not self._shorten(*now):
            self._noise.refill(directions.shape[1])


def _placed(
    config: PeopleConfig,
    home: Floorplan,
    robots: Array,
    radii_m: Array,
    random: np.random.Generator,
    leaves: Array | None,
) -> tuple[Array, Array]:
    """State (people, columns) and kind (people,) of the people at the start of an episode."""
    count = config.count
    walking = round(config.walking_share * count)
    sitting = min(round(config.sitting_share * count), count - walking)
    kinds = np.array([WALKING] * walking + [SITTING] * sitting + [STANDING] * (count - walking - sitting), np.int64)
    places = start_places(home)
    places = places[random.permutation(len(places))]
    near_wall = home.wall_index.distance_m(places, _SEAT_CLEARANCE_M) < _SEAT_CLEARANCE_M
    doorways = doorways_of(home)
    apart_m = np.hypot(*(places[:, None] - 0.5 * (doorways[:, :2] + doorways[:, 2:])).transpose(2, 0, 1))
    is_beside = apart_m.min(axis=1, initial=np.inf) >= _FROM_DOORWAYS_M
    for x, y, end_x, end_y in () if leaves is None else leaves.tolist():
        along, offset = np.array([end_x - x, end_y - y]), places - (x, y)
        share = np.clip(offset @ along / max(along @ along, 1e-9), 0.0, 1.0)
        is_beside &= np.hypot(*(offset - share[:, None] * along).T) >= _FROM_LEAVES_M
    away = np.full(len(places), np.inf)
    """Distance of each place to what is already there."""
    for robot, radius_m in zip(robots, radii_m.tolist(), strict=True):
        away = np.minimum(away, np.hypot(*(places - robot[:2]).T) - (_FROM_ROBOTS_M + radius_m - _APART_M))
    state = np.zeros((count, COLUMNS))
    state[:, FACING] = random.uniform(-math.pi, math.pi, count)
    state[:, GAIT] = random.uniform(0.0, 2.0 * math.pi, count)
    wanted = config.speed_mean_m_s + config.speed_std_m_s * random.standard_normal(count)
    state[:, SPEED] = np.maximum(wanted, _SPEED_MIN_M_S)
    state[:, LEFT] = np.inf
    middle, standing = np.zeros(2), 0
    passages = _Passages(home, float(radii_m.max(initial=0.0)) + _ROOM_M) if sitting else None
    for i in range(count):
        is_free = (away >= _APART_M) & (is_beside | (kinds[i] == WALKING))
        if kinds[i] == SITTING:
            is_free = is_free & near_wall
        if kinds[i] == STANDING and standing % _GROUP:
            beside = np.abs(np.hypot(*(places - middle).T) - _GROUP_RADIUS_M) < 0.15
            is_free = is_free & beside if (is_free & beside).any() else is_free
        if not is_free.any():
            raise MapError(f"map {home.name!r} has no room for {count} people; reduce people.count")
        place = places[int(np.argmax(is_free))]
        if kinds[i] == SITTING and passages is not None:
            place = next(filter(passages.takes, places[is_free][:_SEATS_TRIED]), place)
        if kinds[i] == STANDING:
            if standing % _GROUP == 0:
                angle = state[i, FACING]
                middle = place + _GROUP_RADIUS_M * np.array([math.cos(angle), math.sin(angle)])
            standing += 1
            state[i, FACING] = math.atan2(middle[1] - place[1], middle[0] - place[0])
        state[i, [X, Y]], state[i, [HOME_X, HOME_Y]] = place, place
        state[i, [VX, VY]] = 0.0
        away = np.minimum(away, np.hypot(*(places - place).T))
    return state, kinds


class _Passages:
    """Where the middle of a robot may be, and whether it still gets everywhere when somebody sits down."""

    def __init__(self, home: Floorplan, radius_m: float):
        self._radius_m, self._cells = radius_m, home.cells()
        self._is_open = _open_floor(home, radius_m).copy()

    def takes(self, place: Array) -> bool:
        """Seat somebody at a place (2,) unless that cuts floor off."""
        from scipy import ndimage  # slow to import

        reach_m, cells = SEAT_RADIUS_M + self._radius_m, self._cells
        low = np.maximum(np.floor((place - reach_m - cells.origin_m) / cells.resolution_m).astype(int)[::-1], 0)
        high = np.floor((place + reach_m - cells.origin_m) / cells.resolution_m).astype(int)[::-1] + 1
        around = slice(low[0], high[0]), slice(low[1], high[1])
        is_open = self._is_open.copy()
        centres = cells.centre_of(np.moveaxis(np.indices(is_open[around].shape), 0, -1) + low)
        is_open[around] &= np.hypot(*np.moveaxis(centres - place, -1, 0)) >= reach_m
        before, _ = ndimage.label(self._is_open)
        after, _ = ndimage.label(is_open)
        for own in set(before[around].flat) - {0}:
            sizes = np.bincount(after[(before == own) & is_open])
            if sizes.sum() - sizes.max(initial=0) > _POCKET_M2 / cells.resolution_m**2:
                return False
        self._is_open = is_open
        return True


@lru_cache(maxsize=8)
def _open_floor(home: Floorplan, radius_m: float) -> Array:
    """(rows, columns) free cells whose centre is so far from all walls."""
    cells = home.cells()
    is_open = cells.free.copy()
    is_open[is_open] = home.wall_index.distance_m(cells.centre_of(np.argwhere(is_open)), radius_m) >= radius_m
    is_open.flags.writeable = False
    return is_open
