"""The figures of an episode as people read them: names with units, for the terminal, notebooks and LaTeX."""

from __future__ import annotations

import math
import re
import textwrap
from collections.abc import Iterable, Mapping, Sequence
from html import escape
from typing import Any

from twc_env.records.text_tables import latex_table

FIGURES = (
    ("simulated time", "sim_time_s", ".1f s"),
    ("robots in one map", "merged_robots", "d"),
    ("wrong merges", "wrong_merges", "d"),
    ("floor mapped correctly", "coverage_correct", ".1% "),
    ("floor observed", "coverage_true", ".1% "),
    ("team ATE", "team_ate_m", ".3f m"),
    ("odometry-only ATE", "odometry_ate_m", ".3f m"),
    ("end point error", "epe_m", ".3f m"),
    ("map IoU", "map_iou", ".3f"),
    ("odometry-only map IoU", "odometry_map_iou", ".3f"),
    ("wall IoU", "wall_iou", ".3f"),
    ("odometry-only wall IoU", "odometry_wall_iou", ".3f"),
    ("loop closures", "closures", ""),
    ("saved map", "found_prior", ""),
    ("path length, all robots", "path_length_m", ".1f m"),
    ("collisions", "collisions", "d"),
    ("contacts with people", "people_collisions", "d"),
    ("share of time stuck", "stuck_share", ".1% "),
    ("share of time stuck when told to move", "commanded_stuck_share", ".1% "),
    ("data transmitted", "bytes_sent", ",d bytes"),
    ("environment speed", "env_steps_per_s", ".0f steps/s"),
    ("time spent in agents", "agent_s", ".2f s"),
)
"""Name, key in the report and format with unit of each row (docs/figures.md defines them)."""
WIDTH = 100
"""Characters to which remarks are filled."""
ODOMETRY_REMARK = (
    "odometry-only figures know the true relative starts, which the robots do not know; "
    "for an unmerged team they are no rival."
)


def rows_of(figures: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Name and value of the figures that there are."""
    return [(name, value) for _, name, value in keyed_rows(figures)]


def keyed_rows(figures: Mapping[str, Any]) -> list[tuple[str, str, str]]:
    """The same with the key in the report before them."""
    more = {"merged_robots": f" of {figures['robots']}"} if "robots" in figures else {}
    if count := figures.get("prior_closures"):
        more["found_prior"] = f", by {count} more loop closures"
    if len(figures.get("found_prior", ())) >= figures.get("merged_robots", math.inf):
        more["coverage_correct"] = ", with what the saved map held"
    return [
        (key, name, value_of(figures[key], form) + more.get(key, "")) for name, key, form in FIGURES if key in figures
    ]


def value_of(value: Any, form: str) -> str:
    """A figure with its unit."""
    if value is None:
        return "-"
    if isinstance(value, Mapping):
        precision = value_of(value.get("precision"), ".1% ")
        return f"{value['accepted']} accepted of {value['proposed']} proposed, precision {precision}"
    if isinstance(value, Sequence):
        return f"found by robot{'s' * (len(value) > 1)} {', '.join(map(str, value))}" if value else "not found"
    form, _, unit = form.partition(" ")
    return f"{value:{form}} {unit}".rstrip()


def remarks_of(figures: Mapping[str, Any]) -> list[str]:
    """What a reader must know: why robots share no map, and what odometry knows then."""
    if figures["merged_robots"] >= figures["robots"]:
        return []
    lacked = _folded(map(str, figures.get("lacked") or []))
    why = ["why the robots do not all share one map:\n  " + "\n  ".join(lacked)] if lacked else []
    return [*why, f"The robots do not share one map: {ODOMETRY_REMARK}"]


def _folded(lines: Iterable[str]) -> list[str]:
    """One line instead of those that say the same of several robots."""
    robots: dict[str, list[str]] = {}
    for line in lines:
        said = re.fullmatch(r"(.+ from) robot (\d+)", line)
        robots.setdefault(said[1] if said else line, []).extend([said[2]] if said else [])
    return [f"{line} robot{'s' * (len(own) > 1)} {', '.join(own)}" if own else line for line, own in robots.items()]


def heading_of(figures: Mapping[str, Any]) -> str:
    """Map, seed, robots and steps."""
    who = f"{figures['agent']} on " if "agent" in figures else ""
    team = "1 robot" if figures["robots"] == 1 else f"{figures['robots']} robots"
    steps = "1 step" if figures["steps"] == 1 else f"{figures['steps']} steps"
    return f"{who}{figures['map']}, seed {figures['seed']}, {team}, {steps}"


def text_of(figures: Mapping[str, Any]) -> str:
    """The table for the terminal."""
    rows = rows_of(figures)
    width = max(len(name) for name, _ in rows)
    lines = [f"{name:<{width}}  {value}" for name, value in rows]
    remarks = (
        "\n".join(textwrap.fill(line, WIDTH, subsequent_indent="  ") for line in remark.split("\n"))
        for remark in remarks_of(figures)
    )
    return "\n".join([heading_of(figures), "", *lines, *(f"\n{remark}" for remark in remarks)])


def html_of(figures: Mapping[str, Any]) -> str:
    """The table for a notebook."""
    rows = "".join(
        f"<tr><th style='text-align:left'>{escape(name)}</th><td style='text-align:right'>{escape(value)}</td></tr>"
        for name, value in rows_of(figures)
    )
    remarks = "".join(f"<p style='white-space:pre-line'>{escape(remark)}</p>" for remark in remarks_of(figures))
    return f"<table><caption>{escape(heading_of(figures))}</caption><tbody>{rows}</tbody></table>{remarks}"


def latex_of(figures: Mapping[str, Any]) -> str:
    """The table in LaTeX (package booktabs)."""
    return latex_table(rows_of(figures), has_head=False)
