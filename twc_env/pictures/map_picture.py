"""A floor plan as a picture: walls, rooms, signs, access points and signal strength. Needs matplotlib."""

from __future__ import annotations

from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from twc_env.errors import DataError, MapError
from twc_env.pictures.style import (
    FLOOR,
    INK,
    SIGNAL_MAP,
    TRUE_TEXT,
    TRUE_WALL,
    fit_height,
    legend_below,
    new_figure,
    place_names,
    save_figure,
    set_title,
    settle,
    style,
)
from twc_env.world.building.floorplan import Floorplan, Room
from twc_env.world.building.materials import MATERIALS
from twc_env.world.sensors.signal_map import SIGNAL_SPAN_DBM, signal_map_dbm

LABELS_MAX = 90
"""With more rooms or signs than this, names are left out, because there is no room for them."""
WIDTH_INCHES, HEIGHT_MAX_INCHES = 11.0, 16.0
GLASS = "#3b8fc4"
"""Colour of walls that scanners may see through."""
ROOMS_COVER = 0.99
"""With a smaller area than this share of the floor, rooms are not all of it."""
MARKER_PX = 5.0
"""Half the size of the mark of an access point."""
_ROOM_POINTS, _SIGN_POINTS, _CHARACTER_WIDTH = 6.5, 5.0, 0.62
"""Font sizes in rooms and at signs, and the average width of a letter as a share of it."""


def draw_plan(plan: Floorplan, path: str | Path, with_signal: bool = True, dpi: float | None = None) -> Path:
    """Write the picture and create its folder; returns the path, whose suffix is the format (png, pdf, svg).

    Raises MapError without matplotlib, or on failure.
    """
    if find_spec("matplotlib") is None:
        raise MapError("drawing a map needs matplotlib; run `pip install 'twc_env[viz]'`")
    try:
        return save_figure(plan_figure(plan, with_signal), Path(path), dpi)
    except DataError as error:
        raise MapError(str(error)) from error


def plan_figure(plan: Floorplan, with_signal: bool = True) -> Any:
    """The picture as a figure. Raises ConfigError without matplotlib."""
    with style():
        from matplotlib.collections import LineCollection
        from matplotlib.lines import Line2D

        x0, y0, x1, y1 = plan.bounds_m
        margin = 0.02 * max(x1 - x0, y1 - y0)
        width_m, height_m = x1 - x0 + 2 * margin, y1 - y0 + 2 * margin
        figure = new_figure((WIDTH_INCHES, min(WIDTH_INCHES * height_m / width_m, HEIGHT_MAX_INCHES) + 1.3))
        axes = figure.add_subplot(xlabel="x [m]", ylabel="y [m]", facecolor=FLOOR)
        entries: list[tuple[Any, str]] = [(Line2D([], [], color=TRUE_WALL, lw=2.0), "walls (wide: more radio loss)")]
        has_signal = with_signal and bool(plan.access_points)
        if has_signal:
            _draw_signal(axes, figure, plan)
        widths = 0.9 + 0.14 * np.asarray(plan.wall_loss_db).clip(0, 12)
        is_glass = np.array([name in MATERIALS and MATERIALS[name].is_glass for name in plan.wall_materials], bool)
        if is_glass.any():
            entries.append((Line2D([], [], color=GLASS, lw=2.0), f"glass ({is_glass.sum()})"))
        colours = np.where(is_glass, GLASS, TRUE_WALL) if is_glass.any() else TRUE_WALL
        axes.add_collection(LineCollection(list(plan.walls_m), colors=colours, linewidths=widths))
        axes.set(xlim=(x0 - margin, x1 + margin), ylim=(y0 - margin, y1 + margin))
        entries += _draw_signs(axes, plan)
        if plan.access_points:
            places = np.array([a.position_m for a in plan.access_points])
            look: dict[str, Any] = {"ls": "", "marker": "^", "ms": 6, "color": TRUE_TEXT, "mec": FLOOR, "mew": 0.6}
            axes.plot(*places.T, zorder=5, **look)
            entries.append((Line2D([], [], **look), f"access points ({len(places)})"))
        contents = f"{plan.floor_area_m2:,.0f} m² of floor, {len(plan.rooms)} rooms, {len(plan.signs)} signs"
        set_title(figure, [f"{plan.name}: {contents}"])
        legend_below(figure, [handle for handle, _ in entries], [name for _, name in entries])
        fit_height(figure, axes, height_m / width_m, HEIGHT_MAX_INCHES)
        axes.set_aspect("equal")
        settle(figure)
        points_m = np.array([a.position_m for a in plan.access_points]).reshape(-1, 2)
        rooms = name_rooms(axes, plan.rooms, points_m) if len(plan.rooms) <= LABELS_MAX else []
        if len(plan.signs) <= LABELS_MAX:
            places_m = np.array([sign.position_m for sign in plan.signs]).reshape(-1, 2)
            facing_rad = [sign.facing_rad for sign in plan.signs]
            texts = [sign.text for sign in plan.signs]
            place_names(axes, texts, places_m, facing_rad, rooms, points_m, points=_SIGN_POINTS)
    return figure


def _draw_signs(axes: Any, plan: Floorplan) -> list[tuple[Any, str]]:
    """Draw signs as squares with a tick to where they are read from: full if unique, hollow if they repeat a text."""
    from matplotlib.lines import Line2D

    texts = [sign.text for sign in plan.signs]
    repeated = np.array([texts.count(text) > 1 for text in texts], bool)
    places = np.array([s.position_m for s in plan.signs]).reshape(-1, 2)
    facing = np.array([s.facing_rad for s in plan.signs])
    entries = []
    for mask, fill, label in ((~repeated, TRUE_TEXT, "unique signs"), (repeated, FLOOR, "repeated signs")):
        if mask.any():
            x, y = places[mask].T
            axes.quiver(
                x, y, np.cos(facing[mask]), np.sin(facing[mask]), color=TRUE_TEXT, angles="xy", scale_units="dots",
                units="dots", scale=0.125, width=1.8, headwidth=0, headlength=0, headaxislength=0, zorder=4.4,
            )  # fmt: skip
            look: dict[str, Any] = {"ls": "", "marker": "s", "ms": 4, "color": fill, "mec": TRUE_TEXT, "mew": 0.9}
            axes.plot(x, y, zorder=4.5, **look)
            entries.append((Line2D([], [], **look), f"{label} ({mask.sum()})"))
    return entries


def name_rooms(axes: Any, rooms: Sequence[Room], avoided_m: Any = ()) -> list[Any]:
    """Write the names of rooms, in an axes that is laid out; a name that is wider than its room gets one line per word,
    and one that has no room even so is left out. Returns the texts.

    avoided_m: points (n, 2) above or below which a name is moved that would cover them.
    """
    from matplotlib.patheffects import withStroke

    texts: list[Any] = []
    points_per_m = 72 / axes.figure.dpi * axes.get_window_extent().width / abs(np.ptp(axes.get_xlim()))
    boxes: list[Any] = []
    for room in rooms:
        corners = np.asarray(room.polygon_m)
        width_points = points_per_m * float(np.ptp(corners[:, 0]))
        is_too_wide = len(room.name) * _CHARACTER_WIDTH * _ROOM_POINTS > width_points
        text = axes.text(
            *corners.mean(axis=0), "\n".join(room.name.split()) if is_too_wide else room.name, fontsize=_ROOM_POINTS,
            color=INK, ha="center", va="center", clip_on=True, parse_math=False, zorder=5, fontstyle="italic",
            path_effects=[withStroke(linewidth=1.5, foreground=FLOOR, alpha=0.8)],
        )  # fmt: skip
        box = _clear_of(text, avoided_m)
        if any(box.overlaps(other) for other in boxes):
            text.remove()
            continue
        boxes.append(box)
        texts.append(text)
    return texts


def _clear_of(text: Any, points_m: Any) -> Any:
    """Move a text up or down, by at most its height, off the points (n, 2) that it would cover; returns its box."""
    axes, place_m = text.axes, text.get_position()
    renderer, to_pixels = axes.figure.canvas.get_renderer(), axes.transData
    points = to_pixels.transform(np.asarray(points_m, float).reshape(-1, 2))
    height = text.get_window_extent(renderer).height + 2 * MARKER_PX
    for share in (0.0, 0.5, -0.5, 1.0, -1.0):
        up = to_pixels.transform(place_m) + [0.0, share * height]
        text.set_position(to_pixels.inverted().transform(up))
        box = text.get_window_extent(renderer)
        if not box.padded(MARKER_PX).count_contains(points):
            return box
    text.set_position(place_m)
    return text.get_window_extent(renderer)


def _draw_signal(axes: Any, figure: Any, plan: Floorplan) -> None:
    signal, (x0, y0), step_m = signal_map_dbm(plan)
    low, high = SIGNAL_SPAN_DBM
    rows, columns = signal.shape
    image = axes.imshow(
        signal, origin="lower", extent=(x0, x0 + step_m * columns, y0, y0 + step_m * rows), aspect="auto",
        cmap=SIGNAL_MAP, vmin=low, vmax=high, alpha=0.45,
    )  # fmt: skip
    if (floor := _floor_path(plan)) is not None:
        image.set_clip_path(floor, axes.transData)
    bar = figure.colorbar(image, ax=axes, shrink=0.8, pad=0.01, fraction=0.04, aspect=30)
    bar.set_label("mean strength of the best access point [dBm]")


def _floor_path(plan: Floorplan) -> Any:
    """The rooms as a path, to which cells at the outer walls are cut; None if they do not cover the floor."""
    from matplotlib.path import Path as Outline

    corners = [np.asarray(room.polygon_m, float) for room in plan.rooms]
    areas_m2 = [0.5 * float(np.sum(x * np.roll(y, -1) - y * np.roll(x, -1))) for x, y in (c.T for c in corners)]
    if np.abs(areas_m2).sum() < ROOMS_COVER * plan.floor_area_m2:
        return None
    ways = [c if area > 0 else c[::-1] for c, area in zip(corners, areas_m2, strict=True)]
    return Outline.make_compound_path(*(Outline(np.vstack([way, way[:1]]), closed=True) for way in ways))
