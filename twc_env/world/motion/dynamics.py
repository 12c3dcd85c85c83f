"""Robot dynamics: discs with differential drive; collisions with walls and robots are solved by pymunk."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

import numpy as np
import pymunk
from numpy.typing import NDArray as Array
from pymunk import batch

from twc_env.config import DynamicsConfig
from twc_env.kernels.compiled import borrowing_kernel
from twc_env.world.building.wall_index import WallIndex, gap

_MASS_KG = 10.0
_ANCHORED_KG = 1e6
_STRIDE_RADII = 0.25
"""Maximum motion per substep in robot radii, so that no robot passes through a wall."""
_SLOP_M = 1e-3
"""Overlap of bodies that is not corrected."""
_PENETRATION_KEPT_PER_S = 1e-6
_STATE = (
    batch.BodyFields.POSITION | batch.BodyFields.ANGLE | batch.BodyFields.VELOCITY | batch.BodyFields.ANGULAR_VELOCITY
)
_LOG_MAX = 4096
"""Number of logged events after which the rigid-body world is rebuilt; bounds the cost of a copy."""
_BOOL = np.dtype(np.bool_)
_TOLERANCE_M = 1e-6
"""Distance beyond a step's motion from which contact is excluded."""


class Dynamics:
    """The motion of all robots of one episode.

    The rigid-body world is used only in steps in which a contact is possible; otherwise the motion is integrated here.
    """

    def __init__(self, config: DynamicsConfig | Sequence[DynamicsConfig], index: WallIndex, starts: Array):
        """config: of all robots, or one for each; starts (n, 3): start poses in the frame of the walls; the robots
        begin at rest."""
        self._starts = np.array(starts, float)
        own = [config] * len(self._starts) if isinstance(config, DynamicsConfig) else config
        self.radii_m: Array = np.array([each.robot_radius_m for each in own])
        """(n,) radius of each robot."""
        self._space: pymunk.Space | None = None
        """Built before the first possible contact."""
        self._log: list[bytes | frozenset[int]] = []
        """Events since it was built: sets of anchored robots, and the states at the beginning of each of its steps.

        It has hidden state that cannot be copied, so a copy repeats the events."""
        self._anchored: set[int] = set()
        self._limits = np.array(
            [
                (
                    each.speed_max_m_s,
                    each.turn_rate_max_rad_s,
                    each.acceleration_max_m_s2 * each.time_step_s,
                    each.turn_acceleration_max_rad_s2 * each.time_step_s,
                )
                for each in own
            ]
        )
        self._time_step_s = own[0].time_step_s
        strides_m = np.array([each.speed_max_m_s * each.time_step_s for each in own])
        self._substeps = max(1, math.ceil((strides_m / (_STRIDE_RADII * self.radii_m)).max()))
        self._reaches_m = self.radii_m + strides_m + 2 * _TOLERANCE_M
        self._count = len(self._starts)
        # x, y, heading, velocity x, y and turn rate of each body, in pymunk's order; the last is the body of the walls.
        self._state = np.zeros((self._count + 1, 6))
        self._state[:-1, :3] = self._starts
        self._make_buffers()
        self._gaps = np.empty(self._count)
        """(n,) distance from each robot's centre to the nearest wall, limited to what one step can reach."""
        self._walls = index.buckets()
        self.poses: Array = np.empty((self._count, 3))
        """(n, 3) true poses, a new array with every step."""
        self.contacts: Array = np.empty(self._count, _BOOL)
        """(n,) bool: whether the robot touches a wall or a robot at the end of the step."""
        self.untouched: Array = np.zeros(self._count, _BOOL)
        """(n,) False: `contacts` of all steps without contact."""
        self._measure_gaps()

    def _make_buffers(self) -> None:
        self._outgoing, self._incoming = batch.Buffer(), batch.Buffer()
        self._outgoing.set_float_buf(self._state)

    def __getstate__(self) -> dict:
        kept = {key: value for key, value in self.__dict__.items() if key not in ("_outgoing", "_incoming")}
        return kept | {"_space": None, "_log": self._log.copy()}

    def __setstate__(self, state: dict) -> None:
        self.__dict__.update(state)
        self._make_buffers()

    @property
    def arguments(self) -> tuple:
        """Arguments of `advance` between the walls and the poses."""
        return (
            self._state, self._limits, self._time_step_s, self._substeps, self.radii_m, self._reaches_m, self._gaps,
        )  # fmt: skip

    def step(self, commands: Array) -> None:
        """Advance one time step; commands (n, 2): speed [m/s] and turn rate [rad/s], clipped to their limits."""
        poses = np.empty((self._count, 3))
        if advance(np.asarray(commands, float), *self._walls, *self.arguments, poses):
            self.poses, self.contacts = poses, self.untouched
        else:
            self.collide()

    def collide(self) -> None:
        """Advance in the rigid-body world, after `advance` has returned False."""
        space = self._space
        if len(self._log) >= _LOG_MAX:
            space, self._log = None, []
        if space is None:
            space = self._space = self._make_space()
        self._log.append(self._state.tobytes())
        self._advance_space(space, self._outgoing)
        self._incoming.clear()
        batch.get_space_bodies(space, _STATE, self._incoming)
        self._state[:] = np.frombuffer(self._incoming.float_buf()).reshape(self._count + 1, 6)
        self._measure_gaps()

    def put(self, robot: int, pose: Array) -> None:
        """Put a robot down at a pose (3,), at rest."""
        self._state[robot, :3], self._state[robot, 3:] = pose, 0.0
        self._measure_gaps()

    def anchor(self, robots: Iterable[int]) -> None:
        """Make these robots immovable by collisions from now on."""
        robots = set(robots) - self._anchored
        self._anchored |= robots
        if self._log and robots:
            self._log.append(frozenset(robots))
        if self._space is not None:
            _anchor(self._space, robots)

    def _make_space(self) -> pymunk.Space:
        """A rigid-body world after all logged events."""
        space = _space(self._walls[0], self._starts, self.radii_m)
        if not self._log:
            self._log.append(frozenset(self._anchored))
        for event in self._log:
            if isinstance(event, frozenset):
                _anchor(space, event)
            else:
                states = batch.Buffer()
                states.set_float_buf(bytearray(event))
                self._advance_space(space, states)
        return space

    def _advance_space(self, space: pymunk.Space, states: batch.Buffer) -> None:
        batch.set_space_bodies(space, _STATE, states)
        for _ in range(self._substeps):
            space.step(self._time_step_s / self._substeps)

    def _measure_gaps(self) -> None:
        self.poses, self.contacts = np.empty((self._count, 3)), np.empty(self._count, _BOOL)
        _locate(self._state, *self._walls, self._reaches_m, self._gaps, self.poses)
        _touch(self.poses, self._gaps, self.radii_m, self.contacts)


def _space(walls_m: Array, starts: Array, radii_m: Array) -> pymunk.Space:
    """A rigid-body world with the walls (k, 4) and with robots of these radii (n,) at their start poses (n, 3)."""
    space = pymunk.Space()
    space.collision_slop = _SLOP_M
    space.collision_bias = _PENETRATION_KEPT_PER_S
    space.collision_persistence = 1  # contacts of its last step are no hint: steps are skipped
    space.add(*(pymunk.Segment(space.static_body, a, b, 0.0) for a, b in walls_m.reshape(-1, 2, 2).tolist()))
    for (x, y, heading), radius_m in zip(starts.tolist(), radii_m.tolist(), strict=True):
        # Infinite moment of inertia, no friction: contacts push a robot but never turn it.
        body = pymunk.Body(_MASS_KG, math.inf)
        body.position, body.angle = (x, y), heading
        space.add(body, pymunk.Circle(body, radius_m))
    return space


def _anchor(space: pymunk.Space, robots: Iterable[int]) -> None:
    bodies = list(space.bodies)
    for robot in robots:
        bodies[robot].mass = _ANCHORED_KG


@borrowing_kernel
def accelerated(state, i, commands, limits, time_step):
    """Velocity x, y and turn rate of robot i in this step, as far as its limits allow what its command wants."""
    heading = state[i, 2]
    speed = state[i, 3] * np.cos(heading) + state[i, 4] * np.sin(heading)
    wanted = min(max(commands[i, 0], -limits[i, 0]), limits[i, 0])
    speed = min(max(wanted, speed - limits[i, 2]), speed + limits[i, 2])
    turn_rate = state[i, 5]
    wanted = min(max(commands[i, 1], -limits[i, 1]), limits[i, 1])
    turn_rate = min(max(wanted, turn_rate - limits[i, 3]), turn_rate + limits[i, 3])
    # The chord of the arc lies at the midpoint heading.
    chord = heading + 0.5 * turn_rate * time_step
    return speed * np.cos(chord), speed * np.sin(chord), turn_rate


@borrowing_kernel
def _drive_freely(state, commands, limits, time_step, substeps, gaps, radii):
    """Accelerate towards the commands; then move the robots if no contact is possible in this step. Whether they moved.

    The acceleration starts at the speed of the body, which contacts reduce.
    """
    robots = commands.shape[0]
    for i in range(robots):
        state[i, 3], state[i, 4], state[i, 5] = accelerated(state, i, commands, limits, time_step)
    for i in range(robots):
        stride = np.sqrt(state[i, 3] ** 2 + state[i, 4] ** 2) * time_step
        if gaps[i] <= radii[i] + stride + _TOLERANCE_M:
            return False
        for j in range(i):
            reach = (
                radii[i] + radii[j] + stride + np.sqrt(state[j, 3] ** 2 + state[j, 4] ** 2) * time_step + _TOLERANCE_M
            )
            if (state[i, 0] - state[j, 0]) ** 2 + (state[i, 1] - state[j, 1]) ** 2 <= reach * reach:
                return False
    for i in range(robots):
        for _ in range(substeps):
            for k in range(3):
                state[i, k] += state[i, 3 + k] * (time_step / substeps)
    return True


@borrowing_kernel
def _locate(state, walls, origin, bucket, rows, columns, first, members, reaches, gaps, poses):
    """Fill poses (n, 3), heading in [-pi, pi), and gaps (n,), distances to the nearest wall of at most reaches (n,)."""
    for i in range(poses.shape[0]):
        poses[i, 0], poses[i, 1] = state[i, 0], state[i, 1]
        poses[i, 2] = (state[i, 2] + np.pi) % (2.0 * np.pi) - np.pi
        gaps[i] = gap(walls, origin, bucket, rows, columns, first, members, state[i, 0], state[i, 1], reaches[i])


@borrowing_kernel
def _touch(poses, gaps, radii, contacts):
    """Fill contacts (n,): whether each robot touches a wall or another robot."""
    for i in range(poses.shape[0]):
        contacts[i] = gaps[i] < radii[i]
        for j in range(i):
            dx, dy = poses[i, 0] - poses[j, 0], poses[i, 1] - poses[j, 1]
            apart = radii[i] + radii[j]
            if dx * dx + dy * dy < apart * apart:
                contacts[i] = contacts[j] = True


@borrowing_kernel
def advance(
    commands, walls, origin, bucket, rows, columns, first, members, state, limits, time_step, substeps, radii, reaches,
    gaps, poses,
):  # fmt: skip
    """Advance one step and fill poses (n, 3) if no contact is possible; otherwise False, and only speeds change."""
    is_free = _drive_freely(state, commands, limits, time_step, substeps, gaps, radii)
    if is_free:
        _locate(state, walls, origin, bucket, rows, columns, first, members, reaches, gaps, poses)
    return is_free
