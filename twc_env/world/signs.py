"""Which signs a robot's camera can read from where it stands, and how OCR misreads them (SPEC T3)."""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from twc_env.config import SignsConfig
from twc_env.messages import SignReading
from twc_env.random_streams import random_stream
from twc_env.world.floorplan import SIGN_FACE_M, Floorplan

Array = NDArray

_CONFUSABLE = dict(zip("OISBAEZ" + "0158432", "0158432" + "OISBAEZ", strict=True))
_CONFUSABLE_SHARE = 0.7
"""Share of the substitutions that take the look-alike, where there is one."""
_SUBSTITUTION_SHARE, _DELETION_SHARE = 0.70, 0.15
"""Of all character errors; the rest are insertions."""
_FRAGMENT_MIN, _FRAGMENT_MAX = 0.10, 0.45
_ALPHABET = "ABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789"


class SignCamera:
    """One robot's camera and OCR for one episode."""

    def __init__(self, config: SignsConfig, plan: Floorplan, robot: int, seed: int):
        self._config, self._index = config, plan.wall_index
        self._texts = tuple(sign.text for sign in plan.signs)
        normals = np.array([(math.cos(s.facing_rad), math.sin(s.facing_rad)) for s in plan.signs]).reshape(-1, 2)
        faces = np.array([s.position_m for s in plan.signs]).reshape(-1, 2) + SIGN_FACE_M * normals
        self._signs = np.column_stack([faces, normals])  # (signs, 4)
        self._noise = random_stream(seed, "camera", robot)
        self._ocr = random_stream(seed, "ocr", robot)

    def legible(self, pose: Array) -> tuple[int, ...]:
        """The signs that can be read from a true pose (3,): in range and view, not too oblique, not hidden."""
        config = self._config
        candidates = np.empty(len(self._signs), np.int64)
        count = _in_view(
            self._signs, pose[0], pose[1], pose[2], config.range_max_m,
            0.5 * config.field_of_view_rad, math.cos(config.incidence_max_rad), candidates,
        )  # fmt: skip
        if count == 0:
            return ()
        near = candidates[:count]
        crossed, _ = self._index.crossing(pose, self._signs[near, :2])
        return tuple(near[crossed == 0].tolist())

    def read(self, pose: Array) -> tuple[tuple[SignReading, ...], tuple[int, ...]]:
        """What OCR gives at a true pose (3,), and which signs (plan numbers) those readings truly are."""
        readings, sources = [], []
        for sign in self.legible(pose):
            text = misread(self._texts[sign], self._config, self._ocr)
            bearing_noise, range_noise = self._noise.standard_normal(2)
            if not text.strip():
                continue
            dx, dy = self._signs[sign, 0] - pose[0], self._signs[sign, 1] - pose[1]
            bearing = math.atan2(dy, dx) - pose[2] + self._config.bearing_noise_std_rad * bearing_noise
            distance = max(math.hypot(dx, dy) + self._config.range_noise_std_m * range_noise, 0.0)
            readings.append(SignReading(text, float(math.remainder(bearing, 2 * math.pi)), float(distance)))
            sources.append(sign)
        return tuple(readings), tuple(sources)


def misread(text: str, config: SignsConfig, random: np.random.Generator) -> str:
    """One OCR reading of a text: sometimes a fragment, else single characters changed, lost or added (SPEC T3)."""
    if random.random() < config.fragment_probability:
        length = max(1, round(len(text) * random.uniform(_FRAGMENT_MIN, _FRAGMENT_MAX)))
        begin = int(random.integers(0, len(text) - length + 1))
        return text[begin : begin + length]
    wrong = random.random(len(text)) < config.character_error_probability
    if not wrong.any():
        return text
    return "".join(
        _wrong_character(character, random) if is_wrong else character
        for character, is_wrong in zip(text, wrong, strict=True)
    )


def _wrong_character(character: str, random: np.random.Generator) -> str:
    kind = random.random()
    if kind < _SUBSTITUTION_SHARE:
        return _substitute(character, random)
    if kind < _SUBSTITUTION_SHARE + _DELETION_SHARE:
        return ""
    return character + _any_character(random)


def _substitute(character: str, random: np.random.Generator) -> str:
    """A different character, more often than not the one that looks alike."""
    alike = _CONFUSABLE.get(character.upper())
    if alike and random.random() < _CONFUSABLE_SHARE:
        return alike
    other = _any_character(random)
    while other == character.upper():
        other = _any_character(random)
    return other


def _any_character(random: np.random.Generator) -> str:
    return _ALPHABET[int(random.integers(len(_ALPHABET)))]


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
