"""Pictures of signs as a robot's camera would take them: perspective, motion blur, light, noise, something in front.

Needs the extra `ocr` (Pillow, matplotlib for its DejaVu and STIX fonts, OpenCV); nothing of it is imported before the
first picture. Lengths are in pixels of the camera's picture or in capital heights, the height of an upright capital.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray as Array

FONTS = (
    "DejaVuSans.ttf",
    "DejaVuSans-Bold.ttf",
    "DejaVuSerif-Bold.ttf",
    "DejaVuSansMono-Bold.ttf",
    "STIXGeneralBol.ttf",
)
PAINTS = (
    ((242, 240, 236), (25, 25, 28)),
    ((30, 32, 36), (235, 235, 230)),
    ((12, 110, 62), (240, 245, 240)),
    ((178, 28, 30), (245, 240, 238)),
    ((28, 70, 150), (240, 242, 246)),
    ((176, 180, 184), (60, 62, 66)),
    ((196, 160, 96), (64, 44, 24)),
)
"""(plate, letters) in sRGB: door plates, escape, fire, information, brushed steel, brass."""
LINE_CHARACTERS_MAX = 20
"""A longer text is set in several lines, broken between words."""
LINE_PITCH = 1.6
"""Capital heights from line to line."""
DRAWN_HEIGHT_PX = 64
"""Capitals are drawn this high at least before perspective shrinks them."""
_FINER = 3
"""The picture is projected this much finer, then averaged, as pixels average light."""


@dataclass(frozen=True, slots=True)
class Plate:
    """How a sign is made, which stays with it: letters, colours, margins."""

    font: str
    ground: tuple[int, int, int]
    ink: tuple[int, int, int]
    margin: float
    """Empty border around the letters [capital heights]."""
    fading: float
    """Contrast lost to age, 0 to 1."""


@dataclass(frozen=True, slots=True)
class View:
    """How a camera sees a sign."""

    height_px: float
    """Capital height in the picture, at the middle of the sign."""
    incidence_rad: float
    """Between line of sight and the sign's normal; the sign's right side is further away where positive."""
    blur_px: float = 0.0
    """Way of the picture over the sensor during exposure, horizontal."""
    hidden: tuple[float, float] = (0.0, 0.0)
    """Part of the text that something in front hides: from and to, as shares of its width from the left."""
    focal_length_px: float = 1400.0


def draw_plate(random: np.random.Generator) -> Plate:
    """A plate as buildings have them."""
    ground, ink = PAINTS[int(random.choice(len(PAINTS), p=(0.34, 0.12, 0.12, 0.12, 0.12, 0.1, 0.08)))]
    font = FONTS[int(random.integers(len(FONTS)))]
    return Plate(font, ground, ink, float(random.uniform(0.5, 1.2)), float(random.uniform(0.0, 0.45)))


def lines_of(text: str) -> list[str]:
    """The text broken into lines between words."""
    lines: list[str] = []
    for word in text.split():
        if lines and len(lines[-1]) + 1 + len(word) <= LINE_CHARACTERS_MAX:
            lines[-1] += " " + word
        else:
            lines.append(word)
    return lines


def picture(text: str, plate: Plate, view: View, random: np.random.Generator) -> Array:
    """(rows, columns, 3) float picture 0 to 255 of the sign on a wall, before sensor noise (`expose` adds it)."""
    import cv2

    flat = _drawn(text, plate)
    _hide(flat, plate, view.hidden, random)
    wall = tuple(int(v) for v in random.integers(120, 230, 1).repeat(3))
    target, size = _corners(flat.shape, view, float(random.normal(0.0, 0.02)))
    # Averaged to about the fineness of the projection first, so that no stroke is skipped.
    shrink = min(1.0, 1.2 * _FINER * view.height_px / DRAWN_HEIGHT_PX)
    if shrink < 1.0:
        flat = cv2.resize(flat, None, fx=shrink, fy=shrink, interpolation=cv2.INTER_AREA)
    source = np.array([[0, 0], [flat.shape[1], 0], [flat.shape[1], flat.shape[0]], [0, flat.shape[0]]], np.float32)
    warp = cv2.getPerspectiveTransform(source, (target * _FINER).astype(np.float32))
    fine_size = (size[0] * _FINER, size[1] * _FINER)
    fine = cv2.warpPerspective(flat, warp, fine_size, borderMode=cv2.BORDER_CONSTANT, borderValue=wall)
    seen = cv2.resize(fine, size, interpolation=cv2.INTER_AREA).astype(np.float32)
    return _lit(_smeared(seen, view.blur_px, random), random)


def expose(frame: Array, random: np.random.Generator) -> Array:
    """uint8 picture as the sensor gives it: shot and read noise at a light level drawn log-evenly, 12 to 1."""
    light = math.exp(random.uniform(math.log(1 / 12), 0.0))
    signal = np.clip(frame, 0.0, 255.0) / 255.0
    std = np.sqrt(signal / (3000.0 * light) + (0.004 / light) ** 2 * 0.25)
    noisy = signal + std * random.standard_normal(frame.shape, dtype=np.float32)
    return np.clip(noisy * 255.0 + 0.5, 0, 255).astype(np.uint8)


@lru_cache(maxsize=16)
def _font(name: str):
    """A font whose capitals are `DRAWN_HEIGHT_PX` high."""
    import matplotlib
    from PIL import ImageFont

    path = f"{matplotlib.get_data_path()}/fonts/ttf/{name}"
    box = ImageFont.truetype(path, 200).getbbox("H")
    return ImageFont.truetype(path, 200 * DRAWN_HEIGHT_PX / (box[3] - box[1]))


def _drawn(text: str, plate: Plate) -> Array:
    """The plate from straight ahead."""
    from PIL import Image, ImageDraw

    font, lines = _font(plate.font), lines_of(text)
    margin = round(plate.margin * DRAWN_HEIGHT_PX)
    width = max(math.ceil(font.getlength(line)) for line in lines)
    height = round(DRAWN_HEIGHT_PX * (1 + LINE_PITCH * (len(lines) - 1)))
    image = Image.new("RGB", (width + 2 * margin, height + 2 * margin), plate.ground)
    ink = tuple(round(i + plate.fading * (g - i)) for i, g in zip(plate.ink, plate.ground, strict=True))
    for k, line in enumerate(lines):
        baseline = margin + DRAWN_HEIGHT_PX * (1 + LINE_PITCH * k)
        ImageDraw.Draw(image).text(
            (margin + (width - font.getlength(line)) / 2, baseline), line, ink, font, anchor="ls"
        )
    return np.array(image)


def _corners(shape: tuple[int, ...], view: View, roll_rad: float) -> tuple[Array, tuple[int, int]]:
    """Pinhole projection of the plate's corners (4, 2) and the picture's (width, height) with some wall around."""
    half_x, half_y = (0.5 * shape[k] / DRAWN_HEIGHT_PX for k in (1, 0))  # capital heights
    distance = max(view.focal_length_px / view.height_px, 1.5 * half_x)
    x = np.array([-half_x, half_x, half_x, -half_x])
    y = np.array([-half_y, -half_y, half_y, half_y])
    depth = 1.0 + x * math.sin(view.incidence_rad) / distance
    seen = np.column_stack([x * math.cos(view.incidence_rad) / depth, y / depth]) * view.height_px
    cos, sin = math.cos(roll_rad), math.sin(roll_rad)
    seen = seen @ np.array([[cos, sin], [-sin, cos]])
    pad = 2.0 + 0.5 * view.height_px + view.blur_px
    low = seen.min(axis=0) - pad
    size = np.ceil(seen.max(axis=0) + pad - low).astype(int)
    return seen - low, (int(size[0]), int(size[1]))


def _hide(flat: Array, plate: Plate, hidden: tuple[float, float], random: np.random.Generator) -> None:
    """Something dark stands in front of part of the text, and of the margin beside it."""
    if hidden[1] <= hidden[0]:
        return
    margin = round(plate.margin * DRAWN_HEIGHT_PX)
    begin, end = (margin + round(share * (flat.shape[1] - 2 * margin)) for share in hidden)
    flat[:, begin if hidden[0] > 0.0 else 0 : end if hidden[1] < 1.0 else None] = random.integers(20, 90, 3)


def _smeared(seen: Array, blur_px: float, random: np.random.Generator) -> Array:
    """A lens that is never quite sharp, and motion during exposure."""
    import cv2

    soft = cv2.GaussianBlur(seen, (0, 0), float(random.uniform(0.4, 0.9)))
    if blur_px < 0.05:
        return soft
    reach = math.ceil(0.5 * blur_px + 0.5)
    at = np.abs(np.arange(-reach, reach + 1))
    kernel = np.clip(0.5 * blur_px + 0.5 - at, 0.0, 1.0)
    return cv2.filter2D(soft, -1, (kernel / kernel.sum())[None, :], borderType=cv2.BORDER_REPLICATE)


def _lit(seen: Array, random: np.random.Generator) -> Array:
    """Uneven light: a gradient over the sign, now and then a lamp's reflection on it."""
    rows, columns = seen.shape[:2]
    across = np.linspace(-0.5, 0.5, columns, dtype=np.float32)[None, :]
    light = random.uniform(0.55, 1.05) * (1.0 + random.uniform(-0.5, 0.5) * across)
    lit = seen * np.broadcast_to(light, (rows, columns))[:, :, None]
    if random.random() < 0.15:
        at = random.uniform(0, columns), random.uniform(0, rows)
        y, x = np.mgrid[:rows, :columns].astype(np.float32)
        spot = np.exp(-0.5 * (((x - at[0]) / (0.15 * columns)) ** 2 + ((y - at[1]) / (0.5 * rows)) ** 2))
        lit = lit + (random.uniform(30, 110) * spot)[:, :, None]
    return lit.astype(np.float32)
