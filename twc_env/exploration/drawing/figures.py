"""What all matplotlib figures share: a canvas without a window, titles that fit, one legend style, files of any format.

matplotlib is imported only when a figure is made (extra `viz`).
"""

from __future__ import annotations

import io
import textwrap
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from twc_env.errors import ConfigError, DataError
from twc_env.exploration.drawing.palette import INK
from twc_env.records.whole_file import whole_file

FORMATS = ("png", "pdf", "svg")
DPI = 130
TITLE_POINTS, LEGEND_POINTS = 10.0, 8.0
TITLE_SHARE = 0.97
"""Share of the figure's width that a title may fill."""
_STYLE = {
    "font.size": 8.0, "axes.titlesize": 9.0, "axes.labelsize": 8.5, "xtick.labelsize": 7.5, "ytick.labelsize": 7.5,
    "text.color": INK, "axes.labelcolor": INK, "axes.edgecolor": INK, "xtick.color": INK, "ytick.color": INK,
    "axes.linewidth": 0.7, "svg.hashsalt": "twc_env", "svg.fonttype": "none", "pdf.fonttype": 42,
}  # fmt: skip


def require_matplotlib() -> None:
    """Raise ConfigError without matplotlib."""
    if find_spec("matplotlib") is None:
        raise ConfigError("pictures need matplotlib: run `pip install 'twc_env[viz]'`")


@contextmanager
def style() -> Iterator[None]:
    """A context in which figures are made and saved, with our fonts and colours of axes. Letters that the fonts lack,
    as in the signs of a user's plan, are boxes without a warning. Raises ConfigError without matplotlib."""
    require_matplotlib()
    import matplotlib

    with matplotlib.rc_context(_STYLE), warnings.catch_warnings():
        warnings.filterwarnings("ignore", r"Glyph \d+ .* missing from")
        yield


def new_figure(size_in: tuple[float, float], dpi: float = DPI) -> Any:
    """A figure with a canvas that opens no window, which leaves pyplot and its backend alone; a notebook shows it."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    figure = _figure_class()(figsize=size_in, dpi=dpi, layout="constrained")
    FigureCanvasAgg(figure)
    return figure


@cache
def _figure_class() -> Any:
    from matplotlib.figure import Figure

    class ShownFigure(Figure):
        """A figure that notebooks show without pyplot."""

        def _repr_png_(self) -> bytes:
            buffer = io.BytesIO()
            self.savefig(buffer, format="png", metadata={"Software": None})
            return buffer.getvalue()

    return ShownFigure


def set_title(figure: Any, lines: Sequence[str], points: float = TITLE_POINTS) -> Any:
    """Write a title above everything, at the left; lines that are wider than the figure are broken."""
    title = figure.suptitle(
        "\n".join(lines), x=0.012, ha="left", fontsize=points, color=INK, parse_math=False, linespacing=1.25
    )
    renderer, room = figure.canvas.get_renderer(), TITLE_SHARE * figure.bbox.width
    fitting: list[str] = []
    for line in lines:
        title.set_text(line)
        width = title.get_window_extent(renderer).width
        letters = max(8, int(len(line) * room / width)) if width > room else len(line) + 1
        broken = textwrap.wrap(line, letters) or [""]
        while letters > 8 and any(_width(title, part, renderer) > room for part in broken):
            letters -= 2
            broken = textwrap.wrap(line, letters)
        fitting += broken
    title.set_text("\n".join(fitting))
    return title


def _width(text: Any, content: str, renderer: Any) -> float:
    text.set_text(content)
    return float(text.get_window_extent(renderer).width)


def legend_below(figure: Any, handles: Sequence[Any], names: Sequence[str], **settings: Any) -> Any:
    """One legend below all axes, in as many columns as fit the width."""
    from matplotlib.legend_handler import HandlerTuple

    shown = {"fontsize": LEGEND_POINTS, "frameon": False, "handlelength": 2.6, "columnspacing": 1.6, **settings}
    legend, columns = None, min(len(names), 6)
    while columns:
        if legend is not None:
            legend.remove()
        legend = figure.legend(
            list(handles), list(names), loc="outside lower center", ncols=columns,
            handler_map={tuple: HandlerTuple(ndivide=1, pad=0.0)}, **shown,
        )  # fmt: skip
        if legend.get_window_extent(figure.canvas.get_renderer()).width <= TITLE_SHARE * figure.bbox.width:
            break
        columns -= 1
    return legend


def settle(figure: Any) -> None:
    """Lay the figure out now and keep that layout, so that what is placed by pixels afterwards stays in place."""
    figure.draw_without_rendering()
    figure.set_layout_engine("none")


def fit_height(figure: Any, axes: Any, ratio: float, height_max_in: float) -> None:
    """Make the figure so high that its only axes have this ratio of height to width, at most `height_max_in` high."""
    for _ in range(2):  # the second time for ticks that have changed
        figure.draw_without_rendering()
        box = axes.get_position(original=True)
        width_in, height_in = figure.get_size_inches()
        wanted_in = height_in + ratio * box.width * width_in - box.height * height_in
        figure.set_size_inches(width_in, min(wanted_in, height_max_in))


def save_figure(figure: Any, path: Path, dpi: float | None = None) -> Path:
    """Write a figure in the format of the path's suffix, .png without one; the same figure gives the same bytes.

    Returns the path. Raises DataError for an unknown format, or if the file cannot be written.
    """
    path = Path(path)
    if not path.suffix:
        path = path.with_name(f"{path.name}.png")
    kind = path.suffix[1:].lower()
    if kind not in FORMATS:
        raise DataError(f"cannot write the picture {path}: pictures are {', '.join(FORMATS)}; name one of these")
    undated: dict[str, dict[str, Any]] = {
        "png": {"Software": None}, "pdf": {"CreationDate": None}, "svg": {"Date": None},
    }  # fmt: skip
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with style(), whole_file(path) as beside:
            figure.savefig(beside, dpi=dpi or DPI, format=kind, metadata=undated[kind])
    except OSError as error:
        raise DataError(f"cannot write the picture {path}: {error.strerror}; name a place elsewhere") from error
    return path
