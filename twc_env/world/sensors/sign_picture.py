"""Rendered camera images of signs: perspective, motion blur, illumination, sensor noise and occlusion.

Needs the extra `ocr` (Pillow, OpenCV, and matplotlib for its DejaVu and STIX fonts), which is imported with the first
image. Lengths are image pixels or multiples of the height of a capital letter.
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
"""sRGB colours of plates and letters: door plates, escape, fire, information, brushed steel, brass."""
LINE_CHARACTERS_MAX = 20
"""Longer texts are broken into lines between words."""
LINE_PITCH = 1.6
"""Line spacing [capital heights]."""
DRAWN_HEIGHT_PX = 64
"""Capital height before the projection."""
_OVERSAMPLING = 3
"""Pixels per image pixel and axis in the projection, which are then averaged."""


@dataclass(frozen=True, slots=True)
class Plate:
    """Design of a sign: font, colours, margin."""

    font: str
    ground: tuple[int, int, int]
    ink: tuple[int, int, int]
    margin: float
    """Border around the text [capital heights]."""
    fading: float
    """Loss of contrast, 0 to 1."""


@dataclass(frozen=True, slots=True)
class View:
    """Viewing conditions of a sign."""

    height_px: float
    """Capital height in the image, at the centre of the sign."""
    incidence_rad: float
    """Angle between line of sight and the sign's normal; positive if the sign's right side is further away."""
    blur_px: float = 0.0
    """Horizontal image motion during the exposure."""
    hidden: tuple[float, float] = (0.0, 0.0)
    """Begin and end of the occluded part of the text, as shares of its width from the left."""
    focal_length_px: float = 1400.0


def draw_plate(random: np.random.Generator) -> Plate:
    """A random plate."""
    ground, ink = PAINTS[int(random.choice(len(PAINTS), p=(0.34, 0.12, 0.12, 0.12, 0.12, 0.1, 0.08)))]
    font = FONTS[int(random.integers(len(FONTS)))]
    return Plate(font, ground, ink, float(random.uniform(0.5, 1.2)), float(random.uniform(0.0, 0.45)))


def lines_of(text: str) -> list[str]:
    """The text in lines of at most `LINE_CHARACTERS_MAX` characters; longer words get their own line."""
    lines: list[str] = []
    for word in text.split():
        if lines and len(lines[-1]) + 1 + len(word) <= LINE_CHARACTERS_MAX:
            lines[-1] += " " + word
        else:
            lines.append(word)
    return lines


def picture(text: str, plate: Plate, view: View, random: np.random.Generator) -> Array:
    """(rows, columns, 3) float image, 0 to 255, of the sign on a wall, without sensor noise (see `expose`)."""
    import cv2

    flat = _render_plate(text, plate)
    _hide(flat, plate, view.hidden, random)
    wall = tuple(int(v) for v in random.integers(120, 230, 1).repeat(3))
    target, size = _corners(flat.shape, view, float(random.normal(0.0, 0.02)))
    # Averaged to about the resolution of the projection, against aliasing.
    shrink = min(1.0, 1.2 * _OVERSAMPLING * view.height_px / DRAWN_HEIGHT_PX)
    if shrink < 1.0:
        flat = cv2.resize(flat, None, fx=shrink, fy=shrink, interpolation=cv2.INTER_AREA)
    source = np.array([[0, 0], [flat.shape[1], 0], [flat.shape[1], flat.shape[0]], [0, flat.shape[0]]], np.float32)
    warp = cv2.getPerspectiveTransform(source, (target * _OVERSAMPLING).astype(np.float32))
    fine_size = (size[0] * _OVERSAMPLING, size[1] * _OVERSAMPLING)
    fine = cv2.warpPerspective(flat, warp, fine_size, borderMode=cv2.BORDER_CONSTANT, borderValue=wall)
    image = cv2.resize(fine, size, interpolation=cv2.INTER_AREA).astype(np.float32)
    return _light(_blur(image, view.blur_px, random), random)


def expose(frame: Array, random: np.random.Generator) -> Array:
    """uint8 image of the shape of `frame` (0 to 255) with shot and read noise, at a light level sampled log-uniformly
    over a factor of 12."""
    light = math.exp(random.uniform(math.log(1 / 12), 0.0))
    signal = np.clip(frame, 0.0, 255.0) / 255.0
    std = np.sqrt(signal / (3000.0 * light) + (0.004 / light) ** 2 * 0.25)
    noisy = signal + std * random.standard_normal(frame.shape, dtype=np.float32)
    return np.clip(noisy * 255.0 + 0.5, 0, 255).astype(np.uint8)


@lru_cache(maxsize=16)
def _font(name: str):
    """The font with capitals of `DRAWN_HEIGHT_PX`."""
    import matplotlib
    from PIL import ImageFont

    path = f"{matplotlib.get_data_path()}/fonts/ttf/{name}"
    box = ImageFont.truetype(path, 200).getbbox("H")
    return ImageFont.truetype(path, 200 * DRAWN_HEIGHT_PX / (box[3] - box[1]))


def _render_plate(text: str, plate: Plate) -> Array:
    """Frontal image of the plate."""
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
    """Pinhole projection of the plate's corners (4, 2), and (width, height) of the image with a border of wall."""
    half_x, half_y = (0.5 * shape[k] / DRAWN_HEIGHT_PX for k in (1, 0))  # capital heights
    distance = max(view.focal_length_px / view.height_px, 1.5 * half_x)
    x = np.array([-half_x, half_x, half_x, -half_x])
    y = np.array([-half_y, -half_y, half_y, half_y])
    depth = 1.0 + x * math.sin(view.incidence_rad) / distance
    image = np.column_stack([x * math.cos(view.incidence_rad) / depth, y / depth]) * view.height_px
    cos, sin = math.cos(roll_rad), math.sin(roll_rad)
    image = image @ np.array([[cos, sin], [-sin, cos]])
    pad = 2.0 + 0.5 * view.height_px + view.blur_px
    low = image.min(axis=0) - pad
    size = np.ceil(image.max(axis=0) + pad - low).astype(int)
    return image - low, (int(size[0]), int(size[1]))


def _hide(flat: Array, plate: Plate, hidden: tuple[float, float], random: np.random.Generator) -> None:
    """Paint an occluding dark object over part of the text and the adjacent margin."""
    if hidden[1] <= hidden[0]:
        return
    margin = round(plate.margin * DRAWN_HEIGHT_PX)
    begin, end = (margin + round(share * (flat.shape[1] - 2 * margin)) for share in hidden)
    flat[:, begin if hidden[0] > 0.0 else 0 : end if hidden[1] < 1.0 else None] = random.integers(20, 90, 3)


def _blur(image: Array, blur_px: float, random: np.random.Generator) -> Array:
    """The image with defocus and motion blur."""
    import cv2

    soft = cv2.GaussianBlur(image, (0, 0), float(random.uniform(0.4, 0.9)))
    if blur_px < 0.05:
        return soft
    reach = math.ceil(0.5 * blur_px + 0.5)
    at = np.abs(np.arange(-reach, reach + 1))
    kernel = np.clip(0.5 * blur_px + 0.5 - at, 0.0, 1.0)
    return cv2.filter2D(soft, -1, (kernel / kernel.sum())[None, :], borderType=cv2.BORDER_REPLICATE)


def _light(image: Array, random: np.random.Generator) -> Array:
    """The image under uneven illumination, sometimes with the reflection of a lamp."""
    rows, columns = image.shape[:2]
    across = np.linspace(-0.5, 0.5, columns, dtype=np.float32)[None, :]
    light = random.uniform(0.55, 1.05) * (1.0 + random.uniform(-0.5, 0.5) * across)
    lit = image * np.broadcast_to(light, (rows, columns))[:, :, None]
    if random.random() < 0.15:
        at = random.uniform(0, columns), random.uniform(0, rows)
        y, x = np.mgrid[:rows, :columns].astype(np.float32)
        spot = np.exp(-0.5 * (((x - at[0]) / (0.15 * columns)) ** 2 + ((y - at[1]) / (0.5 * rows)) ** 2))
        lit = lit + (random.uniform(30, 110) * spot)[:, :, None]
    return lit.astype(np.float32)
