"""A picture with its caption above and its legend below: what films, windows and `rgb_array` show.

Texts need Pillow (extra `viz`); without it there is the picture alone.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache
from importlib.util import find_spec
from typing import Any

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.exploration.drawing import palette
from twc_env.exploration.drawing.rendering import Scene, render, sizes_of, to_pixels, view_of

WIDTH_PX = 960
CAPTION_PX, TEXT_PX, TEXT_MIN_PX, NUMBER_PX = 17, 13, 9, 13
"""Font sizes of the caption, of the legend, of texts that would be too wide otherwise, and of robots' numbers."""
LINE_PX, EDGE_PX, SAMPLE_PX, GAP_PX = 21, 8, 26, 18
FINER = 3
"""Samples of the legend are drawn so many times larger, then reduced."""


Entry = tuple[str, str, str]
"""Shape, colour and text of an entry of the legend."""


def framed(scene: Scene, caption: str, help_text: str = "", entries: tuple[Entry, ...] | None = None) -> Array:
    """The picture of a scene (height, 960, 3) uint8, its caption above, legend and help below.

    entries: of the legend; None: of what the scene shows.
    """
    image = render(scene)
    if find_spec("PIL") is None:
        return image
    from PIL import Image, ImageDraw

    height, width = image.shape[:2]
    left = (WIDTH_PX - width) // 2
    above = _strip((caption,), (CAPTION_PX,))
    below = _legend(legend_of(scene) if entries is None else entries, help_text)
    frame = np.empty((above.shape[0] + height + below.shape[0], WIDTH_PX, 3), np.uint8)
    frame[:] = palette.rgb(palette.UNKNOWN).astype(np.uint8)
    frame[: above.shape[0]], frame[above.shape[0] + height :] = above, below
    frame[above.shape[0] : above.shape[0] + height, left : left + width] = image
    canvas = Image.fromarray(frame)
    _number_robots(ImageDraw.Draw(canvas), scene, left, above.shape[0], (height, width))
    return np.array(canvas)


def _number_robots(draw: Any, scene: Scene, left: int, top: int, size_px: tuple[int, int]) -> None:
    """Write the number of each robot beside its true place, or its estimated one if that is all there is."""
    view = view_of(scene)[1]
    poses = scene.true_poses if len(scene.true_poses) else scene.estimated_poses
    sizes_m = sizes_of(scene)
    for robot, (u, v) in enumerate(to_pixels(np.asarray(poses, float).reshape(-1, 3)[:, :2], view)):
        away = max(sizes_m[robot] / view[2], 3.5) + 8
        if not (0 <= u < size_px[1] and 0 <= v < size_px[0]):  # NaN: uses none of these maps
            continue
        u, v = u + (away if u + 2 * away < size_px[1] else -away), v - (away if v > 2 * away else -away)
        draw.text(
            (left + u, top + v), str(robot), fill=palette.INK, font=_font(NUMBER_PX), anchor="mm",
            stroke_width=2, stroke_fill=palette.FLOOR,
        )  # fmt: skip


def legend_of(scene: Scene) -> tuple[Entry, ...]:
    """The legend of a scene with all its layers: it stays the same in an episode, unless signal strength is switched
    on, so that a window keeps its size."""
    entries: list[Entry] = []
    if scene.walls.any():
        entries.append(("bar", palette.TRUE_WALL, "true walls"))
    if scene.grids:
        entries += [("bar", palette.WALL, "mapped walls"), ("area", palette.FLOOR, "mapped floor, tinted until merged")]
    if len(scene.true_poses):
        entries.append(("disc", palette.ANY_ROBOT, "true poses and paths"))
    if len(scene.estimated_poses):
        entries.append(("ring", palette.ANY_ROBOT, "estimated poses"))
    entries += [("line", palette.CLOSURE, "accepted closures"), ("dashes", palette.CLOSURE, "rejected closures")]
    if len(scene.things_m):
        entries.append(("line", palette.TRUE_WALL, "doors, furniture"))
    if len(scene.people_m):
        entries.append(("person", palette.PERSON, "people"))
    if scene.signal is not None:
        entries.append(("ramp", "", "signal, weak to strong"))
    robots = max(len(scene.true_poses), len(scene.estimated_poses))
    return (*entries, *(("disc", palette.robot_colour(robot), f"robot {robot}") for robot in range(robots)))


@lru_cache(maxsize=32)
def _legend(entries: tuple[Entry, ...], help_text: str) -> Array:
    """The strip below the picture (height, 960, 3) uint8, with as many lines as needed."""
    from PIL import Image, ImageDraw

    places: list[tuple[int, int]] = []
    x, line = EDGE_PX, 0
    for _, _, text in entries:
        wide = SAMPLE_PX + 6 + math.ceil(_font(TEXT_PX).getlength(text)) + GAP_PX
        if x + wide > WIDTH_PX and x > EDGE_PX:
            x, line = EDGE_PX, line + 1
        places.append((x, line))
        x += wide
    height = EDGE_PX // 2 + (line + 1) * LINE_PX + EDGE_PX // 2 if entries else 0
    big = Image.new("RGB", (FINER * WIDTH_PX, FINER * max(height, 1)), palette.UNKNOWN)
    brush = ImageDraw.Draw(big)
    for (shape, colour, _), (x, line) in zip(entries, places, strict=True):
        _sample(brush, shape, colour, FINER * x, FINER * (EDGE_PX // 2 + line * LINE_PX + LINE_PX // 2))
    strip = big.resize((WIDTH_PX, max(height, 1)), Image.Resampling.BOX)
    pen = ImageDraw.Draw(strip)
    for (_, _, text), (x, line) in zip(entries, places, strict=True):
        middle = EDGE_PX // 2 + line * LINE_PX + LINE_PX // 2
        pen.text((x + SAMPLE_PX + 6, middle), text, fill=palette.INK, font=_font(TEXT_PX), anchor="lm")
    told = _strip((help_text,), (TEXT_PX,)) if help_text else np.empty((0, WIDTH_PX, 3), np.uint8)
    return np.concatenate([np.array(strip)[:height], told])


def _sample(brush: Any, shape: str, colour: str, x: int, y: int) -> None:
    """Draw the sample of an entry with its left end at x, around the height y."""
    n, wide = FINER, FINER * SAMPLE_PX
    middle = x + wide // 2
    if shape == "bar":
        brush.rectangle((x, y - 2 * n, x + wide, y + 2 * n), fill=colour)
    elif shape == "area":
        brush.rectangle((x, y - 6 * n, x + wide, y + 6 * n), fill=colour, outline=palette.TRUE_WALL, width=n)
    elif shape in ("disc", "person"):
        rim = palette.INK if shape == "person" else colour
        brush.ellipse((middle - 6 * n, y - 6 * n, middle + 6 * n, y + 6 * n), fill=colour, outline=rim, width=n)
    elif shape == "ring":
        brush.ellipse((middle - 6 * n, y - 6 * n, middle + 6 * n, y + 6 * n), outline=colour, width=2 * n)
    elif shape == "ramp":
        for k, step in enumerate(palette.SIGNAL):
            brush.rectangle((x + k * wide // 5, y - 5 * n, x + (k + 1) * wide // 5, y + 5 * n), fill=step)
    else:
        for k in range(0, wide, 10 * n) if shape == "dashes" else (0,):
            end = min(wide, k + 6 * n) if shape == "dashes" else wide
            brush.line((x + k, y, x + end, y), fill=colour, width=2 * n)


@lru_cache(maxsize=64)
def _strip(texts: Sequence[str], sizes: Sequence[int]) -> Array:
    """Lines of text (height, 960, 3) uint8; a line that is too wide gets a smaller font, and is broken at the least."""
    from PIL import Image, ImageDraw

    lines: list[tuple[str, int]] = []
    for text, largest in zip(texts, sizes, strict=True):
        room, size = WIDTH_PX - 2 * EDGE_PX, largest
        while size > TEXT_MIN_PX and _font(size).getlength(text) > room:
            size -= 1
        rest = text
        while _font(size).getlength(rest) > room:
            cut = len(rest)
            while cut > 1 and _font(size).getlength(rest[:cut]) > room:
                cut = rest.rfind(" ", 0, cut) if " " in rest[:cut].strip() else cut - 1
            lines.append((rest[:cut], size))
            rest = rest[cut:].lstrip()
        lines.append((rest, size))
    height = sum(size + 9 for _, size in lines)
    strip = Image.new("RGB", (WIDTH_PX, height), palette.UNKNOWN)
    pen, y = ImageDraw.Draw(strip), 0
    for text, size in lines:
        pen.text((EDGE_PX, y + (size + 9) // 2), text, fill=palette.INK, font=_font(size), anchor="lm")
        y += size + 9
    return np.array(strip)


@lru_cache(maxsize=16)
def _font(size: int) -> Any:
    from PIL import ImageFont

    return ImageFont.load_default(size)
