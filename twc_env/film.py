"""Frames of films: a picture of an episode, made small, with a line of text under it. Needs Pillow (extra `viz`)."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twc_env.errors import DataError

Array = NDArray

COLOURS = 64
TEXT_PX = 12
INK, PAPER = (38, 44, 56), (255, 255, 255)


def film_frame(picture: Array, caption: str, width_max_px: int) -> Any:
    """A picture (height, width, 3) uint8 as a Pillow image of few colours, its caption on a strip below."""
    from PIL import Image, ImageDraw, ImageFont

    image = Image.fromarray(np.ascontiguousarray(picture))
    if image.width > width_max_px:
        height = max(1, round(image.height * width_max_px / image.width))
        image = image.resize((width_max_px, height), Image.Resampling.BOX)
    size = TEXT_PX
    while size > 6 and ImageFont.load_default(size).getlength(caption) > image.width - size:
        size -= 1
    frame = Image.new("RGB", (image.width, image.height + 2 * size), PAPER)
    frame.paste(image)
    ImageDraw.Draw(frame).text(
        (size // 2, image.height + size), caption, fill=INK, font=ImageFont.load_default(size), anchor="lm"
    )
    return frame.quantize(COLOURS, dither=Image.Dither.NONE)


def write_film(path: Path, frames: Sequence[Any], duration_ms: int | list[int]) -> None:
    """Frames as an endless GIF. Raises DataError when the file cannot be written."""
    try:
        frames[0].save(path, save_all=True, append_images=frames[1:], duration=duration_ms, loop=0)
    except OSError as error:
        raise DataError(f"cannot write {path}: {error.strerror}; choose another folder") from error
