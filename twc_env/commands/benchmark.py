"""`twc-env benchmark`: one team on many seeds and maps."""

from __future__ import annotations

import argparse
from typing import Any

from twc_env.commands.team_options import add_agent, add_team, folder_names, paragraphs, team_config
from twc_env.errors import DataError
from twc_env.exploration.assessment.result_table import ODOMETRY_REMARK
from twc_env.records.json_values import TERMINAL, check_folder, write_json
from twc_env.running.command_line import INTERRUPTED
from twc_env.running.command_start import Interruption
from twc_env.running.options import add_folder, add_pictures, assignments, count, parse_seeds, picture_options
from twc_env.running.terminal import tell, terminal_width
from twc_env.suite.options import SUITE_EXAMPLES, SUITE_HELP, add_suite_options, check_options, run_suite

_BENCHMARK_HELP = """\
Run many seeds on several maps and print one table per map. Runs in the output folder with the same settings, code and
floor plan are reused, so an interrupted benchmark continues where it stopped. A seed passes if all robots end in one
map, no merge was wrong, team ATE is at most 0.30 m and at least 90 % of the floor is mapped correctly. The folder gets
summary.json, summary.csv (a row per run), summary.tex (a row per map) and coverage.png (coverage over time).

examples:
  twc-env benchmark --maps twin-01 twin-02 --seeds 0-9 --out runs/benchmark
  twc-env benchmark --maps twin-01 --seeds 0-99 --jobs 4 --no-pictures --set odometry.platform=legged
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Fill the command's parser."""
    description, epilog = paragraphs(_BENCHMARK_HELP)
    parser.description, parser.epilog = f"{description}\n\n{SUITE_HELP}", f"{epilog}{SUITE_EXAMPLES}"
    parser.add_argument(
        "--maps", nargs="+", default=["twin-01", "twin-02"], metavar="MAP", help="names or files (default: both twins)"
    )
    parser.add_argument("--seeds", default="0-9", help="numbers and ranges: 0-9 or 1,4,7-9")
    add_folder(parser, "--out", "runs/benchmark", "folder of all runs")
    parser.add_argument("--jobs", type=count, default=1, help="parallel processes")
    parser.set_defaults(run=_benchmark, when_interrupted="interrupted; the same command continues from there")
    add_agent(parser)
    add_pictures(parser)
    add_team(parser)
    add_suite_options(parser)


def _benchmark(options: argparse.Namespace) -> int:
    check_options(options)
    return run_suite(options) if options.suite else _benchmark_maps(options)


def _benchmark_maps(options: argparse.Namespace) -> int:
    from twc_env import load_map
    from twc_env.agents import benchmark, make_policy, picture

    if not options.no_pictures:
        picture.require_libraries(gif=False)
    check_folder(options.out)
    if "map" in assignments(options.set):
        raise DataError("--set map: the maps are chosen with --maps; use that")
    seeds = parse_seeds(options.seeds)
    jobs, names, folders = [], {}, folder_names(options.maps)
    for name in folders:
        config = team_config(options, name, options.steps)
        load_map(name)  # an unknown map fails before the first episode
        for seed in seeds:
            folder = options.out / folders[name] / f"seed-{seed}"
            jobs.append(
                benchmark.Job(config, options.agent, seed, folder, not options.no_pictures, options.format, options.dpi)
            )
            names[folder] = name
    make_policy(options.agent)  # an unknown name fails before the first episode
    outdated = sum(map(benchmark.is_outdated, jobs))
    if outdated:
        tell(f"{outdated} finished runs used other code or another floor plan: running them again")
    reports: dict[str, list[dict[str, Any]]] = {name: [] for name in options.maps}
    with Interruption() as interruption:
        for done, (job, report, was_there) in enumerate(benchmark.run_jobs(jobs, options.jobs), 1):
            reports[names[job.folder]].append(report)
            outcome = "passes" if benchmark.passes(report) else "fails"
            origin = " (reused)" if was_there else ""
            tell(f"[{done}/{len(jobs)}] {names[job.folder]} seed {job.seed}: {outcome}{origin}")
    for rows in reports.values():
        rows.sort(key=lambda report: report["seed"])  # not as they came, which differs with the processes
    places = {name: options.out / folder for name, folder in folders.items()}
    paths = benchmark.write_tables(reports, places, options.agent, options.out, picture_options(options))
    summaries = {name: benchmark.summary_of(rows) | {"reports": rows} for name, rows in reports.items() if rows}
    write_json(options.json, summaries)
    if options.json != TERMINAL:
        for name, rows in reports.items():
            if rows:
                print(f"\n{name}, {options.agent}\n{benchmark.table_of(rows, terminal_width())}")
        if any(row["merged_robots"] < row["robots"] for rows in reports.values() for row in rows):
            print(f"\nWhere robots do not share one map: {ODOMETRY_REMARK}")
    for path in paths:
        tell(f"written: {path}")
    if interruption.came:
        finished = sum(map(len, reports.values()))
        tell(f"interrupted after {finished} of {len(jobs)} runs; the same command continues from there")
    return INTERRUPTED if interruption.came else 0
