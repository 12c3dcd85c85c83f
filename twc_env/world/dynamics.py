"""How commands move robots: discs on wheels in a rigid-body world (pymunk), stopped by walls and by each other."""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np
import pymunk
from numpy.typing import NDArray as Array
from pymunk import batch

from twc_env.config import DynamicsConfig
from twc_env.kernels import borrowing_kernel
from twc_env.world.wall_index import WallIndex, gap

_MASS_KG = 10.0
_ANCHORED_KG = 1e6
_STRIDE_RADII = 0.25
"""A substep moves a robot by at most this many of its radii, so that it cannot step over a wall."""
_SLOP_M = 1e-3
"""How far bodies may overlap without being pushed apart."""
_PENETRATION_KEPT_PER_S = 1e-6
_STATE = (
    batch.BodyFields.POSITION | batch.BodyFields.ANGLE | batch.BodyFields.VELOCITY | batch.BodyFields.ANGULAR_VELOCITY
)
_ASKED_MAX = 4096
"""After so many steps in it the rigid-body world is made anew, so that what a copy has to repeat stays bounded."""
_BOOL = np.dtype(np.bool_)
_CLEAR_M = 1e-6
"""Gaps larger than the step by this much are not closed in it."""


class Dynamics:
    """All robots of one episode and the walls around them.

    The rigid-body world is asked only in steps in which something could touch: what moves freely just moves on.
    """

    def __init__(self, config: DynamicsConfig, index: WallIndex, starts: Array):
        """Walls and start poses (n, 3) in one frame; the robots begin at rest."""
        self._radius_m, self._starts = config.robot_radius_m, np.array(starts, float)
        self._space: pymunk.Space | None = None
        """Made when something may touch for the first time: in many an episode nothing ever does."""
        self._asked: list[bytes | frozenset[int]] = []
        """All that happened to it since it was made: robots anchored, and the states it was asked to go on from.

        It keeps more from step to step than it tells, so a copy of it comes from doing the same again."""
        self._anchored: set[int] = set()
        self._limits = np.array(
            [
                config.speed_max_m_s,
                config.turn_rate_max_rad_s,
                config.acceleration_max_m_s2 * config.time_step_s,
                config.turn_acceleration_max_rad_s2 * config.time_step_s,
            ]
        )
        stride_m = config.speed_max_m_s * config.time_step_s
        self._substeps = max(1, math.ceil(stride_m / (_STRIDE_RADII * config.robot_radius_m)))
        self._time_step_s, self._reach_m = config.time_step_s, config.robot_radius_m + stride_m + 2 * _CLEAR_M
        self._count = len(self._starts)
        # x, y, heading, velocity x, y and turn rate of each body, as pymunk lists them; the last carries the walls.
        self._state = np.zeros((self._count + 1, 6))
        self._state[:-1, :3] = self._starts
        self._make_buffers()
        self._gaps = np.empty(self._count)
        """(n,) from each robot's middle to the nearest wall, cut where no step reaches."""
        self._walls = index.buckets()
        self.poses: Array = np.empty((self._count, 3))
        """(n, 3) true poses, a new array with every step."""
        self.contacts: Array = np.empty(self._count, _BOOL)
        """(n,) whether the robot touches a wall or a robot at the end of the step."""
        self.untouched: Array = np.zeros(self._count, _BOOL)
        """(n,) `contacts` of every step in which nobody touches anything."""
        self._look_around()

    def _make_buffers(self) -> None:
        self._outgoing, self._incoming = batch.Buffer(), batch.Buffer()
        self._outgoing.set_float_buf(self._state)

    def __getstate__(self) -> dict:
        kept = {key: value for key, value in self.__dict__.items() if key not in ("_outgoing", "_incoming")}
        return kept | {"_space": None, "_asked": self._asked.copy()}

    def __setstate__(self, state: dict) -> None:
        self.__dict__.update(state)
        self._make_buffers()

    @property
    def arguments(self) -> tuple:
        """What `advance` needs beside the walls, the commands and where the poses go."""
        return (
            self._state, self._limits, self._time_step_s, self._substeps, self._radius_m, self._reach_m, self._gaps,
        )  # fmt: skip

    def step(self, commands: Array) -> None:
        """Advance one time step; commands (n, 2) are forward speed [m/s] and turn rate [rad/s], cut to the limits."""
        poses = np.empty((self._count, 3))
        if advance(np.asarray(commands, float), *self._walls, *self.arguments, poses):
            self.poses, self.contacts = poses, self.untouched
        else:
            self.collide()

    def collide(self) -> None:
        """The step that `advance` has refused, in the rigid-body world."""
        space = self._space
        if len(self._asked) >= _ASKED_MAX:
            space, self._asked = None, []
        if space is None:
            space = self._space = self._make_space()
        self._asked.append(self._state.tobytes())
        self._ask(space, self._outgoing)
        self._incoming.clear()
        batch.get_space_bodies(space, _STATE, self._incoming)
        self._state[:] = np.frombuffer(self._incoming.float_buf()).reshape(self._count + 1, 6)
        self._look_around()

    def anchor(self, robots: Iterable[int]) -> None:
        """From now on nobody can push these robots: their brakes hold."""
        robots = set(robots) - self._anchored
        self._anchored |= robots
        if self._asked and robots:
            self._asked.append(frozenset(robots))
        if self._space is not None:
            _anchor(self._space, robots)

    def _make_space(self) -> pymunk.Space:
        """The rigid-body world as all that happened to it has left it."""
        space = _space(self._walls[0], self._starts, self._radius_m)
        if not self._asked:
            self._asked.append(frozenset(self._anchored))
        for event in self._asked:
            if isinstance(event, frozenset):
                _anchor(space, event)
            else:
                states = batch.Buffer()
                states.set_float_buf(bytearray(event))
                self._ask(space, states)
        return space

    def _ask(self, space: pymunk.Space, states: batch.Buffer) -> None:
        batch.set_space_bodies(space, _STATE, states)
        for _ in range(self._substeps):
            space.step(self._time_step_s / self._substeps)

    def _look_around(self) -> None:
        self.poses, self.contacts = np.empty((self._count, 3)), np.empty(self._count, _BOOL)
        _locate(self._state, *self._walls, self._reach_m, self._gaps, self.poses)
        _touch(self.poses, self._gaps, self._radius_m, self.contacts)


def _space(walls_m: Array, starts: Array, radius_m: float) -> pymunk.Space:
    """The walls, and robots where they start."""
    space = pymunk.Space()
    space.collision_slop = _SLOP_M
    space.collision_bias = _PENETRATION_KEPT_PER_S
    space.collision_persistence = 1  # steps are left out: what touched in the last one is no hint
    space.add(*(pymunk.Segment(space.static_body, a, b, 0.0) for a, b in walls_m.reshape(-1, 2, 2).tolist()))
    for x, y, heading in starts.tolist():
        # An infinite moment of inertia: contacts push a robot, they never turn it. Nothing rubs (friction is 0).
        body = pymunk.Body(_MASS_KG, math.inf)
        body.position, body.angle = (x, y), heading
        space.add(body, pymunk.Circle(body, radius_m))
    return space


def _anchor(space: pymunk.Space, robots: Iterable[int]) -> None:
    bodies = list(space.bodies)
    for robot in robots:
        bodies[robot].mass = _ANCHORED_KG


@borrowing_kernel
def _drive(state, commands, limits, time_step, substeps, gaps, radius):
    """Wheel speeds towards the commands; then, if no robot can touch anything in this step, move them.

    Whether it did. A wall that stopped the robot has stopped its wheels too: the speed is that of the body.
    """
    robots = commands.shape[0]
    for i in range(robots):
        heading = state[i, 2]
        speed = state[i, 3] * np.cos(heading) + state[i, 4] * np.sin(heading)
        wanted = min(max(commands[i, 0], -limits[0]), limits[0])
        speed = min(max(wanted, speed - limits[2]), speed + limits[2])
        turn_rate = state[i, 5]
        wanted = min(max(commands[i, 1], -limits[1]), limits[1])
        turn_rate = min(max(wanted, turn_rate - limits[3]), turn_rate + limits[3])
        # Drive along the chord of the arc: half of the turn lies before it.
        chord = heading + 0.5 * turn_rate * time_step
        state[i, 3] = speed * np.cos(chord)
        state[i, 4] = speed * np.sin(chord)
        state[i, 5] = turn_rate
    for i in range(robots):
        stride = np.sqrt(state[i, 3] ** 2 + state[i, 4] ** 2) * time_step
        if gaps[i] <= radius + stride + _CLEAR_M:
            return False
        for j in range(i):
            reach = 2.0 * radius + stride + np.sqrt(state[j, 3] ** 2 + state[j, 4] ** 2) * time_step + _CLEAR_M
            if (state[i, 0] - state[j, 0]) ** 2 + (state[i, 1] - state[j, 1]) ** 2 <= reach * reach:
                return False
    for i in range(robots):
        for _ in range(substeps):
            for k in range(3):
                state[i, k] += state[i, 3 + k] * (time_step / substeps)
    return True


@borrowing_kernel
def _locate(state, walls, origin, bucket, rows, columns, first, members, reach, gaps, poses):
    """Poses of the robots, and their distances to walls."""
    for i in range(poses.shape[0]):
        poses[i, 0], poses[i, 1] = state[i, 0], state[i, 1]
        poses[i, 2] = (state[i, 2] + np.pi) % (2.0 * np.pi) - np.pi
        gaps[i] = gap(walls, origin, bucket, rows, columns, first, members, state[i, 0], state[i, 1], reach)


@borrowing_kernel
def _touch(poses, gaps, radius, contacts):
    """Which robots touch a wall or each other."""
    for i in range(poses.shape[0]):
        contacts[i] = gaps[i] < radius
        for j in range(i):
            dx, dy = poses[i, 0] - poses[j, 0], poses[i, 1] - poses[j, 1]
            if dx * dx + dy * dy < 4.0 * radius * radius:
                contacts[i] = contacts[j] = True


@borrowing_kernel
def advance(
    commands, walls, origin, bucket, rows, columns, first, members, state, limits, time_step, substeps, radius, reach,
    gaps, poses,
):  # fmt: skip
    """`_drive` and, where nothing can be touched, `_locate`; whether that was so. Nobody touches anything then."""
    is_free = _drive(state, commands, limits, time_step, substeps, gaps, radius)
    if is_free:
        _locate(state, walls, origin, bucket, rows, columns, first, members, reach, gaps, poses)
    return is_free
