"""How commands move robots: discs on wheels in a rigid-body world (pymunk), stopped by walls and by each other."""

from __future__ import annotations

import math

import numpy as np
import pymunk
from numba import njit
from numpy.typing import NDArray
from pymunk import batch

from twc_env.config import DynamicsConfig

Array = NDArray

_MASS_KG = 10.0
_STRIDE_RADII = 0.25
"""A substep moves a robot by at most this many of its radii, so that it cannot step over a wall."""
_SLOP_M = 1e-3
"""How far bodies may overlap without being pushed apart."""
_PENETRATION_KEPT_PER_S = 1e-6
_ROBOT = 1
"""Collision type of robots; walls have 0."""
_READ = batch.BodyFields.POSITION | batch.BodyFields.ANGLE | batch.BodyFields.VELOCITY
_WRITE = batch.BodyFields.VELOCITY | batch.BodyFields.ANGULAR_VELOCITY


class Dynamics:
    """All robots of one episode and the walls around them."""

    def __init__(self, config: DynamicsConfig, walls_m: Array, starts: Array):
        """Walls (w, 2, 2) and start poses (n, 3) in one frame; the robots begin at rest."""
        self._space = _walled_space(walls_m)
        self._space.on_collision(_ROBOT, None, post_solve=self._note_contact)
        starts = np.asarray(starts, float)
        for index, pose in enumerate(starts):
            _add_robot(self._space, index, pose, config.robot_radius_m)
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
        self.contacts = np.zeros(len(starts), bool)
        """(n,) whether the robot touched a wall or a robot in the last step."""

    def step(self, commands: Array) -> None:
        """Advance one time step; commands (n, 2) are forward speed [m/s] and turn rate [rad/s], cut to the limits."""
        self.contacts = np.zeros(self._count, bool)
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
        _unpack(bodies, self.poses, self._speeds)

    def _note_contact(self, arbiter: pymunk.Arbiter, space: pymunk.Space, data: object) -> None:
        for shape in arbiter.shapes:
            if shape.collision_type == _ROBOT:
                self.contacts[shape.body.robot] = True


def _walled_space(walls_m: Array) -> pymunk.Space:
    space = pymunk.Space()
    space.collision_slop = _SLOP_M
    space.collision_bias = _PENETRATION_KEPT_PER_S
    space.add(*(pymunk.Segment(space.static_body, a, b, 0.0) for a, b in np.asarray(walls_m, float).tolist()))
    return space


def _add_robot(space: pymunk.Space, index: int, pose: Array, radius_m: float) -> None:
    # An infinite moment of inertia: contacts push a robot, they never turn it. Nothing rubs (friction is 0).
    body = pymunk.Body(_MASS_KG, math.inf)
    body.position, body.angle = (float(pose[0]), float(pose[1])), float(pose[2])
    body.robot = index
    disc = pymunk.Circle(body, radius_m)
    disc.collision_type = _ROBOT
    space.add(body, disc)


@njit(cache=True, error_model="numpy")
def _unpack(bodies, poses, speeds):
    """x, y, heading and velocity x, y of each body -> poses and speeds ahead."""
    for i in range(poses.shape[0]):
        heading = bodies[i, 2]
        poses[i, 0], poses[i, 1] = bodies[i, 0], bodies[i, 1]
        poses[i, 2] = (heading + np.pi) % (2.0 * np.pi) - np.pi
        speeds[i] = bodies[i, 3] * np.cos(heading) + bodies[i, 4] * np.sin(heading)


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
