"""Sign reading by a real OCR on rendered images: PP-OCRv4 in `rapidocr-onnxruntime` (extra `ocr`).

The full pipeline of text detection and recognition, with the models of the package, offline.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.errors import ConfigError
from twc_env.world.sensors.sign_picture import Plate, View, expose, picture

FRAME_PX = (736, 1280)
"""(rows, columns) of the frames; the detector does not rescale this size."""
_GAP_PX = 12
"""Distance between signs in a frame."""


@lru_cache(maxsize=1)
def _engine():
    try:
        from rapidocr_onnxruntime import RapidOCR
    except ImportError as error:
        raise ConfigError(
            f"reading signs with a real OCR needs the extra: pip install 'twc_env[ocr]' ({error})"
        ) from None
    logging.getLogger("RapidOCR").setLevel(logging.ERROR)
    # One thread, as parallel runs share the cores.
    return RapidOCR(intra_op_num_threads=1, inter_op_num_threads=1)


def require() -> None:
    """Raise ConfigError if the extra `ocr` is not installed."""
    _engine()


def read_signs(
    texts: Sequence[str], plates: Sequence[Plate], views: Sequence[View], random: np.random.Generator
) -> list[str]:
    """The reading of each sign, "" if no text is found; several signs are packed into one frame."""
    patches = [picture(t, p, v, random) for t, p, v in zip(texts, plates, views, strict=True)]
    readings = [""] * len(patches)
    for numbers, places in _pack(patches):
        frame = _frame(patches, numbers, places, random)
        for number, reading in zip(numbers, _read_frame(frame, [patches[n] for n in numbers], places), strict=True):
            readings[number] = reading
    return readings


def _pack(patches: Sequence[Array]) -> list[tuple[list[int], list[tuple[int, int]]]]:
    """(numbers, positions) of the patches in each frame, in order, row by row; positions: (row, column) [px]."""
    frames: list[tuple[list[int], list[tuple[int, int]]]] = [([], [])]
    row = column = row_height = _GAP_PX
    for number, patch in enumerate(patches):
        height, width = patch.shape[:2]
        if column + width + _GAP_PX > FRAME_PX[1] and column > _GAP_PX:
            row, column, row_height = row + row_height + _GAP_PX, _GAP_PX, 0
        if row + height + _GAP_PX > FRAME_PX[0] and frames[-1][0]:
            frames.append(([], []))
            row = column = _GAP_PX
            row_height = 0
        frames[-1][0].append(number)
        frames[-1][1].append((row, column))
        column += width + _GAP_PX
        row_height = max(row_height, height)
    return frames


def _frame(
    patches: Sequence[Array], numbers: Sequence[int], places: Sequence[tuple[int, int]], random: np.random.Generator
) -> Array:
    ends = [(r + patches[n].shape[0], c + patches[n].shape[1]) for n, (r, c) in zip(numbers, places, strict=True)]
    rows, columns = (max(FRAME_PX[k], *(end[k] + _GAP_PX for end in ends)) for k in (0, 1))
    frame = np.full((rows, columns, 3), random.uniform(110, 200), np.uint8)
    for number, (row, column) in zip(numbers, places, strict=True):
        height, width = patches[number].shape[:2]
        frame[row : row + height, column : column + width] = expose(patches[number], random)
    return frame


def _read_frame(frame: Array, patches: Sequence[Array], places: Sequence[tuple[int, int]]) -> list[str]:
    """The text found in each patch: lines from top to bottom, parts of a line from left to right."""
    found, _ = _engine()(frame[:, :, ::-1], use_cls=False)
    parts: list[list[tuple[float, float, float, str]]] = [[] for _ in patches]
    for box, text, _score in found or ():
        corners = np.array(box, float)
        x, y = corners.mean(axis=0)
        for k, ((row, column), patch) in enumerate(zip(places, patches, strict=True)):
            if row <= y < row + patch.shape[0] and column <= x < column + patch.shape[1]:
                parts[k].append((y, x, float(np.ptp(corners[:, 1])), text))
    return [_join_boxes(part) for part in parts]


def _join_boxes(parts: list[tuple[float, float, float, str]]) -> str:
    """(y, x, height, text) of detected boxes -> text."""
    lines: list[list[tuple[float, float, float, str]]] = []
    for part in sorted(parts):
        if lines and part[0] - lines[-1][0][0] < 0.5 * min(part[2], lines[-1][0][2]):
            lines[-1].append(part)
        else:
            lines.append([part])
    return " ".join(text for line in lines for _, _, _, text in sorted(line, key=lambda part: part[1]))
