"""A floor plan as a picture: walls, rooms, signs, access points and signal strength. Needs matplotlib."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.errors import MapError
from twc_env.records.whole_file import whole_file
from twc_env.world.building.floorplan import Floorplan, Room
from twc_env.world.sensors.signal_map import SIGNAL_SPAN_DBM, signal_map_dbm

LABELS_MAX = 60
"""With more rooms or signs than this, names are left out, because they would overlap."""

WIDTH_INCHES, HEIGHT_MAX_INCHES = 12.0, 24.0
POINTS_MAX = 0.75 * 72 * WIDTH_INCHES
"""Approximate width left for the building beside axis labels and colour bar."""
_ROOM_POINTS, _SIGN_POINTS, _CHARACTER_WIDTH = 6.0, 4.5, 0.62
"""Font sizes in rooms and at signs, and the average width of a letter as a share of it."""
_SLANT_DEG = 35.0


def draw_plan(plan: Floorplan, path: str | Path, with_signal: bool = True) -> Path:
    """Write the picture and create its folder; returns the path. Raises MapError without matplotlib, or on failure."""
    try:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.collections import LineCollection, PolyCollection
        from matplotlib.figure import Figure
    except ImportError as error:
        raise MapError("drawing a map needs matplotlib; run `pip install 'twc_env[viz]'`") from error
    path = Path(path) if Path(path).suffix else Path(f"{path}.png")
    x0, y0, x1, y1 = plan.bounds_m
    width = WIDTH_INCHES
    # The height follows the building; legend and colour bar need a few centimetres more.
    figure = Figure(
        figsize=(width, float(np.clip(0.82 * width * (y1 - y0) / (x1 - x0), 3.0, HEIGHT_MAX_INCHES)) + 1.0),
        dpi=110,
        layout="constrained",
    )
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    points_per_m = min(POINTS_MAX / (x1 - x0), 72 * HEIGHT_MAX_INCHES / (y1 - y0))
    if with_signal and plan.access_points:
        _draw_signal(axes, figure, plan)
    axes.add_collection(
        PolyCollection([r.polygon_m for r in plan.rooms], facecolors="none", edgecolors="tab:green", linewidths=0.5)
    )
    losses = np.asarray(plan.wall_loss_db)
    axes.add_collection(LineCollection(list(plan.walls_m), colors="black", linewidths=0.5 + 0.15 * losses.clip(0, 12)))
    if len(plan.rooms) <= LABELS_MAX:
        name_rooms(axes, plan.rooms, points_per_m)
    margin = 0.02 * max(x1 - x0, y1 - y0)
    axes.set(xlim=(x0 - margin, x1 + margin), ylim=(y0 - margin, y1 + margin), aspect="equal")
    _draw_signs(axes, plan, points_per_m)
    if plan.access_points:
        places = np.array([a.position_m for a in plan.access_points])
        axes.plot(*places.T, "^", color="tab:purple", markersize=5, label=f"access points ({len(places)})")
    axes.set(xlabel="x [m]", ylabel="y [m]")
    axes.set_title(
        f"{plan.name}: {plan.floor_area_m2:,.0f} m2 of floor, {len(plan.rooms)} rooms, {len(plan.signs)} signs",
        parse_math=False,
    )
    if plan.signs or plan.access_points:
        figure.legend(loc="outside lower center", ncols=3, fontsize=8, frameon=False)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with whole_file(path) as beside:
            figure.savefig(beside)
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise MapError(f"cannot write the picture {path}: {reason}; name a .png elsewhere") from error
    return path


def _draw_signs(axes, plan: Floorplan, points_per_m: float) -> None:
    texts = [sign.text for sign in plan.signs]
    repeated = np.array([texts.count(text) > 1 for text in texts], bool)
    places = np.array([s.position_m for s in plan.signs]).reshape(-1, 2)
    facing = np.array([s.facing_rad for s in plan.signs])
    for mask, colour, label in ((repeated, "tab:red", "repeated signs"), (~repeated, "tab:blue", "unique signs")):
        if mask.any():
            x, y = places[mask].T
            u, v = np.cos(facing[mask]), np.sin(facing[mask])
            axes.quiver(
                x, y, u, v, color=colour, angles="xy", scale_units="dots", units="dots", scale=0.1, width=1.5,
                headwidth=4,
            )  # fmt: skip
            axes.plot([], [], ">", color=colour, markersize=5, label=f"{label} ({mask.sum()})")
    if len(plan.signs) <= LABELS_MAX:
        for sign, place, angle in zip(plan.signs, places, facing, strict=True):
            room_points = tuple(points_per_m * abs(edge - place[0]) for edge in axes.get_xlim())
            name_sign(
                axes, sign.text, place, angle, room_points=room_points, fontsize=_SIGN_POINTS, color="0.2", clip_on=True
            )


def name_rooms(axes, rooms: Sequence[Room], points_per_m: float) -> None:
    """Write the names of rooms; a name that is wider than its room gets one line per word."""
    from matplotlib.patheffects import withStroke

    for room in rooms:
        corners = np.asarray(room.polygon_m)
        width_points = points_per_m * float(np.ptp(corners[:, 0]))
        is_too_wide = len(room.name) * _CHARACTER_WIDTH * _ROOM_POINTS > width_points
        axes.text(
            *corners.mean(axis=0), "\n".join(room.name.split()) if is_too_wide else room.name, fontsize=_ROOM_POINTS,
            color="darkgreen", ha="center", va="center", clip_on=True, parse_math=False, zorder=5,
            path_effects=[withStroke(linewidth=1.5, foreground="white", alpha=0.7)],
        )  # fmt: skip


def name_sign(
    axes,
    text: str,
    place_m: Array,
    facing_rad: float,
    points: float = 9.0,
    room_points: tuple[float, float] = (math.inf, math.inf),
    **style,
) -> None:
    """Write the text of a sign in front of it, above all lines; slanted along walls, to avoid overlaps.

    room_points: room to the left and to the right; a slanted text for which one is too small goes to the other side.
    """
    from matplotlib.patheffects import withStroke

    u, v = np.cos(facing_rad), np.sin(facing_rad)
    is_beside = abs(u) > abs(v)
    to_right, slant_deg = (u if is_beside else v) > 0, 0.0 if is_beside else _SLANT_DEG
    width = len(text) * _CHARACTER_WIDTH * style.get("fontsize", _SIGN_POINTS) * math.cos(math.radians(_SLANT_DEG))
    if not is_beside and width > room_points[int(to_right)] < room_points[int(not to_right)]:
        to_right, slant_deg = not to_right, -_SLANT_DEG
    axes.annotate(
        text, place_m, (points * u, points * v), textcoords="offset points", rotation=slant_deg,
        rotation_mode="anchor", ha="left" if to_right else "right", va="center", parse_math=False, zorder=6,
        path_effects=[withStroke(linewidth=2.0, foreground="white")], **style,
    )  # fmt: skip


def _draw_signal(axes, figure, plan: Floorplan) -> None:
    signal, (x0, y0), step_m = signal_map_dbm(plan)
    low, high = SIGNAL_SPAN_DBM
    rows, columns = signal.shape
    image = axes.imshow(
        signal, origin="lower", extent=(x0, x0 + step_m * columns, y0, y0 + step_m * rows),
        cmap="viridis", vmin=low, vmax=high, alpha=0.55,
    )  # fmt: skip
    figure.colorbar(image, ax=axes, label="mean strength of the best access point [dBm]", shrink=0.8, pad=0.02)
