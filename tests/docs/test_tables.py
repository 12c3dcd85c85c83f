"""Tables of the pages are those that the named commands wrote: their rows lie in docs/data/results.

A marker before a table names the file and the fields of each column:

    <!-- rows: intel.json
    | * | {translation_error_m:.3f} | {rotation_error_deg:.2f} |
    -->

`*` is a cell of words. One such line is the form of every line of the table, in the order of the rows of the file, or
of those `where FIELD=VALUE, VALUE`. With `each FIELD, FIELD by FIELD, FIELD` a line is made of all rows that share the
first, which the values of the others name: `{ours[k_accuracy]}`; with `by` alone it is made of all rows. `having
seeds=20` asks this of all rows. With `rows: of` several files, `{merging[0][team_ate_m]}` is in the first row of
merging.json. Several forms are one for each line, one after `3 times` for three; if there are more lines, they begin
again. `:.0h` is a percentage without its sign, `:.2c` a share given in percent, `:.1m` is in thousandths (millimetres),
`:.2M` in millions; what the file has no value for is a dash.
A CSV file of episodes has its columns by agent or map: `{compare[voronoi][team_ate_m].mean:.3f}`.

Every page is looked at. A table with figures that is compared with nothing says so below it, or its page does.
"""

import csv
import json
import re
from collections import Counter
from pathlib import Path
from typing import NamedTuple

import pytest

DOCS = Path(__file__).parents[2] / "docs"
PAGES = sorted(DOCS.rglob("*.md"))
UNCHECKED = "*Not checked against a stored file"
UNCHECKED_PAGE = "*No table of this page is checked against a stored file"
FIGURE = re.compile(r"[*`(<>≈~≤≥]*\s*[+−-]?\.?\d")  # the beginning of a cell


class Number(float):
    """A number that can be shown as a percentage (`:.0h`), in thousandths (`:.1m`), in hundreds (`:.2c`) or in millions
    (`:.2M`)."""

    def __format__(self, form: str) -> str:
        times = {"h": 100, "m": 1000, "c": 0.01, "M": 1e-6}.get(form[-1:])
        return format(times * self, form[:-1] + "f") if times else format(float(self), form)


class Gap:
    """What a file has no value for."""

    def __format__(self, form: str) -> str:
        return "-"


class Column(list):
    """Numbers of all episodes of a team or map."""

    mean = property(lambda self: sum(self) / len(self))
    worst = property(max)
    count = property(len)
    full = property(lambda self: sum(number == max(self) for number in self))  # how many have the greatest value
    any = property(lambda self: sum(number > 0 for number in self))


class Table(NamedTuple):
    """A table of a page."""

    page: str
    marker: str
    lines: list[list[str]]
    after: str
    """The two lines below it, and the page's own remark."""


def cells(line: str) -> list[str]:
    return [cell.strip() for cell in line.strip().strip("|").split("|")]


def tables(page: str, text: str) -> list[Table]:
    text += "\n\n"
    of_all = UNCHECKED if UNCHECKED_PAGE in text else ""
    found = []
    pattern = r"(?:<!-- rows: ([^>]*?)-->\n+)?((?:^\|.*\n)+)(?=([^\n]*\n[^\n]*))"  # another table may come at once
    for marker, block, after in re.findall(pattern, text, re.MULTILINE):
        lines = [cells(line) for line in block.splitlines()[2:]]
        found.append(Table(page, marker, lines, after + of_all))
    return found


ALL = [table for page in PAGES for table in tables(str(page.relative_to(DOCS)), page.read_text())]
MARKED = [table for table in ALL if table.marker]


def stored(file: str):
    """Content of a stored file, its numbers with the additional format; of a CSV file, columns by agent or map."""
    text = (DOCS / "data/results" / file).read_text()
    if file.endswith(".json"):
        return json.loads(text, parse_float=Number)
    columns: dict = {}
    rows: Counter = Counter()
    for row in csv.DictReader(text.splitlines()):
        for owner in filter(None, (row.get("agent"), row["map"])):
            own = columns.setdefault(owner, {})
            rows[owner] += 1
            for name, value in row.items():
                if re.fullmatch(r"-?\d+(\.\d+)?(e[+-]?\d+)?", value or ""):
                    own.setdefault(name, Column()).append(float(value))
    return {  # what some episodes lack has no mean
        owner: {name: column for name, column in own.items() if len(column) == rows[owner]}
        for owner, own in columns.items()
    }


def spaces(marker: str) -> tuple[list[str], list[dict]]:
    """The forms of a marker, and for each line of the table what the names in its form stand for."""
    head, *lines = [line for line in marker.splitlines() if line.strip()]
    counts = [re.fullmatch(r"(?:(\d+) times )?(\|.*)", line).groups() for line in lines]
    forms = [form for times, form in counts for _ in range(int(times or 1))]
    if head.startswith("of "):
        return forms, [{Path(file).stem: stored(file) for file in head.split()[1:]}]
    file, *clauses = re.split(r" (?=where |by |each |having )", head.strip())
    asked, rows = dict(clause.split(" ", 1) for clause in clauses), stored(file)
    if "having" in asked:
        field, _, value = asked["having"].partition("=")
        assert {str(row[field]) for row in rows} == {value}
    if "where" in asked:
        field, _, values = asked["where"].partition("=")
        rows = [row for row in rows if str(row[field]) in values.split(", ")]
    if "by" not in asked:
        return forms, rows
    groups: dict = {}
    for row in rows:
        shared = tuple(row[key] for key in asked["each"].split(", ")) if "each" in asked else None
        group = groups.setdefault(shared, dict(row))
        name = " ".join(str(row[key]) for key in asked["by"].split(", "))
        assert name not in group, f"two rows of {file} are named {name}"
        group[name] = row
    return forms, list(groups.values())


def expected(marker: str) -> list[list[str]]:
    """The cells of the lines of a table as its files have them; `*` where they are words."""
    forms, names = spaces(marker)
    names = names * len(forms) if len(names) == 1 else names
    forms = forms * (len(names) // len(forms))
    shown = [{name: Gap() if value is None else value for name, value in space.items()} for space in names]
    return [[cell.format(**space) for cell in cells(form)] for form, space in zip(forms, shown, strict=True)]


@pytest.mark.parametrize("table", MARKED, ids=[f"{table.page} {table.marker.split()[0]}" for table in MARKED])
def test_the_figures_of_a_table_are_those_of_its_file(table):
    wanted = expected(table.marker)
    shown = [
        ["*" if said == "*" else cell for cell, said in zip(line, form, strict=True)]
        for line, form in zip(table.lines, wanted, strict=True)
    ]
    assert shown == wanted


def test_a_table_of_figures_is_checked_or_says_that_it_is_not():
    rest = [table for table in ALL if unchecked(table) and UNCHECKED not in table.after]
    assert [(table.page, table.lines[0]) for table in rest] == []


def test_a_table_that_is_checked_does_not_say_that_it_is_not():
    assert [(t.page, t.marker) for t in MARKED if not unchecked(t) and UNCHECKED in t.after] == []


def test_every_marker_stands_before_a_table():
    assert sum(page.read_text().count("<!-- rows:") for page in PAGES) == len(MARKED)


def test_tables_that_follow_each_other_are_both_looked_at():
    first, second = tables("a.md", "| a | b |\n|---|---|\n| x | 1 |\n\n| c | d |\n|---|---|\n| y | 2 |\n| z | 3 |\n")
    assert (first.lines, second.lines) == ([["x", "1"]], [["y", "2"], ["z", "3"]])


def test_a_column_with_a_gap_has_no_mean(tmp_path, monkeypatch):
    monkeypatch.setattr("tests.docs.test_tables.DOCS", tmp_path)
    (tmp_path / "data/results").mkdir(parents=True)
    rows = "agent,map,ate_m,bytes,goal_s\nours,a,0.5,1e+16,3\nours,b,1.5,3e+16,\nours,c,2.5,5e+16,nan\n"
    (tmp_path / "data/results/episodes.csv").write_text(rows)
    found = stored("episodes.csv")["ours"]
    assert (found["ate_m"].mean, found["bytes"].mean) == (1.5, 3e16) and "goal_s" not in found


@pytest.mark.parametrize("cell", ["0.5", "**.5 m**", "< 3 %", "≈ 2", "~4", "≥ .9", "−0.1", "(+1)"])
def test_cells_of_figures_are_seen(cell):
    assert FIGURE.match(cell)


def unchecked(table: Table) -> list[str]:
    """Cells that begin with a number and are compared with nothing, but for the first of each line, which names it."""
    forms = expected(table.marker) if table.marker else [["*"] * len(line) for line in table.lines]
    return [
        c
        for line, form in zip(table.lines, forms, strict=True)
        for c, f in zip(line[1:], form[1:], strict=True)
        if f == "*" and FIGURE.match(c)
    ]


def test_every_stored_table_is_checked():
    kept = {path.name for path in (DOCS / "data/results").glob("*.*")}
    assert kept == {
        file for table in MARKED for file in re.findall(r"[\w.-]+\.(?:json|csv)", table.marker.splitlines()[0])
    }
