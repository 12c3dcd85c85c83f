"""A leaderboard as text: for the terminal, Markdown, LaTeX and CSV."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

from twc_env.agents.roster import display_name
from twc_env.records.text_tables import aligned_text, latex_text
from twc_env.suite.entries import NO_RIVALS
from twc_env.suite.standings import ALL, Row, Standings

ABSENT = "-"
"""Stands for a number that does not exist: a time that half of the teams did not reach, an interval of one building."""


def _plain(form: str, factor: float = 1.0) -> Callable[[float], str]:
    return lambda value: format(value * factor, form) if math.isfinite(value) else ABSENT


def _rounded(value: float) -> str:
    """Three decimal places, and no minus before zero."""
    return f"{round(value, 3) + 0.0:.3f}"


COLUMNS: tuple[tuple[str, str, Callable[[Row], str]], ...] = (
    ("team", "team", lambda row: display_name(row.team)),
    ("score", "score", lambda row: _rounded(row.score)),
    ("95 % interval", "95 %", lambda row: interval_of(row)),
    ("probability of improvement", "P(improve)", lambda row: _plain(".2f")(row.improvement)),
    ("mean coverage", "mean cov.", lambda row: f"{row.coverage_mean:.3f}"),
    ("coverage at the end", "end cov.", lambda row: f"{row.coverage_end:.3f}"),
    ("wrong merges", "wrong", lambda row: str(row.wrong_merges)),
    ("one map after [s]", "one map s", lambda row: _plain(".0f")(row.merged_s)),
    ("ATE [m]", "ATE m", lambda row: f"{row.ate_m:.3f}"),
    ("sent [MB]", "MB", lambda row: _plain(".2f", 1e-6)(row.bytes_sent)),
    ("path [m]", "path m", lambda row: _plain(".0f")(row.path_m)),
    ("collisions", "coll.", lambda row: _plain(".1f")(row.collisions)),
    ("stuck [%]", "stuck %", lambda row: f"{100 * row.stuck_share:.1f}"),
    ("to 50 % [s]", "50 % s", lambda row: _plain(".0f")(row.to_50_s)),
    ("to 90 % [s]", "90 % s", lambda row: _plain(".0f")(row.to_90_s)),
    ("to 99 % [s]", "99 % s", lambda row: _plain(".0f")(row.to_99_s)),
)
"""Long title, short title and cell of each column."""


def interval_of(row: Row) -> str:
    """The interval of the score."""
    return f"{_rounded(row.low)} to {_rounded(row.high)}" if math.isfinite(row.low) else ABSENT


def cells_of(rows: Sequence[Row]) -> list[list[str]]:
    """The cells of all columns, row by row."""
    return [[cell(row) for _, _, cell in COLUMNS] for row in rows]


def title_of(task: str) -> str:
    """The name of a task as a heading."""
    return "All tasks" if task == ALL else task.partition("/")[2] or task


def groups_of(standings: Standings) -> list[str]:
    """What has a table of its own: all tasks together, then each."""
    return list(dict.fromkeys(row.task for row in standings.rows))


TWINS_TITLE = "Teams aware of SLAM and their blind twins"
_TWIN_HEAD = (
    "task",
    "team - twin",
    "buildings",
    "lead in mean coverage",
    "95 % interval",
    "one map after [s]",
    "twin [s]",
)


def twin_cells(standings: Standings) -> list[list[str]]:
    """A head, and a row per task and team whose twin has played; empty if none has."""
    rows = [
        [
            title_of(row.task), f"{row.team} - {row.twin}", str(row.buildings), f"{row.lead:+.3f}",
            f"{row.low:+.3f} to {row.high:+.3f}" if math.isfinite(row.low) else ABSENT,
            _plain(".0f")(row.merged_s), _plain(".0f")(row.twin_merged_s),
        ]
        for row in standings.twins
    ]  # fmt: skip
    return [list(_TWIN_HEAD), *rows] if rows else []


def text_of(standings: Standings, width: int | None = None) -> str:
    """Aligned tables for a terminal of this width; None: not folded."""
    parts = []
    for group in groups_of(standings):
        lines = [[short for _, short, _ in COLUMNS], *cells_of(standings.rows_of(group))]
        parts.append("\n".join([title_of(group), aligned_text(lines, width)]))
    if twins := twin_cells(standings):
        parts.append("\n".join([TWINS_TITLE, aligned_text(twins, width, left=2)]))
    return "\n\n".join(parts)


def markdown_of(standings: Standings, lead: str) -> str:
    """Markdown tables below a lead paragraph."""
    parts = [lead]
    for group in groups_of(standings):
        rows = [[long for long, _, _ in COLUMNS], ["---", *["---:"] * (len(COLUMNS) - 1)]]
        rows += cells_of(standings.rows_of(group))
        parts.append(f"## {title_of(group)}\n\n" + "\n".join(f"| {' | '.join(row)} |" for row in rows))
    if twins := twin_cells(standings):
        rows = [twins[0], ["---", "---", *["---:"] * (len(twins[0]) - 2)], *twins[1:]]
        parts.append(f"## {TWINS_TITLE}\n\n" + "\n".join(f"| {' | '.join(row)} |" for row in rows))
    return "\n\n".join(parts) + "\n"


def latex_of(standings: Standings) -> str:
    """One LaTeX table (package booktabs): a row per team, a column per task, scores with their intervals; the best
    score of each task that is no reference is bold."""
    groups, cells = groups_of(standings), {(row.task, row.team): row for row in standings.rows}
    best = {
        group: next((r.team for r in standings.rows_of(group) if r.team not in NO_RIVALS), None) for group in groups
    }
    order = [row.team for row in standings.rows_of(groups[0])]
    lines = [
        rf"\begin{{tabular}}{{l{'r' * len(groups)}}}", r"\toprule",
        " & ".join(["team", *(title_of(group) for group in groups)]).replace("_", r"\_") + r" \\", r"\midrule",
    ]  # fmt: skip
    for team in order:
        shown = [_latex_cell(cells[group, team], team == best[group]) for group in groups]
        lines.append(" & ".join([latex_text(display_name(team)), *shown]) + r" \\")
    return "\n".join([*lines, r"\bottomrule", r"\end{tabular}"]) + "\n"


def _latex_cell(row: Row, is_best: bool) -> str:
    score = rf"\textbf{{{_rounded(row.score)}}}" if is_best else _rounded(row.score)
    return f"{score} [{_rounded(row.low)}, {_rounded(row.high)}]" if math.isfinite(row.low) else score
