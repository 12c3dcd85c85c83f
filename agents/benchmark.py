"""Benchmark: several maps, many seeds, one table per map."""

from __future__ import annotations

import json
import math
import statistics
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import twc_env
from twc_env import EnvConfig
from twc_env.config import digest
from twc_env.running.worker_processes import in_processes

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


def passes(report: dict[str, Any]) -> bool:
    """All robots in one frame, no wrong merge, team ATE of at most 0.30 m, at least 90 % mapped correctly."""
    return (
        report["merged_robots"] == report["robots"]
        and report["wrong_merges"] == 0
        and report["team_ate_m"] <= ATE_PASS_M
        and report["coverage_correct"] >= COVERAGE_PASS
    )


def run_jobs(jobs: Iterable[Job], processes: int = 1) -> Iterator[tuple[Job, dict[str, Any], bool]]:
    """Yield (job, report, whether it was reused) as each is done; jobs whose pictures are missing are run again."""
    waiting = []
    for job in jobs:
        report = report_of(job)
        if report is None or (job.pictures and not (job.folder / "map.png").is_file()):
            waiting.append(job)
        else:
            yield job, report, True
    for k, report in in_processes(run_job, waiting, min(processes, len(waiting))):
        yield waiting[k], report, False


def run_job(job: Job) -> dict[str, Any]:
    """Run one episode and write its folder. Raises KeyboardInterrupt if it was interrupted."""
    run = explore(job.config, job.agent, job.seed)
    if run.was_interrupted:
        raise KeyboardInterrupt
    write_run(run, job.folder, job.pictures)
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
    except (OSError, ValueError):
        return None
    wanted = {"config_digest": digest(job.config), "agent": job.agent, "seed": job.seed}
    is_same = isinstance(report, dict) and all(report.get(key) == value for key, value in wanted.items())
    return report if is_same else None


def summary_of(reports: list[dict[str, Any]]) -> dict[str, Any]:
    """Mean, standard deviation, minimum and maximum of each column, and the number of passing seeds."""
    columns = {}
    for key, _, _ in COLUMNS:
        values = [float(r[key]) for r in reports if r.get(key) is not None]
        spread = statistics.stdev(values) if len(values) > 1 else 0.0
        columns[key] = {
            "mean": statistics.fmean(values) if values else math.nan,
            "sd": spread,
            "min": min(values, default=math.nan),
            "max": max(values, default=math.nan),
        }
    return {"seeds": len(reports), "passed": sum(map(passes, reports)), "figures": columns}


def table_of(reports: list[dict[str, Any]]) -> str:
    """The seeds of one map as an aligned table, with statistics below."""
    reports = sorted(reports, key=lambda r: r["seed"])
    rows = [["seed", *(title for _, title, _ in COLUMNS), "passes"]]
    for report in reports:
        cells = ["-" if report.get(key) is None else f"{report[key]:{form}}" for key, _, form in COLUMNS]
        rows.append([str(report["seed"]), *cells, "yes" if passes(report) else "no"])
    summary = summary_of(reports)
    for name in ("mean", "sd", "min", "max"):
        cells = [f"{summary['figures'][key][name]:{form.replace('d', '.2f')}}" for key, _, form in COLUMNS]
        rows.append([name, *cells, ""])
    widths = [max(len(row[k]) for row in rows) for k in range(len(rows[0]))]
    lines = ["  ".join(f"{cell:>{width}}" for cell, width in zip(row, widths, strict=True)).rstrip() for row in rows]
    rule = "-" * max(map(len, lines))
    lines = [lines[0], rule, *lines[1 : len(reports) + 1], rule, *lines[len(reports) + 1 :]]
    return "\n".join([*lines, f"{summary['passed']} of {summary['seeds']} seeds pass"])
