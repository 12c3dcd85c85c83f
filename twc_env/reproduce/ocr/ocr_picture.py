"""A picture of rendered signs and of the error table."""

from __future__ import annotations

import itertools
import math
from pathlib import Path

import numpy as np

from twc_env.pictures.style import SIGNAL_MAP, TEAMS, new_figure, save_figure, style
from twc_env.records.random_streams import random_stream
from twc_env.reproduce.ocr.ocr import held_out_texts, rates
from twc_env.world.sensors.misreading import TableReader, codes_of, draw_count
from twc_env.world.sensors.ocr import read_signs
from twc_env.world.sensors.ocr_table import load_table
from twc_env.world.sensors.sign_picture import View, draw_plate, expose, picture

SAMPLES = (
    ("B114 CLEANROOM", View(30.0, 0.3)),
    ("FIRE EXTINGUISHER", View(14.0, 0.0)),
    ("A302 CERAMICS", View(14.0, 1.0)),
    ("ESD WRIST STRAPS", View(9.0, 0.0)),
    ("A301 OPTICS LAB", View(6.5, -0.5)),
    ("QUIET PLEASE", View(14.0, 0.0, 5.0)),
    ("RACK PLAN NORTH", View(14.0, 0.0, 8.0)),
    ("A12 GENETICS", View(14.0, 0.5, 0.0, (0.0, 0.4))),
)
DRAWS = 300


def draw_table(path: Path, dpi: float | None = None) -> Path:
    """Write the picture: sample signs with their readings, then rates against height, incidence and blur.

    The suffix names the format; returns the path.
    """
    with style():
        figure = new_figure((11.0, 6.6), dpi=100)
        top, bottom = figure.subfigures(2, 1, squeeze=False, height_ratios=(1.0, 1.6))[:, 0]
        top.suptitle("Signs as a camera sees them, and what the OCR reads", fontsize=10)
        bottom.suptitle("How often it reads rightly, by size, angle and blur of a sign", fontsize=10)
        _draw_samples(top.subplots(2, 4))
        _draw_rates(bottom.subplots(1, 3))
    return save_figure(figure, path, dpi)


def _draw_samples(axes) -> None:
    random = random_stream(0, "ocr picture")
    for axis, (text, view) in zip(axes.ravel(), SAMPLES, strict=True):
        plate = draw_plate(random)
        (reading,) = read_signs([text], [plate], [view], random)
        axis.imshow(expose(picture(text, plate, view, random), random))
        axis.set_title(f"{view.height_px:g} px: {f'“{reading}”' if reading else 'not read'}")
        axis.axis("off")


def _draw_rates(axes) -> None:
    table = load_table()
    heights = np.geomspace(table.height_px[0], table.height_px[-1], 24)
    degrees = np.degrees(table.incidence_rad)
    clear = np.array([[_rates(h, a, 0.0) for a in np.linspace(0.0, table.incidence_rad[-1], 12)] for h in heights])
    for axis, which, name in ((axes[0], 0, "read exactly"), (axes[1], 1, "mean similarity to the truth")):
        image = axis.pcolormesh(
            heights,
            np.linspace(0.0, degrees[-1], 12),
            clear[:, :, which].T,
            vmin=0,
            vmax=1,
            shading="gouraud",
            cmap=SIGNAL_MAP,
        )
        axis.set(xscale="log", xlabel="capital height [px]", ylabel="incidence [degrees]", title=name)
        axis.figure.colorbar(image, ax=axis)
    for blur, colour in zip((0.0, 0.2, 0.4, 0.55), TEAMS, strict=False):
        curve = [_rates(h, 0.0, blur)[1] for h in heights]
        axes[2].plot(heights, curve, color=colour)
        axes[2].annotate(
            f"blur {blur:g}", (heights[-1], curve[-1]), (4, -9 if blur == 0.2 else 0), textcoords="offset points",
            va="center", color=colour,
        )  # fmt: skip
    axes[2].set(xscale="log", xlabel="capital height [px]", ylabel="mean similarity", ylim=(0, 1))
    axes[2].set(title="head-on, by blur in capital heights", xlim=(4.5, 62))
    axes[2].grid(alpha=0.3)
    axes[2].spines[["top", "right"]].set_visible(False)
    for axis in axes:
        axis.set_xticks([5, 7, 10, 15, 20, 30], ["5", "7", "10", "15", "20", "30"])
        axis.minorticks_off()


def _rates(height_px: float, incidence_rad: float, blur_widths: float) -> tuple[float, float]:
    """Exact share and mean similarity of drawn readings of held-out texts."""
    random, reader = random_stream(0, "ocr rates"), TableReader(load_table())
    texts = list(itertools.islice(itertools.cycle(held_out_texts()), DRAWS))
    blur_px = blur_widths * height_px * math.cos(incidence_rad)
    readings = []
    for text in texts:
        draws, hidden = random.standard_normal(draw_count(text)), np.zeros(len(text), np.bool_)
        readings.append(reader.read(codes_of(text), hidden, height_px, incidence_rad, blur_px, draws))
    return rates(texts, readings)
