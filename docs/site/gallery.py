"""Draw the small pictures of docs/gallery.md: `python docs/site/gallery.py`, or some of them by the ids of their tasks
and the names of their maps.

A map is drawn with signs, access points and signal strength. A task is played by the scripted team for a third of its
budget, and drawn with what has been mapped. Neither has texts, which could not be read at this size, nor a ground, so
that the pictures also stand on a dark page.
"""

from __future__ import annotations

import dataclasses
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from twc_env.agents.explore import explore

from twc_env import load_map
from twc_env.config import override
from twc_env.pictures.map_picture import plan_figure
from twc_env.pictures.style import save_figure
from twc_env.tasks import SUITES, task_config

PICTURES = Path(__file__).resolve().parents[1] / "pictures"
MAPS = (*(f"gen:{kind}:800:7" for kind in ("office", "ring", "ward", "warehouse")), "gen:mall:1500:7")
SEED = 1
SIDE_IN, DPI = 4.4, 100
"""The longer side of a picture, and its resolution."""


def picture_of(name: str) -> Path:
    """Where the picture of a task or a map lies."""
    if name.startswith("twc/"):
        return PICTURES / "tasks" / f"{name.removeprefix('twc/').lower()}.png"
    return PICTURES / "maps" / f"{name.replace(':', '-')}.png"


def figure_of_task(task: str, steps: int | None = None) -> Any:
    """What the scripted team has mapped after so many steps, by default a third of the budget."""
    config = task_config(task)
    config = override(config, {"max_cycles": steps or config.max_cycles // 3})
    result = explore(config, "nearest-frontier", SEED).result
    plan = dataclasses.replace(result.floorplan, signs=(), access_points=())
    return dataclasses.replace(result, floorplan=plan, closures=[]).plot()


def small(figure: Any) -> Any:
    """The figure without texts, axes and ground, reduced to `SIDE_IN`."""
    axes, *scales = figure.axes
    for part in (*scales, *figure.legends, *axes.texts):
        part.remove()
    figure.suptitle("")
    figure.set_layout_engine("none")
    figure.set_facecolor("none")
    axes.set_axis_off()
    axes.set_position((0.0, 0.0, 1.0, 1.0))
    (x0, x1), (y0, y1) = axes.get_xlim(), axes.get_ylim()
    longer = max(x1 - x0, y1 - y0)
    figure.set_size_inches(SIDE_IN * (x1 - x0) / longer, SIDE_IN * (y1 - y0) / longer)
    return figure


def main(names: Sequence[str] = ()) -> None:
    """Draw all pictures, or those that are named."""
    for name in names or (*SUITES["v1"], *MAPS):
        figure = figure_of_task(name) if name.startswith("twc/") else plan_figure(load_map(name))
        print(save_figure(small(figure), picture_of(name), DPI), flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
