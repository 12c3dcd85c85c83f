"""From how a camera sees a sign to the text it reads: by the measured table, by a real OCR, or by two plain numbers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from twc_env.config import SignsConfig
from twc_env.random_streams import random_stream
from twc_env.world.misreading import TableReader, codes_of, misread, shares
from twc_env.world.noise import NormalPool
from twc_env.world.ocr_table import load_table

Array = NDArray

DRAWN_MAX_PX = 128.0
"""Signs so near that their capitals are higher are drawn this high: the OCR reads them no worse."""


@dataclass(slots=True, eq=False)
class Sight:
    """How a camera sees one sign."""

    sign: int
    """Plan number."""
    distance_m: float
    bearing_rad: float
    """From straight ahead, counter-clockwise."""
    height_px: float
    incidence_rad: float
    """Signed: positive when the sign's right side is further away."""
    blur_px: float
    is_hidden: Array
    """(characters,) bool: behind a robot."""


class SignReader(Protocol):
    """What turns the signs in view into text."""

    def read(self, sights: Sequence[Sight]) -> list[str]:
        """A text for each sight; "" where nothing was read."""


def make_reader(config: SignsConfig, texts: Sequence[str], robot: int, seed: int) -> SignReader:
    """The reader that `signs.reader` names; ConfigError for `paddle` without the extra `ocr`."""
    if config.reader == "simple":
        return _Simple(config, texts, robot, seed)
    if config.reader == "paddle":
        return _Live(config, texts, robot, seed)
    return _Fast(texts, robot, seed)


class _Fast:
    """Draws from the measured table. Part of what goes wrong stays with the sign, for all robots and the episode."""

    def __init__(self, texts: Sequence[str], robot: int, seed: int):
        table = load_table()
        self._noise = NormalPool(random_stream(seed, "ocr", robot))
        self._codes = [codes_of(text) for text in texts]
        plates = random_stream(seed, "sign plates")
        self._kept, self._weight = [], []
        for text in texts:
            share = shares(table, text)
            self._kept.append(np.sqrt(share) * plates.standard_normal(len(share)))
            self._weight.append(np.sqrt(1.0 - share))

    def read(self, sights: Sequence[Sight]) -> list[str]:
        return [self._read(sight) for sight in sights]

    def _read(self, sight: Sight) -> str:
        sign = sight.sign
        weight = self._weight[sign]
        draws = self._kept[sign] + weight * self._noise.take(len(weight))
        return _shipped().read(
            self._codes[sign], sight.is_hidden, sight.height_px, sight.incidence_rad, sight.blur_px, draws
        )


@lru_cache(maxsize=1)
def _shipped() -> TableReader:
    """The same for all: copies and snapshots of an environment carry no table along."""
    return TableReader(load_table())


class _Simple:
    """The same two probabilities for every sign, however it is seen (papers.md T3)."""

    def __init__(self, config: SignsConfig, texts: Sequence[str], robot: int, seed: int):
        self._config, self._texts = config, texts
        self._random = random_stream(seed, "ocr", robot)

    def read(self, sights: Sequence[Sight]) -> list[str]:
        return [self._read(sight) for sight in sights]

    def _read(self, sight: Sight) -> str:
        text = misread(self._texts[sight.sign], self._config, self._random)
        return "" if sight.is_hidden.any() else text.strip()


class _Live:
    """Draws a picture of every sign in view and has a real OCR read it: slow, for studies."""

    def __init__(self, config: SignsConfig, texts: Sequence[str], robot: int, seed: int):
        from twc_env.world import ocr
        from twc_env.world.sign_picture import draw_plate

        ocr.require()
        self._read_signs = ocr.read_signs
        self._texts, self._focal_length_px = texts, config.focal_length_px
        plates = random_stream(seed, "sign plates")
        self._plates = [draw_plate(plates) for _ in texts]
        self._random = random_stream(seed, "ocr", robot)

    def read(self, sights: Sequence[Sight]) -> list[str]:
        from twc_env.world.sign_picture import View

        if not sights:
            return []
        views = [
            View(
                min(s.height_px, DRAWN_MAX_PX),
                s.incidence_rad,
                s.blur_px,
                hidden_part(s.is_hidden),
                self._focal_length_px,
            )
            for s in sights
        ]
        numbers = [s.sign for s in sights]
        return self._read_signs(
            [self._texts[n] for n in numbers], [self._plates[n] for n in numbers], views, self._random
        )


def hidden_part(is_hidden: Array) -> tuple[float, float]:
    """The part of the width from the first to the last hidden character, as shares of the text's length."""
    at = np.flatnonzero(is_hidden)
    return (at[0] / len(is_hidden), (at[-1] + 1) / len(is_hidden)) if len(at) else (0.0, 0.0)
