"""`twc-env benchmark`: one team on many seeds and maps."""

from __future__ import annotations

import argparse
import sys
from typing import Any

from twc_env import load_map
from twc_env.commands.team_options import add_agent, add_team, folder_names, paragraphs, team_config
from twc_env.records.json_values import TERMINAL, check_folder, write_json
from twc_env.running.command_line import add_folder, count, parse_seeds

_BENCHMARK_HELP = """\
Run many seeds on several maps and print one table per map. Runs in the output folder with the same settings, code and
floor plan are reused, so an interrupted benchmark continues where it stopped. A seed passes if all robots end in one
map, no merge was wrong, team ATE is at most 0.30 m and at least 90 % of the floor is mapped correctly.

examples:
  twc-env benchmark --maps twin-01 twin-02 --seeds 0-9 --out runs/benchmark
  twc-env benchmark --maps twin-01 --seeds 0-99 --jobs 4 --no-pictures --set odometry.platform=legged
"""


def add_benchmark_parser(commands: Any) -> None:
    """Add the command."""
    parser = commands.add_parser(
        "benchmark",
        help="run one agent on many seeds and maps, and count the episodes that pass",
        **paragraphs(_BENCHMARK_HELP),
    )
    parser.add_argument(
        "--maps", nargs="+", default=["twin-01", "twin-02"], metavar="MAP", help="names or files (default: both twins)"
    )
    parser.add_argument("--seeds", default="0-9", help="numbers and ranges: 0-9 or 1,4,7-9")
    add_folder(parser, "--out", "runs/benchmark", "folder of all runs")
    parser.add_argument("--jobs", type=count, default=1, help="parallel processes")
    parser.set_defaults(run=_benchmark)
    add_agent(parser)
    add_team(parser)


def _benchmark(options: argparse.Namespace) -> int:
    from twc_env.agents import benchmark, make_policy, picture

    if not options.no_pictures:
        picture.require_libraries(gif=False)
    check_folder(options.out)
    seeds = parse_seeds(options.seeds)
    jobs, names, folders = [], {}, folder_names(options.maps)
    for name in folders:
        config = team_config(options, name, options.steps)
        load_map(name)  # an unknown map fails before the first episode
        for seed in seeds:
            folder = options.out / folders[name] / f"seed-{seed}"
            jobs.append(benchmark.Job(config, options.agent, seed, folder, not options.no_pictures))
            names[folder] = name
    make_policy(options.agent)  # an unknown name fails before the first episode
    outdated = sum(map(benchmark.is_outdated, jobs))
    if outdated:
        print(f"{outdated} finished runs used other code or another floor plan: running them again", file=sys.stderr)
    reports: dict[str, list[dict[str, Any]]] = {name: [] for name in options.maps}
    was_interrupted = False
    try:
        for done, (job, report, was_there) in enumerate(benchmark.run_jobs(jobs, options.jobs), 1):
            reports[names[job.folder]].append(report)
            outcome = "passes" if benchmark.passes(report) else "fails"
            origin = " (reused)" if was_there else ""
            print(f"[{done}/{len(jobs)}] {names[job.folder]} seed {job.seed}: {outcome}{origin}", file=sys.stderr)
    except KeyboardInterrupt:
        was_interrupted = True
        finished = sum(map(len, reports.values()))
        print(
            f"interrupted after {finished} of {len(jobs)} runs; the same command continues from there", file=sys.stderr
        )
    for rows in reports.values():
        rows.sort(key=lambda report: report["seed"])  # not as they came, which differs with the processes
    summaries = {name: benchmark.summary_of(rows) | {"reports": rows} for name, rows in reports.items() if rows}
    write_json(options.out / "summary.json", summaries)
    write_json(options.json, summaries)
    if options.json != TERMINAL:
        for name, rows in reports.items():
            if rows:
                print(f"\n{name}, {options.agent}\n{benchmark.table_of(rows)}")
    return 130 if was_interrupted else 0
