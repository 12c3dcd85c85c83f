"""How commands move robots: discs on wheels in a rigid-body world (pymunk), stopped by walls and by each other."""

from __future__ import annotations

import math

import numpy as np
import pymunk
from numba import njit
from numpy.typing import NDArray
from pymunk import batch

from twc_env.config import DynamicsConfig
from twc_env.world.wall_index import WallIndex

Array = NDArray

_MASS_KG = 10.0
_STRIDE_RADII = 0.25
"""A substep moves a robot by at most this many of its radii, so that it cannot step over a wall."""
_SLOP_M = 1e-3
"""How far bodies may overlap without being pushed apart."""
_PENETRATION_KEPT_PER_S = 1e-6
_READ = batch.BodyFields.POSITION | batch.BodyFields.ANGLE | batch.BodyFields.VELOCITY
_WRITE = batch.BodyFields.VELOCITY | batch.BodyFields.ANGULAR_VELOCITY


class Dynamics:
    """All robots of one episode and the walls around them."""

    def __init__(self, config: DynamicsConfig, index: WallIndex, starts: Array):
        """Walls and start poses (n, 3) in one frame; the robots begin at rest."""
        self._space, self._index, self._radius_m = _walled_space(index.walls_m), index, config.robot_radius_m
        starts = np.asarray(starts, float)
        for pose in starts:
            _add_robot(self._space, pose, config.robot_radius_m)
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
        self._time_step_s = config.time_step_s
        self._count = len(starts)
        # Velocity x, y and turn rate of each body. pymunk lists the body that carries the walls after the robots.
        self._velocities = np.zeros((self._count + 1, 3))
        self._outgoing, self._incoming = batch.Buffer(), batch.Buffer()
        self._outgoing.set_float_buf(self._velocities)
        self._read_bodies()

    def step(self, commands: Array) -> None:
        """Advance one time step; commands (n, 2) are forward speed [m/s] and turn rate [rad/s], cut to the limits."""
        commands = np.asarray(commands, float)
        _drive(self.poses, self._speeds, commands, self._limits, self._time_step_s, self._velocities)
        batch.set_space_bodies(self._space, _WRITE, self._outgoing)
        for _ in range(self._substeps):
            self._space.step(self._time_step_s / self._substeps)
        self._read_bodies()

    def _read_bodies(self) -> None:
        self._incoming.clear()
        batch.get_space_bodies(self._space, _READ, self._incoming)
        bodies = np.frombuffer(self._incoming.float_buf()).reshape(self._count + 1, 5)
        self.poses, self._speeds = np.empty((self._count, 3)), np.empty(self._count)
        """poses: (n, 3) true poses, a new array with every step; speeds: (n,) along the heading [m/s]."""
        self.contacts = np.empty(self._count, np.bool_)
        """(n,) whether the robot touches a wall or a robot at the end of the step; a new array with every step."""
        i = self._index
        _unpack(
            bodies, i.walls_m, i.origin_m, i.bucket_m, *i.shape, i.first, i.members, self._radius_m,
            self.poses, self._speeds, self.contacts,
        )  # fmt: skip


def _walled_space(walls_m: Array) -> pymunk.Space:
    space = pymunk.Space()
    space.collision_slop = _SLOP_M
    space.collision_bias = _PENETRATION_KEPT_PER_S
    space.add(*(pymunk.Segment(space.static_body, a, b, 0.0) for a, b in walls_m.reshape(-1, 2, 2).tolist()))
    return space


def _add_robot(space: pymunk.Space, pose: Array, radius_m: float) -> None:
    # An infinite moment of inertia: contacts push a robot, they never turn it. Nothing rubs (friction is 0).
    body = pymunk.Body(_MASS_KG, math.inf)
    body.position, body.angle = (float(pose[0]), float(pose[1])), float(pose[2])
    space.add(body, pymunk.Circle(body, radius_m))


@njit(cache=True, error_model="numpy")
def _unpack(bodies, walls, origin, bucket, rows, columns, first, members, radius, poses, speeds, contacts):
    """x, y, heading and velocity x, y of each body -> poses, speeds ahead, and who touches something."""
    robots = poses.shape[0]
    for i in range(robots):
        x, y, heading = bodies[i, 0], bodies[i, 1], bodies[i, 2]
        poses[i, 0], poses[i, 1] = x, y
        poses[i, 2] = (heading + np.pi) % (2.0 * np.pi) - np.pi
        speeds[i] = bodies[i, 3] * np.cos(heading) + bodies[i, 4] * np.sin(heading)
        contacts[i] = _touches_wall(walls, origin, bucket, rows, columns, first, members, x, y, radius)
    for i in range(robots):
        for j in range(i):
            dx, dy = poses[i, 0] - poses[j, 0], poses[i, 1] - poses[j, 1]
            if dx * dx + dy * dy < 4.0 * radius * radius:
                contacts[i] = contacts[j] = True


@njit(cache=True, error_model="numpy")
def _touches_wall(walls, origin, bucket, rows, columns, first, members, x, y, radius):
    c0 = max(int(np.floor((x - radius - origin[0]) / bucket)), 0)
    c1 = min(int(np.floor((x + radius - origin[0]) / bucket)), columns - 1)
    r0 = max(int(np.floor((y - radius - origin[1]) / bucket)), 0)
    r1 = min(int(np.floor((y + radius - origin[1]) / bucket)), rows - 1)
    for r in range(r0, r1 + 1):
        for c in range(c0, c1 + 1):
            for m in range(first[r * columns + c], first[r * columns + c + 1]):
                w = members[m]
                ax, ay = x - walls[w, 0], y - walls[w, 1]
                ex, ey = walls[w, 2] - walls[w, 0], walls[w, 3] - walls[w, 1]
                t = min(max((ax * ex + ay * ey) / (ex * ex + ey * ey), 0.0), 1.0)
                dx, dy = ax - t * ex, ay - t * ey
                if dx * dx + dy * dy < radius * radius:
                    return True
    return False


@njit(cache=True, error_model="numpy")
def _drive(poses, speeds, commands, limits, time_step, velocities):
    """Wheel speeds towards the commands; a wall that stopped the robot has stopped its wheels too."""
    for i in range(poses.shape[0]):
        wanted = min(max(commands[i, 0], -limits[0]), limits[0])
        speed = min(max(wanted, speeds[i] - limits[2]), speeds[i] + limits[2])
        turn_rate = velocities[i, 2]
        wanted = min(max(commands[i, 1], -limits[1]), limits[1])
        turn_rate = min(max(wanted, turn_rate - limits[3]), turn_rate + limits[3])
        # Drive along the chord of the arc: half of the turn lies before it.
        chord = poses[i, 2] + 0.5 * turn_rate * time_step
        velocities[i, 0] = speed * np.cos(chord)
        velocities[i, 1] = speed * np.sin(chord)
        velocities[i, 2] = turn_rate
