"""Cameras: signs in view of a robot and their viewing conditions."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.config import DynamicsConfig, SignsConfig
from twc_env.kernels.compiled import borrowing_kernel
from twc_env.records.messages import SignReading
from twc_env.records.random_streams import random_stream
from twc_env.world.building.floorplan import SIGN_FACE_M, Floorplan
from twc_env.world.building.wall_index import is_blocked
from twc_env.world.sensors.sign_readers import make_reader

CHARACTER_PITCH = 0.95
"""Width of a character [capital heights]."""
_SIGHT_COLUMNS = 6
_NO_ROBOTS = np.zeros((0, 3))
_ROBOT = DynamicsConfig()


class SignCamera:
    """One robot's camera and OCR for one episode."""

    def __init__(self, config: SignsConfig, plan: Floorplan, robot: int, seed: int, dynamics: DynamicsConfig = _ROBOT):
        self._config, self._walls = config, plan.wall_index.buckets()
        texts = tuple(sign.text for sign in plan.signs)
        normals = np.array([(math.cos(s.facing_rad), math.sin(s.facing_rad)) for s in plan.signs]).reshape(-1, 2)
        faces = np.array([s.position_m for s in plan.signs]).reshape(-1, 2) + SIGN_FACE_M * normals
        self._signs = np.column_stack([faces, normals])  # (signs, 4)
        self._lengths = np.array([len(text) for text in texts], np.int64)
        self._sights = np.empty((len(texts), _SIGHT_COLUMNS))
        self._hidden = np.zeros((len(texts), max(map(len, texts), default=0)), np.bool_)
        self._constants, self._radius_m = optics_of(config, dynamics.time_step_s), dynamics.robot_radius_m
        self._noise = bearing_stream(seed, robot)
        self._reader = make_reader(config, texts, robot, seed)

    def read(
        self, pose: Array, previous: Array | None = None, robots: Array | None = None
    ) -> tuple[tuple[SignReading, ...], tuple[int, ...]]:
        """Readings at a true pose (3,), and the true signs (plan numbers) behind them.

        A sign is in view if its centre is within range and field of view, at a small enough incidence angle and behind
        no wall. previous: pose one time step before, for motion blur (default: no motion); robots (k, 3): poses of
        robots that may occlude characters, with or without this one.
        """
        hiding = robots if self._config.robots_hide and robots is not None else _NO_ROBOTS
        count = look(
            *self._walls, self._signs, self._lengths, self._constants, pose, pose if previous is None else previous,
            hiding, np.full(len(hiding), self._radius_m), self._sights, self._hidden,
        )  # fmt: skip
        return self.read_sights(self._sights[:count], self._hidden) if count else ((), ())

    def read_sights(self, sights: Array, hidden: Array) -> tuple[tuple[SignReading, ...], tuple[int, ...]]:
        """The same from the outputs of `look`: sights (k, 6), hidden (>= k, characters)."""
        config, rows = self._config, sights.tolist()
        signs = [int(row[0]) for row in rows]
        readings, sources = [], []
        noise = self._noise.standard_normal(2 * len(rows)).tolist()
        for k, text in enumerate(self._reader.read(signs, sights, hidden)):
            if not text:
                continue
            bearing = rows[k][2] + config.bearing_noise_std_rad * noise[2 * k]
            distance = max(rows[k][1] + config.range_noise_std_m * noise[2 * k + 1], 0.0)
            readings.append(SignReading(text, math.remainder(bearing, 2 * math.pi), distance))
            sources.append(signs[k])
        return tuple(readings), tuple(sources)

    @property
    def seen(self) -> tuple[Array, Array]:
        """The signs (k, 4) and lengths (k,) of their texts, as `look` takes them; equal for all robots."""
        return self._signs, self._lengths

    def allocate(self, robots: int) -> tuple[Array, Array]:
        """Outputs of `look` for each robot: sights (robots, signs, 6), hidden (robots, signs, characters)."""
        return np.empty((robots, *self._sights.shape)), np.zeros((robots, *self._hidden.shape), np.bool_)


def optics_of(config: SignsConfig, time_step_s: float) -> Array:
    """(6,) what `look` needs to know of a camera."""
    return np.array(
        [
            config.legible_m,
            0.5 * config.field_of_view_rad,
            math.cos(config.incidence_max_rad),
            config.exposure_s * config.focal_length_px / time_step_s,
            config.focal_length_px * config.character_height_m,
            CHARACTER_PITCH * config.character_height_m,
        ]
    )


def bearing_stream(seed: int, robot: int) -> np.random.Generator:
    """Random stream of a robot's bearing and distance errors."""
    return random_stream(seed, "camera", robot)


@borrowing_kernel
def look(
    walls, origin, bucket, rows, columns, first, members, signs, lengths, constants, pose, previous, robots, radii,
    sights, hidden,
):  # fmt: skip
    """Fill one row of sights (see `SignReader.read`) and hidden for each sign in view; returns their count.

    robots (k, 3): poses of robots of these radii (k,), which may hide characters.
    """
    range_max, half_view, cos_incidence = constants[0], constants[1], constants[2]
    x, y, heading, count = pose[0], pose[1], pose[2], 0
    moved_x, moved_y = x - previous[0], y - previous[1]
    turn = (heading - previous[2] + math.pi) % (2.0 * math.pi) - math.pi
    for i in range(signs.shape[0]):
        dx, dy = signs[i, 0] - x, signs[i, 1] - y
        distance2 = dx * dx + dy * dy
        if distance2 > range_max * range_max or distance2 < 1e-12:
            continue
        distance = math.sqrt(distance2)
        if -(dx * signs[i, 2] + dy * signs[i, 3]) < cos_incidence * distance:
            continue
        bearing = math.atan2(dy, dx) - heading
        if abs((bearing + math.pi) % (2.0 * math.pi) - math.pi) > half_view:
            continue
        if is_blocked(walls, origin, bucket, rows, columns, first, members, x, y, signs[i, 0], signs[i, 1]):
            continue
        swing = turn + (dx * moved_y - dy * moved_x) / distance2
        sights[count, 0], sights[count, 1], sights[count, 2] = i, distance, bearing
        sights[count, 3] = constants[4] / distance
        sights[count, 4] = math.asin(min(max((dy * signs[i, 2] - dx * signs[i, 3]) / distance, -1.0), 1.0))
        sights[count, 5] = abs(swing) * constants[3]
        for m in range(lengths[i]):
            hidden[count, m] = False
        mark_hidden(signs[i], x, y, robots, radii, constants[5], hidden[count, : lengths[i]])
        count += 1
    return count


@borrowing_kernel
def mark_hidden(sign, x, y, robots, radii, pitch, is_hidden):
    """Set is_hidden (characters,) for the characters, from left to right, behind a robot other than the observer;
    robots (k, 2 or more): places, of radii (k,)."""
    count = is_hidden.shape[0]
    for m in range(count):
        along = (m + 0.5 - 0.5 * count) * pitch
        dx, dy = sign[0] - along * sign[3] - x, sign[1] + along * sign[2] - y
        distance2 = dx * dx + dy * dy
        for k in range(robots.shape[0]):
            ox, oy = robots[k, 0] - x, robots[k, 1] - y
            share = (ox * dx + oy * dy) / distance2
            if 0.0 < share < 1.0 and (ox - share * dx) ** 2 + (oy - share * dy) ** 2 < radii[k] * radii[k]:
                is_hidden[m] = True
                break
