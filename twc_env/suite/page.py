"""The leaderboard as one HTML page that needs no other file."""

from __future__ import annotations

import base64
import math
import re
from collections.abc import Sequence
from html import escape
from importlib.resources import files
from pathlib import Path

from twc_env.suite.entries import NO_RIVALS
from twc_env.suite.standings import Row, Standings
from twc_env.suite.tables import COLUMNS, TWINS_TITLE, cells_of, groups_of, interval_of, title_of, twin_cells

BAR_PX = (120, 14)
"""Width and height of a drawn interval."""
INTERVAL = 2
"""The column that is drawn."""
PICTURES = (
    "The share of the episodes whose score is above a threshold, averaged over tasks. The higher a curve, the better. "
    "Bands are 95 % intervals.",
    "The share of the floor in a correctly merged map, the best one, over simulated time in seconds: "
    "mean over buildings. Bands are 95 % intervals.",
)
"""Captions of the pictures."""
_CAPTION = (
    "Best score first; a click on a head sorts by that column. In italics the references that scores are measured by, "
    "which are no competitors. Dot and line: the score and its 95 % interval."
)
_TWINS_CAPTION = (
    "A twin is the same team without regard to SLAM. The lead is the difference in mean coverage in the same buildings."
)
DEFINITIONS = {
    "score": "interquartile mean over buildings of {score}, with its 95 % stratified bootstrap interval",
    "probability of improvement": "of scoring higher than the best other team in the same building; references do not "
    "count as others",
    "mean coverage": "area under the curve of the floor in a correctly merged map, the best one, divided by the budget "
    "of time",
    "coverage at the end": "the last value of that curve, mean over buildings",
    "wrong merges": "pairs of robots whose maps were merged wrongly at some time, over all episodes",
    "times [s]": "medians of simulated time: until all robots share one correct map, and until 50, 90 and 99 % of the "
    "floor are in such a map; - if half of the teams never get there",
    "ATE, sent, path, collisions": "means over buildings, of the whole team",
    "stuck [%]": "share of the time in which a robot that was told to move stayed in place",
}


def page_of(standings: Standings, title: str, lead: str, pictures: Sequence[tuple[str, Path]]) -> str:
    """The page; pictures: captions and PNG files, which are put into it."""
    drawn = [
        f'<figure><h2>{escape(heading)}</h2>\n<figcaption>{escape(caption)}</figcaption>\n<img alt="{escape(heading)}" '
        f'src="data:image/png;base64,{base64.b64encode(path.read_bytes()).decode("ascii")}"></figure>'
        for (heading, path), caption in zip(pictures, PICTURES, strict=False)
    ]
    groups = groups_of(standings)
    tables = [_table(standings, group) for group in groups]
    links = "".join(f'<a href="#{_anchor(group)}">{escape(title_of(group))}</a>' for group in groups)
    parts = [f"<p>{escape(lead)}</p>", f"<nav>{links}</nav>", tables[0], *drawn, *tables[1:]]
    body = "\n".join([*parts, *_twins(standings), _definitions(standings)])
    template = files("twc_env.suite").joinpath("leaderboard_page.html").read_text(encoding="utf-8")
    return re.sub("__(TITLE|BODY)__", lambda gap: {"TITLE": escape(title), "BODY": body}[gap[1]], template)


def _anchor(group: str) -> str:
    return escape(title_of(group).replace(" ", "-"))


def _definitions(standings: Standings) -> str:
    scaled = "(team - random) / (informed - random) of the mean coverage, both means over the buildings of a task"
    score = scaled if standings.is_normalised else "the mean coverage itself (no informed team played)"
    points = (f"<dt>{name}</dt><dd>{escape(text.format(score=score))}</dd>" for name, text in DEFINITIONS.items())
    return f"<h2>What the columns mean</h2>\n<dl>{''.join(points)}</dl>"


def _table(standings: Standings, group: str) -> str:
    rows = standings.rows_of(group)
    values = [v for row in rows for v in (row.low, row.high, row.score) if math.isfinite(v)]
    low, high = min(0.0, *values), max(1.0, *values)
    heads = [_button(long) for long, _, _ in COLUMNS]
    heads[INTERVAL] += _axis(low, high)
    best = next((row for row in rows if row.team not in NO_RIVALS), None)
    body = []
    for row, cells in zip(rows, cells_of(rows), strict=True):
        shown = [
            f'<td data-value="{row.low}">{_bar(row, low, high)}<small>{escape(cell)}</small></td>'
            if cell == interval_of(row) and math.isfinite(row.low)
            else f"<td>{escape(cell)}</td>"
            for cell in cells[1:]
        ]
        kind = ' class="reference"' if row.team in NO_RIVALS else ' class="best"' if row is best else ""
        body.append(f'<tr{kind}><th scope="row">{escape(cells[0])}</th>{"".join(shown)}</tr>')
    return _titled(group, _CAPTION, heads, body)


def _button(text: str) -> str:
    """What is clicked to sort by a column."""
    return f"<button>{escape(text)}</button>"


def _titled(group: str, caption: str, heads: Sequence[str], body: Sequence[str]) -> str:
    """A table below its heading and caption."""
    head = "".join(f'<th scope="col">{text}</th>' for text in heads)
    table = f"<table><thead><tr>{head}</tr></thead><tbody>{''.join(body)}</tbody></table>"
    heading = f'<h2 id="{_anchor(group)}">{escape(title_of(group))}</h2>'
    return f'{heading}\n<p class="caption">{escape(caption)}</p>\n<div class="scroll">{table}</div>'


def _twins(standings: Standings) -> list[str]:
    """The table of teams aware of SLAM, if a twin of one has played."""
    if not (lines := twin_cells(standings)):
        return []
    body = [
        f'<tr><th scope="row">{escape(task)}</th>{"".join(f"<td>{escape(cell)}</td>" for cell in cells)}</tr>'
        for task, *cells in lines[1:]
    ]
    return [_titled(TWINS_TITLE, _TWINS_CAPTION, [_button(head) for head in lines[0]], body)]


def _bar(row: Row, low: float, high: float) -> str:
    """The interval of a score as a line with a dot, between the lowest and highest of its table."""
    width, height = BAR_PX
    left, right, dot = (_place(v, low, high) for v in (row.low, row.high, row.score))
    return (
        f'<svg width="{width}" height="{height}" role="img"><title>{interval_of(row)}</title>{_marks(low, high)}'
        f'<path d="M{left:.1f} {height / 2}H{right:.1f}" stroke-width="3"/>'
        f'<circle cx="{dot:.1f}" cy="{height / 2}" r="4"/></svg>'
    )


def _axis(low: float, high: float) -> str:
    """The numbers 0 and 1 above the lines that mark them."""
    texts = "".join(f'<text x="{_place(value, low, high):.1f}" y="12">{value}</text>' for value in (0, 1))
    return f'<svg class="axis" width="{BAR_PX[0]}" height="{BAR_PX[1]}">{texts}</svg>'


def _marks(low: float, high: float) -> str:
    places = (_place(value, low, high) for value in (0, 1))
    return "".join(f'<path class="mark" d="M{place:.1f} 0V{BAR_PX[1]}"/>' for place in places)


def _place(value: float, low: float, high: float) -> float:
    """Pixels from the left of a bar."""
    return 6 + (BAR_PX[0] - 12) * (value - low) / (high - low)
