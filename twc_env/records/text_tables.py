"""Tables as text: aligned and folded for a terminal, as CSV and as LaTeX."""

from __future__ import annotations

import csv
import io
import math
import re
from collections.abc import Mapping, Sequence
from typing import Any

GAP = "  "
_MINUS = re.compile(r"(?<![\w.:/-])-(?=\.?\d)")
"""The sign of a number, in no name or range."""


def aligned_text(rows: Sequence[Sequence[str]], width: int | None = None, left: int = 1) -> str:
    """Rows of cells as aligned columns, of which the first `left` are flush left.

    width: of the terminal in characters. Columns without room follow below, with the first column again; None: one
    block, however wide.
    """
    widths = [max(len(row[k]) for row in rows) for k in range(len(rows[0]))]
    blocks: list[list[int]] = [[0]]
    used = widths[0]
    for k in range(1, len(widths)):
        if width is not None and used + len(GAP) + widths[k] > width and len(blocks[-1]) > 1:
            blocks.append([0])
            used = widths[0]
        blocks[-1].append(k)
        used += len(GAP) + widths[k]
    parts = []
    for block in blocks:
        cells = [[row[k].ljust(widths[k]) if k < left else row[k].rjust(widths[k]) for k in block] for row in rows]
        parts.append("\n".join(GAP.join(line).rstrip() for line in cells))
    return "\n\n".join(parts)


def csv_text(rows: Sequence[Mapping[str, Any]]) -> str:
    """Rows with all digits below the names of all their keys; what does not exist is empty."""
    columns = list(dict.fromkeys(key for row in rows for key in row))
    buffer = io.StringIO()
    writer = csv.DictWriter(buffer, columns, restval="", lineterminator="\n")
    writer.writeheader()
    for row in rows:
        writer.writerow({key: "" if _is_nothing(value) else value for key, value in row.items()})
    return buffer.getvalue()


def _is_nothing(value: Any) -> bool:
    return value is None or (isinstance(value, float) and not math.isfinite(value))


def latex_table(rows: Sequence[Sequence[str]], has_head: bool = True) -> str:
    """Rows of cells as a LaTeX table (package booktabs), the first column flush left."""
    lines = [" & ".join(map(latex_text, row)) + r" \\" for row in rows]
    head = [*lines[:1], r"\midrule"] if has_head else lines[:1]
    columns = "l" + "r" * (len(rows[0]) - 1)
    ends = [rf"\begin{{tabular}}{{{columns}}}", r"\toprule"], [r"\bottomrule", r"\end{tabular}"]
    return "\n".join([*ends[0], *head, *lines[1:], *ends[1]]) + "\n"


def latex_text(text: str) -> str:
    """A text with LaTeX's special characters escaped, `+-`, and the minus of numbers, which would be a hyphen."""
    special = {"\\": r"\textbackslash{}", "~": r"\textasciitilde{}", "^": r"\textasciicircum{}"}
    escaped = "".join(special.get(sign, rf"\{sign}" if sign in "&%$#_{}" else sign) for sign in text)
    return _MINUS.sub("$-$", escaped.replace("+-", r"$\pm$"))


def flat(values: Mapping[str, Any]) -> dict[str, Any]:
    """Values in one row: those of tables within as `closures.accepted`, lists as text."""
    row: dict[str, Any] = {}
    for key, value in values.items():
        if isinstance(value, Mapping):
            row |= {f"{key}.{part}": item for part, item in flat(value).items()}
        else:
            row[key] = "; ".join(map(str, value)) if isinstance(value, (list, tuple)) else value
    return row
