"""Scripted walks through the true building, with the keyframes of the robots.

For tables that need data without exploration. The walker knows the map; results are the keyframes of the engine's front
end, and the ground truth for scoring.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray as Array
from scipy.ndimage import distance_transform_edt
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra

from twc_env.config import EnvConfig
from twc_env.errors import MapError
from twc_env.metrics import path_length_m
from twc_env.records.geometry import wrap_angle
from twc_env.records.messages import Keyframe
from twc_env.slam.robot import FrontEnds
from twc_env.world.building.floorplan import Floorplan, Room
from twc_env.world.world import World

CLEARANCE_M = 0.32
"""Minimum distance of routes from walls."""
FROM_WALL_M = 1.0
"""Distance of the tour of a room from its walls."""
CRUISE_M_S = 0.8
LEGS_AT_ONCE = 6
"""Number of random stops added at a time until the path is long enough."""
AIM_AHEAD_M = 0.5
PASS_GAP_S = 3.0
"""A sign that was out of view for longer begins a new pass."""
SIGN_PASS_RANGE_M = 3.0
"""A pass counts if the sign was read within this distance (papers.md T3)."""


@dataclass(frozen=True, slots=True, eq=False)
class SignPass:
    """One pass of a robot by a sign: the reading at the closest approach, and the ground truth."""

    keyframe: Keyframe
    """The keyframe of the reading, with no other sign."""
    sign: int
    """Index of the true sign in the plan."""
    position_m: Array
    """(2,) true position of the sensor."""


@dataclass(slots=True, eq=False)
class Walk:
    """The keyframes of one robot, and the ground truth."""

    keyframes: list[Keyframe] = field(default_factory=list)
    poses: list[Array] = field(default_factory=list)
    """(keyframes) of (3,) true poses."""
    sign_passes: list[SignPass] = field(default_factory=list)
    travel_m: float = 0.0


class RoutePlanner:
    """Shortest paths over the open floor of a plan at a distance from walls."""

    def __init__(self, plan: Floorplan, resolution_m: float = 0.1):
        self._cells = plan.cells(resolution_m)
        clear = distance_transform_edt(self._cells.free) * self._cells.resolution_m >= CLEARANCE_M
        cells = np.argwhere(clear)
        if len(cells) == 0:
            raise MapError(f"map {plan.name!r} has no floor {CLEARANCE_M} m clear of walls; routes need some")
        number = np.full(np.add(clear.shape, 2), -1)  # with a rim of cells that are not clear
        number[1:-1, 1:-1][clear] = np.arange(len(cells))
        links = []
        for dr, dc in ((0, 1), (1, 0), (1, 1), (1, -1)):
            other = number[cells[:, 0] + 1 + dr, cells[:, 1] + 1 + dc]
            known = np.flatnonzero(other >= 0)
            links.append((known, other[known], np.full(len(known), math.hypot(dr, dc))))
        first, second, length = (np.concatenate(parts) for parts in zip(*links, strict=True))
        self._graph = coo_array((length, (first, second)), shape=(len(cells),) * 2).tocsr()
        self._centres_m = self._cells.centre_of(cells)

    def nearest(self, point_m: Array) -> int:
        """The clear cell nearest to a point."""
        return int(np.argmin(((self._centres_m - point_m) ** 2).sum(axis=1)))

    def route(self, stops_m: Sequence[Array]) -> Array:
        """(points, 2) a path through the stops in order, in steps of a cell."""
        stops = [self.nearest(np.asarray(stop)) for stop in stops_m]
        way = [stops[0]]
        for goal in stops[1:]:
            if goal == way[-1]:
                continue
            _, before = dijkstra(self._graph, directed=False, indices=goal, return_predecessors=True)
            while way[-1] != goal:
                step = int(before[way[-1]])
                if step < 0:
                    raise MapError(f"no way from {self._centres_m[way[-1]]} to {self._centres_m[goal]}; open a door")
                way.append(step)
        return self._centres_m[way]

    def wander(self, length_m: float, random: np.random.Generator) -> Array:
        """(points, 2) a path between random places of the open floor, of at least this length."""
        floor_m = self._cells.centre_of(np.argwhere(self._cells.free))
        way = np.zeros((0, 2))
        while path_length_m(way) < length_m:
            stops = floor_m[random.integers(0, len(floor_m), LEGS_AT_ONCE)]
            way = np.concatenate([way, self.route([*way[-1:], *stops])])
        return way


def room_tour(room: Room, clockwise: bool = False) -> list[Array]:
    """Stops along the inside of a room's walls."""
    low, high = room.polygon_m.min(axis=0), room.polygon_m.max(axis=0)
    inset = np.minimum(FROM_WALL_M, 0.3 * (high - low))
    (x0, y0), (x1, y1) = low + inset, high - inset
    corners = [np.array(c) for c in ((x0, y0), (x1, y0), (x1, y1), (x0, y1))]
    return corners[::-1] if clockwise else corners


def walk(config: EnvConfig, plan: Floorplan, way_m: Array, robot: int, seed: int) -> Walk:
    """Drive one robot along a path (points, 2); its keyframes have the number `robot`.

    It is alone, because the trajectories of the paper were recorded one after the other.
    """
    config = dataclasses.replace(config, robots=1)
    world = World(config, plan)
    heading = math.atan2(*(way_m[5] - way_m[0])[::-1])
    world.reset(1000 * seed + robot, starts=np.array([[*way_m[0], heading]]))
    front_end = FrontEnds(config, 1)
    result, passes, waiting, at = Walk(), _Passes(), [], 0
    limit = 20 * int(path_length_m(way_m) / (CRUISE_M_S * config.dynamics.time_step_s) + 100)
    for _ in range(limit):
        (frame,) = world.sense()
        pose = world.poses[0]
        readings = list(zip(frame.signs, world.sighted_signs[0], strict=True))
        waiting += [(reading, sign, pose[:2].copy(), frame.time_s) for reading, sign in readings]
        frames, _ = front_end.intake.on_circle([frame])
        for keyframe in front_end.update(frames):
            keyframe = dataclasses.replace(keyframe, robot=robot)
            result.keyframes.append(keyframe)
            result.poses.append(pose.copy())
            for observation, (reading, sign, position, time_s) in zip(keyframe.signs, waiting, strict=True):
                single = dataclasses.replace(keyframe, signs=(observation,))
                passes.add(SignPass(single, sign, position), reading.range_m, time_s)
            waiting = []
        command, at = steer(pose, way_m, at, config)
        if command is None:
            break
        world.step(np.array([command]))
    result.sign_passes = passes.finished()
    result.travel_m = result.keyframes[-1].travel_m
    return result


class _Passes:
    """Groups readings of the same sign into passes and keeps the nearest reading of each."""

    def __init__(self):
        self._open: dict[int, tuple[float, float, SignPass]] = {}
        self._done: list[tuple[float, SignPass]] = []

    def add(self, sign_pass: SignPass, range_m: float, time_s: float) -> None:
        held = self._open.get(sign_pass.sign)
        if held is not None and time_s - held[0] > PASS_GAP_S:
            self._done.append(held[1:])
            held = None
        if held is None or range_m < held[1]:
            held = (time_s, range_m, sign_pass)
        self._open[sign_pass.sign] = (time_s, *held[1:])

    def finished(self) -> list[SignPass]:
        """The passes in order of time."""
        passes = self._done + [held[1:] for held in self._open.values()]
        near = [sign_pass for range_m, sign_pass in passes if range_m <= SIGN_PASS_RANGE_M]
        return sorted(near, key=lambda s: (s.keyframe.index, s.sign))


def steer(
    pose: Array, way_m: Array, at: int, config: EnvConfig, ahead_m: float = AIM_AHEAD_M
) -> tuple[tuple[float, float] | None, int]:
    """Speed and turn rate towards a point ahead on the path, or None at its end, and the updated path index `at`."""
    reach = way_m[at : at + 12]
    at += int(np.argmin(((reach - pose[:2]) ** 2).sum(axis=1)))
    if at >= len(way_m) - 2:
        return None, at
    ahead = at
    while ahead < len(way_m) - 1 and np.hypot(*(way_m[ahead] - way_m[at])) < ahead_m:
        ahead += 1
        if ahead - at > 8:
            break
    dx, dy = way_m[ahead] - pose[:2]
    error = float(wrap_angle(math.atan2(dy, dx) - pose[2]))
    turn_rate = np.clip(2.5 * error, -1, 1) * config.dynamics.turn_rate_max_rad_s
    return (CRUISE_M_S * max(0.0, 1.0 - abs(error) / 0.8), float(turn_rate)), at
