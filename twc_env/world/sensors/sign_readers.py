"""Sign readers: viewing conditions -> text, by the measured error table, a real OCR or two error probabilities."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import Protocol

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.config import SignsConfig
from twc_env.records.random_streams import random_stream
from twc_env.world.sensors.misreading import SignTexts, TableReader, draw_count, misread
from twc_env.world.sensors.ocr_table import load_table

DRAWN_MAX_PX = 128.0
"""Maximum capital height of rendered images; greater ones do not improve the readings."""


class SignReader(Protocol):
    """Reads the signs in view."""

    def read(self, signs: Sequence[int], sights: Array, hidden: Array) -> list[str]:
        """A text for each sign in view; "" if it could not be read.

        signs: plan numbers. sights (k, 6): plan number, distance [m], bearing [rad], capital height [px], incidence
        [rad] (positive if the sign's right side is further away), motion blur [px]; hidden (>= k, characters) bool:
        characters behind a robot.
        """
        ...


def make_reader(config: SignsConfig, texts: Sequence[str], robot: int, seed: int) -> SignReader:
    """The reader named by `signs.reader`. Raises ConfigError for "paddle" without the extra `ocr`."""
    if config.reader == "simple":
        return _SimpleSignReader(config, texts, robot, seed)
    if config.reader == "paddle":
        return _OcrSignReader(config, texts, robot, seed)
    return _TableSignReader(texts, robot, seed)


class _TableSignReader:
    """Samples readings from the measured table; errors of the same sign are correlated over robots and time."""

    def __init__(self, texts: Sequence[str], robot: int, seed: int):
        self._noise = ocr_stream(seed, robot)
        self._texts = texts_of(tuple(texts), seed)
        self._draw_counts = [draw_count(text) for text in texts]

    def read(self, signs: Sequence[int], sights: Array, hidden: Array) -> list[str]:
        fresh = self._noise.standard_normal(sum([self._draw_counts[sign] for sign in signs]))
        return shipped_reader().read_signs(sights, hidden, self._texts, fresh)


def ocr_stream(seed: int, robot: int) -> np.random.Generator:
    """Random stream of the independent part of a robot's reading errors."""
    return random_stream(seed, "ocr", robot)


@lru_cache(maxsize=1)
def texts_of(texts: tuple[str, ...], seed: int) -> SignTexts:
    """The sign texts of an episode, shared by all robots."""
    return SignTexts(load_table(), texts, random_stream(seed, "sign plates"))


@lru_cache(maxsize=1)
def shipped_reader() -> TableReader:
    """The reader of the shipped table; global, so that copies and snapshots of an environment do not contain it."""
    return TableReader(load_table())


class _SimpleSignReader:
    """Two error probabilities, independent of the viewing conditions (papers.md T3)."""

    def __init__(self, config: SignsConfig, texts: Sequence[str], robot: int, seed: int):
        self._config, self._texts = config, texts
        self._random = random_stream(seed, "ocr", robot)

    def read(self, signs: Sequence[int], sights: Array, hidden: Array) -> list[str]:
        return [self._read(self._texts[sign], hidden[k]) for k, sign in enumerate(signs)]

    def _read(self, true_text: str, is_hidden: Array) -> str:
        text = misread(true_text, self._config, self._random)
        return "" if is_hidden[: len(true_text)].any() else text.strip()


class _OcrSignReader:
    """Renders an image of every sign in view and runs a real OCR on it: slow, for studies."""

    def __init__(self, config: SignsConfig, texts: Sequence[str], robot: int, seed: int):
        from twc_env.world.sensors import ocr
        from twc_env.world.sensors.sign_picture import draw_plate

        ocr.require()
        self._read_signs = ocr.read_signs
        self._texts, self._focal_length_px = texts, config.focal_length_px
        plates = random_stream(seed, "sign plates")
        self._plates = [draw_plate(plates) for _ in texts]
        self._random = random_stream(seed, "ocr", robot)

    def read(self, signs: Sequence[int], sights: Array, hidden: Array) -> list[str]:
        from twc_env.world.sensors.sign_picture import View

        texts = [self._texts[sign] for sign in signs]
        views = []
        for text, is_hidden, (height_px, incidence_rad, blur_px) in zip(
            texts, hidden, sights[:, 3:].tolist(), strict=False
        ):
            part = hidden_part(is_hidden[: len(text)])
            views.append(View(min(height_px, DRAWN_MAX_PX), incidence_rad, blur_px, part, self._focal_length_px))
        return self._read_signs(texts, [self._plates[sign] for sign in signs], views, self._random) if views else []


def hidden_part(is_hidden: Array) -> tuple[float, float]:
    """The part of the width from the first to the last hidden character, is_hidden (characters,), as shares of the
    text's length; (0, 0) if none is."""
    at = np.flatnonzero(is_hidden)
    return (at[0] / len(is_hidden), (at[-1] + 1) / len(is_hidden)) if len(at) else (0.0, 0.0)
