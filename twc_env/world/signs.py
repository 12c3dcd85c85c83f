"""Which signs a robot's camera can read from where it stands, and how it sees them."""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from twc_env.config import DynamicsConfig, SignsConfig
from twc_env.messages import SignReading
from twc_env.random_streams import random_stream
from twc_env.world.floorplan import SIGN_FACE_M, Floorplan
from twc_env.world.sign_readers import Sight, make_reader

Array = NDArray

CHARACTER_PITCH = 0.95
"""Width of a character on a plate [capital heights]."""
_ROBOT = DynamicsConfig()


class SignCamera:
    """One robot's camera and OCR for one episode."""

    def __init__(self, config: SignsConfig, plan: Floorplan, robot: int, seed: int, dynamics: DynamicsConfig = _ROBOT):
        self._config, self._index = config, plan.wall_index
        self._time_step_s, self._robot_radius_m = dynamics.time_step_s, dynamics.robot_radius_m
        texts = tuple(sign.text for sign in plan.signs)
        normals = np.array([(math.cos(s.facing_rad), math.sin(s.facing_rad)) for s in plan.signs]).reshape(-1, 2)
        faces = np.array([s.position_m for s in plan.signs]).reshape(-1, 2) + SIGN_FACE_M * normals
        self._signs = np.column_stack([faces, normals])  # (signs, 4)
        self._visible = [np.zeros(len(text), np.bool_) for text in texts]
        self._range_max_m = min(
            config.range_max_m, config.focal_length_px * config.character_height_m / config.height_min_px
        )
        self._noise = random_stream(seed, "camera", robot)
        self._reader = make_reader(config, texts, robot, seed)

    def legible(self, pose: Array) -> tuple[int, ...]:
        """The signs whose middle is in view from a true pose (3,): near enough, not too oblique, behind no wall."""
        config = self._config
        candidates = np.empty(len(self._signs), np.int64)
        count = _in_view(
            self._signs, pose[0], pose[1], pose[2], self._range_max_m,
            0.5 * config.field_of_view_rad, math.cos(config.incidence_max_rad), candidates,
        )  # fmt: skip
        if count == 0:
            return ()
        near = candidates[:count]
        crossed, _ = self._index.crossing(pose, self._signs[near, :2])
        return tuple(near[crossed == 0].tolist())

    def read(
        self, pose: Array, previous: Array | None = None, robots: Array | None = None
    ) -> tuple[tuple[SignReading, ...], tuple[int, ...]]:
        """What OCR gives at a true pose (3,), and which signs (plan numbers) those readings truly are.

        One time step before, the camera was at `previous`; without it, it stands still. `robots` (k, 3), itself among
        them or not, may hide part of a text.
        """
        legible = self.legible(pose)
        if not legible:
            return (), ()
        config = self._config
        sights = [self._sight(sign, pose, previous, robots) for sign in legible]
        readings, sources = [], []
        for sight, text in zip(sights, self._reader.read(sights), strict=True):
            bearing_noise, range_noise = self._noise.standard_normal(2).tolist()
            if not text:
                continue
            bearing = sight.bearing_rad + config.bearing_noise_std_rad * bearing_noise
            distance = max(sight.distance_m + config.range_noise_std_m * range_noise, 0.0)
            readings.append(SignReading(text, math.remainder(bearing, 2 * math.pi), distance))
            sources.append(sight.sign)
        return tuple(readings), tuple(sources)

    def _sight(self, sign: int, pose: Array, previous: Array | None, robots: Array | None) -> Sight:
        config = self._config
        x, y, facing_x, facing_y = self._signs[sign].tolist()
        at_x, at_y, heading = pose.tolist()
        dx, dy = x - at_x, y - at_y
        distance = math.hypot(dx, dy)
        incidence = math.asin(min(max((dy * facing_x - dx * facing_y) / distance, -1.0), 1.0))
        blur_px = 0.0
        if previous is not None:
            from_x, from_y, from_heading = previous.tolist()
            turn = math.remainder(heading - from_heading, 2 * math.pi)
            swing = turn + (dx * (at_y - from_y) - dy * (at_x - from_x)) / distance**2
            blur_px = abs(swing) / self._time_step_s * config.exposure_s * config.focal_length_px
        is_hidden = self._visible[sign]
        if config.robots_hide and robots is not None and len(robots) > 1:
            is_hidden = np.zeros(len(is_hidden), np.bool_)
            pitch_m = CHARACTER_PITCH * config.character_height_m
            _hide(self._signs[sign], at_x, at_y, robots, self._robot_radius_m, pitch_m, is_hidden)
        height_px = config.focal_length_px * config.character_height_m / distance
        return Sight(sign, distance, math.atan2(dy, dx) - heading, height_px, incidence, blur_px, is_hidden)


@njit(cache=True, error_model="numpy")
def _in_view(signs, x, y, heading, range_max, half_view, cos_incidence, candidates):
    count = 0
    for i in range(signs.shape[0]):
        dx, dy = signs[i, 0] - x, signs[i, 1] - y
        distance2 = dx * dx + dy * dy
        if distance2 > range_max * range_max or distance2 < 1e-12:
            continue
        if -(dx * signs[i, 2] + dy * signs[i, 3]) < cos_incidence * np.sqrt(distance2):
            continue
        bearing = (np.arctan2(dy, dx) - heading + np.pi) % (2.0 * np.pi) - np.pi
        if abs(bearing) <= half_view:
            candidates[count] = i
            count += 1
    return count


@njit(cache=True, error_model="numpy")
def _hide(sign, x, y, robots, radius, pitch, is_hidden):
    """Which characters of a sign, from the reader's left to right, are behind a robot; the reader hides none."""
    count = is_hidden.shape[0]
    for m in range(count):
        along = (m + 0.5 - 0.5 * count) * pitch
        dx, dy = sign[0] - along * sign[3] - x, sign[1] + along * sign[2] - y
        distance2 = dx * dx + dy * dy
        for k in range(robots.shape[0]):
            ox, oy = robots[k, 0] - x, robots[k, 1] - y
            share = (ox * dx + oy * dy) / distance2
            if 0.0 < share < 1.0 and (ox - share * dx) ** 2 + (oy - share * dy) ** 2 < radius * radius:
                is_hidden[m] = True
                break
