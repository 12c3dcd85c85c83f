"""Command line of the scripted agents: `python -m agents explore | benchmark | compare | radio-survey`."""

from __future__ import annotations

import argparse
import re
import sys
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from agents import benchmark, compare, picture, radio_survey
from agents.explore import explore, table_of, write_run
from agents.policy import make_policy, policy_names
from twc_env import EnvConfig, load_map, map_names
from twc_env.config import digest, override
from twc_env.records.json_values import TERMINAL, check_folder, write_json
from twc_env.running.command_line import (
    Parser,
    add_config,
    add_folder,
    add_json,
    add_set,
    add_version,
    assignments,
    config_of,
    count,
    end_line,
    natural,
    parse_seeds,
    run_command,
    show_count,
)

_EXPLORE_HELP = """\
Run one episode with a scripted team and write a run folder:
report.json (metrics, defined in docs/figures.md), config.json, map.png, episode.gif, map.pgm + map.yaml,
pose_graph.g2o and trajectories/*.tum (readable by evo).

examples:
  python -m agents explore
  python -m agents explore --map twin-02 --robots 3 --seed 1 --out runs/twin-02
  python -m agents explore --map office.yaml --steps 6000 --set odometry.drift=2 --set lidar.beam_count=360
  python -m agents explore --map gen:office:800:7 --agent random --no-pictures --json -
  python -m agents explore --agent mine.py:Mine        your own team: a class derived from agents.Policy
  python -m agents explore --config runs/twin-02 --seed 1        the same episode again, to the byte
  python -m agents explore --config twc/ExploreHard-v0 --steps 1500
"""
_BENCHMARK_HELP = """\
Run many seeds on several maps and print one table per map. Runs in the output folder with the same settings, code and
floor plan are reused, so an interrupted benchmark continues where it stopped. A seed passes if all robots end in one
map, no merge was wrong, team ATE is at most 0.30 m and at least 90 % of the floor is mapped correctly.

examples:
  python -m agents benchmark --maps twin-01 twin-02 --seeds 0-9 --out runs/benchmark
  python -m agents benchmark --maps twin-01 --seeds 0-99 --jobs 4 --no-pictures --set odometry.platform=legged
"""
_COMPARE_HELP = """\
Compare teams in the same buildings from the same start poses: how much sooner than the first team each of the others
has mapped 90 % of the floor correctly, with a 95 % confidence interval. Episodes finished by the same code are reused.

examples:
  python -m agents compare --buildings 20 --jobs 2
  python -m agents compare --agents nearest-frontier mine.py:Mine --buildings 10 --jobs 2
  python -m agents compare --agents nearest-frontier radio-frontier --robots 1 --set slam.k_visibility.enabled=true
"""
_SURVEY_HELP = """\
Map flats from WiFi alone with one robot, once by following the walls and once by driving to where its map is least
certain (`radio-walk`), and print map quality over path length. Walks finished by the same code are reused.

examples:
  python -m agents radio-survey
  python -m agents radio-survey --maps sfw-e4 sfw-e5 --seeds 0
"""
_AGENTS = """\
An AGENT is
  nearest-frontier    drives to the nearest frontier, keeping teammates apart
  cost-utility        trades off distance to a frontier against what teammates will see of it
  assignment          one frontier per robot, minimising the total path length
  voronoi             each robot takes the frontiers that it is closest to
  radio-frontier      nearest-frontier, preferring floor predicted from WiFi (slam.k_visibility.enabled=true)
  radio-walk          drives to where walls estimated from WiFi are least certain
  random              wanders
  wall-follower       follows walls
  FILE.py:CLASS       your own class, derived from agents.Policy (docs/library.md)
"""
_TEAMS = ("nearest-frontier", "cost-utility", "assignment", "voronoi", "random")


def main(arguments: list[str] | None = None) -> int:
    """Run a command; returns the exit code: 0 done, 2 wrong input, 130 interrupted."""
    return run_command(_parser(), arguments)


def _explore(options: argparse.Namespace) -> int:
    config = _config(options, options.map, options.steps)
    has_gif = not (options.no_gif or options.no_pictures)
    if not options.no_pictures:
        picture.require_libraries(has_gif)
    folder = options.out or _run_folder(config, options.agent, options.seed)
    check_folder(folder)
    what = f" steps on {_folder_name(config.map)}, seed {options.seed}"
    film = picture.Film() if has_gif else None
    run = explore(
        config, options.agent, options.seed, film, lambda done: show_count(done, config.max_cycles, what, every=50)
    )
    end_line()
    write_run(run, folder, not options.no_pictures)
    write_json(options.json, run.report)
    if options.json != TERMINAL:
        print(f"{options.agent} on {config.map}, seed {options.seed}, {config.robots} robots\n")
        print(table_of(run.report))
        if run.report["merged_robots"] < run.report["robots"] and run.report["lacked"]:
            print("\nwhy the robots do not all share one map:", *run.report["lacked"], sep="\n  ")
        print(f"\nwritten: {folder}")
    if run.was_interrupted:
        print(f"interrupted after {run.report['steps']} steps; the results cover these", file=sys.stderr)
    return 130 if run.was_interrupted else 0


def _run_folder(config: EnvConfig, agent: str, seed: int) -> Path:
    """The default run folder, different for different settings."""
    name = f"{_folder_name(config.map)}-{agent.rpartition(':')[2]}-seed{seed}"
    is_usual = config == override(EnvConfig(), {"map": config.map})
    return Path("runs") / (name if is_usual else f"{name}-{digest(config)}")


def _folder_name(map_name: str) -> str:
    """A map name as part of a path: the stem of a file, or a generated name without separators."""
    path = Path(map_name)
    return path.stem if path.suffix else map_name.replace("/", "-").replace(":", "-")


def _folder_names(maps: Sequence[str]) -> dict[str, str]:
    """A folder name for each map; files of the same name are distinguished by their folders."""
    shared = Counter(_folder_name(name) for name in dict.fromkeys(maps))
    return {
        name: _folder_name(name) if shared[_folder_name(name)] == 1 else re.sub(r"[^\w.-]+", "-", name).strip("-")
        for name in maps
    }


def _benchmark(options: argparse.Namespace) -> int:
    if not options.no_pictures:
        picture.require_libraries(gif=False)
    check_folder(options.out)
    seeds = parse_seeds(options.seeds)
    jobs, names, folders = [], {}, _folder_names(options.maps)
    for name in folders:
        config = _config(options, name, options.steps)
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
            verdict = "passes" if benchmark.passes(report) else "fails"
            origin = " (reused)" if was_there else ""
            print(f"[{done}/{len(jobs)}] {names[job.folder]} seed {job.seed}: {verdict}{origin}", file=sys.stderr)
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


def _compare(options: argparse.Namespace) -> int:
    config = _config(options, None, options.steps)
    maps = options.maps or [f"test/{number:04d}" for number in range(options.buildings)]
    for name in maps:
        load_map(name)
    found = compare.compare(
        config, maps, options.agents, options.out, options.jobs, lambda text: print(text, file=sys.stderr)
    )
    write_json(options.json, compare.as_json(found))
    if options.json != TERMINAL:
        print(compare.table_of(found))
    return 0


def _radio_survey(options: argparse.Namespace) -> int:
    seeds = parse_seeds(options.seeds)
    for name in options.maps:
        load_map(name)
    found = radio_survey.compare(
        options.maps, seeds, options.steps, options.out, lambda text: print(text, file=sys.stderr)
    )
    for c in found:
        for agent, walked in zip(radio_survey.AGENTS, (c.along_walls, c.active), strict=True):
            print(
                f"{c.name} seed {c.seed} {agent:13s} {walked.path_m[-1]:6.1f} m  free IoU {walked.iou[-1]:.3f}, "
                f"among known cells {walked.iou_published[-1]:.3f} at coverage {walked.coverage[-1]:.3f}"
                f"{'' if walked.is_finished else ', not finished'}"
            )
    for share in (0.25, 0.5, 0.6, 0.75, 1.0):
        both = [c.at_share(share) for c in found]
        along, active = (sum(column) / len(column) for column in zip(*both, strict=True))
        print(
            f"after {share:4.0%} of the path along the walls: free IoU {along:.3f} wall following, {active:.3f} active"
        )
    for part in (0.5, 0.75, 0.9, 1.0):
        middle, low, high = radio_survey.median_share([c.path_share(part) for c in found])
        print(
            f"active path for {part:4.0%} of the final IoU of wall following: {middle:.2f} of the path that wall "
            f"following needs (median, 95 % interval {low:.2f} to {high:.2f}; inf: never reached)"
        )
    middle, low, high = radio_survey.median_share([c.bound(load_map(c.name)) for c in found])
    print(
        f"lower bound for 100% (shortest path found with known building and noise-free readings): {middle:.2f} "
        f"(median, 95 % interval {low:.2f} to {high:.2f})"
    )
    return 0


def _config(options: argparse.Namespace, map_name: str | None, steps: int | None) -> EnvConfig:
    """The settings: defaults, then the file or standard task, then the options, then --set."""
    named = {"map": map_name, "robots": options.robots, "max_cycles": steps}
    chosen = {key: value for key, value in named.items() if value is not None}
    config = override(config_of(options.config), chosen)
    return override(config, assignments(options.set))


def _paragraphs(text: str) -> dict[str, Any]:
    """The first paragraph as description, the rest (examples) as epilog."""
    description, _, examples = text.partition("\n\n")
    return {"description": description, "epilog": examples}


def _parser() -> argparse.ArgumentParser:
    parser = Parser(
        prog="python -m agents",
        description="Scripted teams that explore buildings. Each command has its own --help.",
        epilog="example:\n  python -m agents explore --map twin-01 --out runs/mine\n\n" + _AGENTS,
    )
    add_version(parser)
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")
    one = commands.add_parser("explore", help="run one episode and write a run folder", **_paragraphs(_EXPLORE_HELP))
    one.add_argument(
        "--map", help=f"{', '.join(map_names())}; generated: gen:office:800:7, test/0003; or a file (default: twin-01)"
    )
    one.add_argument("--seed", type=natural, default=0, help="of start poses, noise and generated signs")
    one.add_argument(
        "--out",
        type=Path,
        metavar="FOLDER",
        help="run folder (default: runs/MAP-AGENT-seedSEED, plus a digest of the settings if they are not the "
        "defaults)",
    )
    one.add_argument("--no-gif", action="store_true", help="do not write episode.gif")
    one.set_defaults(run=_explore)
    many = commands.add_parser(
        "benchmark",
        help="run one agent on many seeds and maps, and count the episodes that pass",
        **_paragraphs(_BENCHMARK_HELP),
    )
    many.add_argument(
        "--maps", nargs="+", default=["twin-01", "twin-02"], metavar="MAP", help="names or files (default: both twins)"
    )
    many.add_argument("--seeds", default="0-9", help="numbers and ranges: 0-9 or 1,4,7-9")
    add_folder(many, "--out", "runs/benchmark", "folder of all runs")
    many.add_argument("--jobs", type=count, default=1, help="parallel processes")
    many.set_defaults(run=_benchmark)
    teams = commands.add_parser(
        "compare", help="compare several agents in the same buildings", **_paragraphs(_COMPARE_HELP)
    )
    teams.add_argument(
        "--agents",
        nargs="+",
        default=list(_TEAMS),
        metavar="AGENT",
        help=f"any of {', '.join(policy_names())}, or FILE.py:CLASS; the first is the baseline "
        f"(default: {', '.join(_TEAMS)})",
    )
    teams.add_argument(
        "--buildings", type=count, default=10, help="number of buildings, from the start of the test split"
    )
    teams.add_argument("--maps", nargs="+", metavar="MAP", help="names or files, instead of --buildings")
    add_folder(teams, "--out", "runs/compare", "folder of finished episodes")
    teams.add_argument("--jobs", type=count, default=1, help="parallel processes")
    teams.set_defaults(run=_compare)
    walk = commands.add_parser(
        "radio-survey", help="wall maps from WiFi alone, by path length", **_paragraphs(_SURVEY_HELP)
    )
    walk.add_argument(
        "--maps",
        nargs="+",
        metavar="MAP",
        default=[f"sfw-e{n}" for n in range(1, 7)],
        help="names or files (default: sfw-e1 to sfw-e6)",
    )
    walk.add_argument("--seeds", default="0-2", help="numbers and ranges")
    walk.add_argument("--steps", type=count, default=2500, help="maximum number of steps")
    add_folder(walk, "--out", "runs/radio-survey", "folder of finished walks")
    walk.set_defaults(run=_radio_survey)
    for command in (one, many):
        command.add_argument(
            "--agent", default="nearest-frontier", help=f"one of {', '.join(policy_names())}, or FILE.py:CLASS"
        )
        command.add_argument("--no-pictures", action="store_true", help="write neither map.png nor episode.gif")
    for command in (one, many, teams):
        command.add_argument("--robots", type=count, help="number of robots (default: 3)")
        command.add_argument("--steps", type=count, help="maximum number of steps (default: 2000)")
        add_config(command)
        add_set(command)
        add_json(command)
    return parser


if __name__ == "__main__":
    sys.exit(main())
