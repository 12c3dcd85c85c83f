"""The leaderboard as one HTML page that needs no other file."""

from __future__ import annotations

import base64
import math
import re
from collections.abc import Sequence
from html import escape
from importlib.resources import files
from pathlib import Path

from twc_env.suite.entries import REFERENCES
from twc_env.suite.standings import Row, Standings
from twc_env.suite.tables import COLUMNS, TWINS_TITLE, cells_of, groups_of, interval_of, title_of, twin_cells

BAR_PX = (160, 14)
"""Width and height of a drawn interval."""
DEFINITIONS = {
    "score": "interquartile mean over buildings of {score}, with its 95 % stratified bootstrap interval",
    "probability of improvement": "of scoring higher than the best other team in the same building; references do not "
    "count as others",
    "mean coverage": "area under the curve of the floor mapped correctly by the best correctly merged group, divided "
    "by the budget of time",
    "wrong merges": "pairs of robots whose maps were merged wrongly at some time, over all episodes",
    "times": "medians of simulated time: until all robots share one correct map, and until 50, 90 and 99 % of the "
    "floor are mapped correctly; - if half of the teams never get there",
    "ATE, sent, path, collisions": "means over buildings, of the whole team",
    "stuck": "share of the time in which a robot that was told to move stayed in place",
}


def page_of(standings: Standings, title: str, lead: str, pictures: Sequence[tuple[str, Path]]) -> str:
    """The page; pictures: captions and PNG files, which are put into it."""
    drawn = [
        f'<h2>{escape(caption)}</h2>\n<img alt="{escape(caption)}" src="data:image/png;base64,'
        f'{base64.b64encode(path.read_bytes()).decode("ascii")}">'
        for caption, path in pictures
    ]
    tables = [_table(standings, group) for group in groups_of(standings)]
    if twins := twin_cells(standings):
        tables.append(_framed(TWINS_TITLE, twins[0], [_row(cells) for cells in twins[1:]]))
    body = "\n".join([f"<p>{escape(lead)}</p>", _definitions(standings), tables[0], *drawn, *tables[1:]])
    template = files("twc_env.suite").joinpath("leaderboard_page.html").read_text(encoding="utf-8")
    return re.sub("__(TITLE|BODY)__", lambda gap: {"TITLE": escape(title), "BODY": body}[gap[1]], template)


def _definitions(standings: Standings) -> str:
    scaled = "(team - random) / (informed - random) of the mean coverage, both means over the buildings of a task"
    score = scaled if standings.is_normalised else "the mean coverage itself (no informed team played)"
    points = (f"<dt>{name}</dt><dd>{escape(text.format(score=score))}</dd>" for name, text in DEFINITIONS.items())
    return f"<dl>{''.join(points)}</dl>"


def _table(standings: Standings, group: str) -> str:
    rows = standings.rows_of(group)
    values = [v for row in rows for v in (row.low, row.high, row.score) if math.isfinite(v)]
    low, high = min(0.0, *values), max(1.0, *values)
    body = []
    for row, cells in zip(rows, cells_of(rows), strict=True):
        shown = [
            f'<td data-value="{row.low}">{_bar(row, low, high)}</td>'
            if cell == interval_of(row) and math.isfinite(row.low)
            else f"<td>{escape(cell)}</td>"
            for cell in cells
        ]
        kind = ' class="reference"' if row.team in REFERENCES else ""
        body.append(f"<tr{kind}>{''.join(shown)}</tr>")
    return _framed(title_of(group), [long for long, _, _ in COLUMNS], body)


def _row(cells: Sequence[str]) -> str:
    return f"<tr>{''.join(f'<td>{escape(cell)}</td>' for cell in cells)}</tr>"


def _framed(title: str, head: Sequence[str], rows: Sequence[str]) -> str:
    """A heading, and below it a table that scrolls by itself; rows: HTML."""
    cells = "".join(f"<th>{escape(cell)}</th>" for cell in head)
    table = f"<table><thead><tr>{cells}</tr></thead><tbody>{''.join(rows)}</tbody></table>"
    return f'<h2>{escape(title)}</h2>\n<div class="scroll">{table}</div>'


def _bar(row: Row, low: float, high: float) -> str:
    """The interval of a score as a line with a dot, between the lowest and highest of its table."""
    width, height = BAR_PX
    left, right, dot = (6 + (width - 12) * (v - low) / (high - low) for v in (row.low, row.high, row.score))
    middle = height / 2
    return (
        f'<svg width="{width}" height="{height}" role="img"><title>{interval_of(row)}</title>'
        f'<line x1="{left:.1f}" x2="{right:.1f}" y1="{middle}" y2="{middle}" stroke="#0072b2" stroke-width="3"/>'
        f'<circle cx="{dot:.1f}" cy="{middle}" r="4" fill="#0072b2"/></svg>'
    )
