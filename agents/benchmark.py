"""Benchmark: several maps, many seeds, one table per map."""

from __future__ import annotations

import json
import math
import statistics
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

import twc_env
from twc_env import EnvConfig
from twc_env.config import digest
from twc_env.errors import UNFIT
from twc_env.pictures.curves import MAPPED, draw_coverage, sampled
from twc_env.pictures.replay_page import read_trace
from twc_env.processes.worker_processes import in_processes
from twc_env.records.json_values import write_json
from twc_env.records.seal import is_unbroken
from twc_env.records.text_tables import aligned_text, csv_text, flat, latex_table
from twc_env.records.whole_file import write_text
from twc_env.running.output_folder import remove_stale

from .explore import explore, origin_of, write_run

COLUMNS = (
    ("merged_robots", "merged", "d"),
    ("wrong_merges", "wrong", "d"),
    ("team_ate_m", "ATE m", ".3f"),
    ("coverage_correct", "mapped", ".3f"),
    ("wall_iou", "wall IoU", ".3f"),
    ("odometry_ate_m", "odo ATE m", ".3f"),
    ("odometry_wall_iou", "odo wall IoU", ".3f"),
    ("stuck_share", "stuck", ".3f"),
    ("env_steps_per_s", "steps/s", ".0f"),
)
_NEEDED = ("robots", "merged_robots", "wrong_merges", "team_ate_m", "coverage_correct")
"""Figures that every run has."""
ATE_PASS_M = 0.30
COVERAGE_PASS = 0.90


@dataclass(frozen=True, slots=True)
class Job:
    """One episode of a benchmark."""

    config: EnvConfig
    agent: str
    seed: int
    folder: Path
    pictures: bool = True
    format: str = "png"
    """Of the map picture."""
    dpi: float | None = None


def passes(report: dict[str, Any]) -> bool:
    """All robots in one frame, no wrong merge, team ATE of at most 0.30 m, at least 90 % mapped correctly."""
    return (
        report["merged_robots"] == report["robots"]
        and report["wrong_merges"] == 0
        and report["team_ate_m"] <= ATE_PASS_M
        and report["coverage_correct"] >= COVERAGE_PASS
    )


def run_jobs(jobs: Iterable[Job], processes: int = 1) -> Iterator[tuple[Job, dict[str, Any], bool]]:
    """Yield (job, report, whether it was reused) as each is done; jobs whose pictures, or what they are drawn from, are
    missing or damaged are run again."""
    waiting = []
    for job in jobs:
        report = report_of(job)
        if report is None or (job.pictures and not _is_drawn(job)):
            waiting.append(job)
        else:
            yield job, report, True
    for k, report in in_processes(run_job, waiting, min(processes, len(waiting))):
        yield waiting[k], report, False


def _is_drawn(job: Job) -> bool:
    trace = job.folder / "trace.npz"
    return (job.folder / f"map.{job.format}").is_file() and trace.is_file() and is_unbroken(trace)


def run_job(job: Job) -> dict[str, Any]:
    """Run one episode and write its folder. Raises KeyboardInterrupt if it was interrupted."""
    run = explore(job.config, job.agent, job.seed)
    if run.was_interrupted:
        raise KeyboardInterrupt
    write_run(run, job.folder, job.pictures, job.format, job.dpi)
    return run.report


def report_of(job: Job) -> dict[str, Any] | None:
    """The report of an earlier run of the same job with the same code and map, or None."""
    report = _report_with(job)
    origin = {"version": twc_env.__version__, **origin_of(job.config, job.agent)}
    return report if report and all(report.get(key) == value for key, value in origin.items()) else None


def is_outdated(job: Job) -> bool:
    """Whether there is an earlier run with the same settings, but other code or another floor plan."""
    return _report_with(job) is not None and report_of(job) is None


def _report_with(job: Job) -> dict[str, Any] | None:
    """The report of an earlier run with the same settings and any code, or None."""
    try:
        report = json.loads((job.folder / "report.json").read_text(encoding="utf-8"))
    except (OSError, *UNFIT):
        return None
    if not _has_figures(report):
        return None
    wanted = {"config_digest": digest(job.config), "agent": job.agent, "seed": job.seed}
    return report if all(report.get(key) == value for key, value in wanted.items()) else None


def _has_figures(report: Any) -> bool:
    """Whether what a file holds has all figures of the tables as numbers."""
    kinds = {key: int if form == "d" else (int, float) for key, _, form in COLUMNS} | {"robots": int}
    return isinstance(report, dict) and all(
        isinstance(report.get(key), kind) or (report.get(key) is None and key not in _NEEDED)
        for key, kind in kinds.items()
    )


def summary_of(reports: list[dict[str, Any]]) -> dict[str, Any]:
    """Mean, standard deviation, minimum and maximum of each column, and the number of passing seeds.

    What does not exist is NaN, such as the standard deviation of one seed.
    """
    columns = {}
    for key, _, _ in COLUMNS:
        values = [float(r[key]) for r in reports if r.get(key) is not None]
        spread = statistics.stdev(values) if len(values) > 1 else math.nan
        columns[key] = {
            "mean": statistics.fmean(values) if values else math.nan,
            "sd": spread,
            "min": min(values, default=math.nan),
            "max": max(values, default=math.nan),
        }
    return {"seeds": len(reports), "passed": sum(map(passes, reports)), "figures": columns}


def rows_of(reports: Sequence[dict[str, Any]]) -> list[list[str]]:
    """Titles, one row of cells per seed of one map, and rows of mean, sd, min and max."""
    reports = sorted(reports, key=lambda r: r["seed"])
    rows = [["seed", *(title for _, title, _ in COLUMNS), "passes"]]
    for report in reports:
        cells = ["-" if report.get(key) is None else f"{report[key]:{form}}" for key, _, form in COLUMNS]
        rows.append([str(report["seed"]), *cells, "yes" if passes(report) else "no"])
    summary = summary_of(list(reports))
    for name in ("mean", "sd", "min", "max"):
        cells = [_number(summary["figures"][key][name], form) for key, _, form in COLUMNS]
        rows.append([name, *cells, ""])
    return rows


def _number(value: float, form: str) -> str:
    return "-" if math.isnan(value) else f"{value:{form.replace('d', '.2f')}}"


def table_of(reports: list[dict[str, Any]], width: int | None = None) -> str:
    """The seeds of one map as an aligned table, with statistics below, folded to the width of a terminal."""
    rows, summary = rows_of(reports), summary_of(reports)
    lines = aligned_text(rows, width, left=0).split("\n\n")
    ruled = []
    for block in lines:
        head, *body = block.split("\n")
        rule = "-" * max(map(len, [head, *body]))
        ruled.append("\n".join([head, rule, *body[: len(reports)], rule, *body[len(reports) :]]))
    return "\n\n".join(ruled) + f"\n{summary['passed']} of {summary['seeds']} seeds pass"


def write_tables(
    reports: Mapping[str, list[dict[str, Any]]], folders: Mapping[str, Path], agent: str, folder: Path,
    pictures: tuple[str, float | None] | None,
) -> list[Path]:  # fmt: skip
    """Write summary.json, summary.csv (a row per run), summary.tex (a row per map), and coverage over time as
    a picture; returns their paths.

    reports: by map. folders: with the runs of each map. pictures: format and dpi; None for no picture.
    """
    summaries = {name: summary_of(rows) | {"reports": rows} for name, rows in reports.items() if rows}
    write_json(folder / "summary.json", summaries)
    paths = [folder / "summary.json"]
    runs = [flat({**report, "passes": passes(report)}) for rows in reports.values() for report in rows]
    paths.append(write_text(folder / "summary.csv", csv_text(runs)))
    lines = [["map", "seeds", "pass", *(title for _, title, _ in COLUMNS)]]
    for name, summary in summaries.items():
        cells = []
        for key, _, form in COLUMNS:
            of = summary["figures"][key]
            spread = "" if math.isnan(of["sd"]) else f" ({_number(of['sd'], form)})"
            cells.append(f"{_number(of['mean'], form)}{spread}")
        lines.append([name, str(summary["seeds"]), str(summary["passed"]), *cells])
    paths.append(write_text(folder / "summary.tex", latex_table(lines)))
    curves = {name: _curves_of(rows, folders[name]) for name, rows in reports.items() if rows} if pictures else {}
    if pictures is not None and curves:
        times = [time_s for _, time_s in curves.values()]
        title = f"{agent}, largest group of robots"
        drawn = {name: values for name, (values, _) in curves.items()}
        path = folder / f"coverage.{pictures[0]}"
        paths.append(draw_coverage(drawn, max(times), path, title, pictures[1], MAPPED))
    remove_stale(folder, ("coverage",), paths)
    return paths


def _curves_of(reports: Sequence[dict[str, Any]], folder: Path) -> tuple[list[list[float | None]], float]:
    """Coverage over time of the runs of one map, from their traces, and the longest time [s] of an episode."""
    curves, time_max_s = [], 0.0
    for report in reports:
        trace = read_trace(folder / f"seed-{report['seed']}" / "trace.npz")
        moments, config = json.loads(str(trace["moments"])), json.loads(str(trace["config"]))
        steps = [moment["step"] for moment in moments]
        covered = [moment["figures"]["coverage_correct"] for moment in moments]
        curves.append(sampled(np.array(steps), np.array(covered), config["max_cycles"]))
        time_max_s = config["max_cycles"] * config["dynamics"]["time_step_s"]
    return curves, time_max_s
