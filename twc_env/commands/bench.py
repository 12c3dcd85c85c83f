"""`twc-env bench`."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING, Any

from twc_env.commands.team_options import refuse_said_twice
from twc_env.records.json_values import write_json
from twc_env.records.text_tables import aligned_text
from twc_env.running.learning_libraries import learning_libraries
from twc_env.running.options import add_json, add_ray, add_set, assignments, count, natural, refuse_ignored
from twc_env.running.terminal import aligned, tell, terminal_width
from twc_env.tasks import SUITES

if TYPE_CHECKING:
    from twc_env.config import EnvConfig

DEFAULTS: dict[str, object] = {"map": "twin-01", "max_cycles": 1500}
EPISODES = 3
_OF_EPISODES = ("map", "robots", "beams", "steps")
IGNORED: dict[str, tuple[tuple[str, ...], str]] = {
    "training": (_OF_EPISODES, "plays its task, which --set changes"),
    "teams": (_OF_EPISODES, "plays its task, which --set changes"),
    "memory": ((*_OF_EPISODES, "episodes", "set"), "measures the tasks of the suite v1 as they are"),
    "peers": ((*_OF_EPISODES, "episodes", "set"), "has fixed settings"),
    "scaling": ((*_OF_EPISODES, "episodes", "set"), "has fixed settings"),
    "vector": (("episodes",), "plays one episode of --steps in each environment"),
    "long": (("episodes",), "plays one episode of --steps"),
}
"""What is measured instead of the speed of episodes -> the options that it does not use, and why."""


def add_arguments(speed: argparse.ArgumentParser) -> None:
    """Fill the command's parser."""
    speed.description = (
        "Measure steps per second over whole episodes of robots driven by a reactive policy (median over "
        "episodes). Compare only values from the same machine and run."
    )
    speed.epilog = (
        "examples:\n  twc-env bench --json runs/bench.json\n"
        "  twc-env bench --map gen:office:800:7 --robots 5 --set link.range_max_m=10\n"
        "  twc-env bench --parts\n"
        "  twc-env bench --training ExploreQuick-v1\n"
        "  twc-env bench --training ExploreQuick-v1 --workers 2\n"
        "  twc-env bench --memory\n"
        "  twc-env bench --teams ExploreOffice-v1 --episodes 1 --json runs/teams.json\n"
        "  twc-env bench --vector --map twin-02 --steps 1000\n"
        "  twc-env bench --long --map gen:office:800:7 --robots 4 --steps 20000 --set link.topology=peer"
    )
    speed.add_argument("--map", help="bundled name, generated name or file (default: twin-01)")
    speed.add_argument("--robots", type=count, help="number of robots (default: 3, or those of --set team=...)")
    speed.add_argument("--beams", type=count, help="beams per scan (default: 180, or those of --set lidar.preset=...)")
    speed.add_argument("--steps", type=count, help="steps per episode (default: 1500)")
    speed.add_argument(
        "--episodes", type=count, help="episodes, with seeds 0, 1, ...; with --training: updates (default: 3)"
    )
    add_set(speed)
    instead = speed.add_mutually_exclusive_group()
    instead.add_argument("--parts", action="store_true", help="print the time of each part of a step instead")
    instead.add_argument(
        "--peers",
        action="store_true",
        help="compare with IR-SIM and MPE2 on one core (pip install 'twc_env[peers]'); also start-up time, memory, "
        "two workers and --scaling; settings are fixed",
    )
    instead.add_argument(
        "--scaling",
        action="store_true",
        help="cost of the simulated world by number of walls, beams, robots and area; resets of large buildings; "
        "settings are fixed",
    )
    instead.add_argument(
        "--vector",
        action="store_true",
        help="VectorTeams with 8 and 16 environments: two workers against none, in lockstep and asynchronously, and "
        "gymnasium's SyncVectorEnv and AsyncVectorEnv with the same teams",
    )
    instead.add_argument(
        "--training",
        metavar="TASK",
        help="decisions of mappo per second in a task such as ExploreQuick-v1, and the shares of environments, "
        "inference and update; with one process by CPU time; other settings are those of training (extra train)",
    )
    instead.add_argument("--memory", action="store_true", help="memory of an environment of each task of the suite v1")
    instead.add_argument(
        "--teams",
        metavar="TASK",
        help="CPU time of an episode of each scripted team in a task such as ExploreOffice-v1: of planning and of the "
        "environment",
    )
    instead.add_argument("--long", action="store_true", help="step times along one long episode, in tenths")
    speed.add_argument("--workers", type=natural, help="with --training: processes (default: 1, with --ray all cores)")
    add_ray(speed, "; with --training")
    add_json(speed)
    speed.set_defaults(run=_bench)


def _bench(options: argparse.Namespace) -> None:
    from twc_env.bench.rates import bench

    _refuse_other(options)
    options.episodes = options.episodes or EPISODES
    config = _config_of(options)
    if options.parts:
        _bench_parts(config, options)
        return
    if options.long:
        _bench_long(config, options)
        return
    figures: dict[str, Any]
    if options.memory:
        from twc_env.bench.memory import bench_memory

        figures = {"memory": bench_memory(SUITES["v1"], report=tell)}
    elif options.teams:
        figures = {"teams": _bench_teams(options)}
    elif options.training:
        figures = dict(_bench_training(options))
    elif options.vector:
        from twc_env.bench.vector_teams import bench_vector

        figures = dict(bench_vector(config, report=tell))
    elif options.peers or options.scaling:
        figures = _bench_peers(options)
    else:
        figures = bench(config, options.episodes, report=tell)
    for key, value in figures.items():
        if key in ("scaling", "vector", "memory", "teams"):
            print(aligned(value, terminal_width()))
        else:
            print(f"{key:<28} {value:,.3f}" if isinstance(value, float) else f"{key:<28} {value}")
    write_json(options.json, figures)


def _refuse_other(options: argparse.Namespace) -> None:
    """Raise DataError for an option that what is measured would ignore."""
    if not options.training:
        refuse_ignored(options, ("workers", "ray"), "it needs --training TASK")
    for measured, (others, why) in IGNORED.items():
        if getattr(options, measured):
            refuse_ignored(options, others, f"--{measured} {why}")


def _config_of(options: argparse.Namespace) -> EnvConfig:
    from twc_env.config import EnvConfig, override

    named = {"map": options.map, "robots": options.robots, "lidar.beam_count": options.beams}
    chosen = {key: value for key, value in (named | {"max_cycles": options.steps}).items() if value is not None}
    asked = assignments(options.set)
    refuse_said_twice(chosen, asked)
    return override(EnvConfig(), DEFAULTS | chosen | asked)


def _bench_peers(options: argparse.Namespace) -> dict:
    from twc_env.bench.peers import bench_peers
    from twc_env.bench.scaling import bench_large_reset, bench_scaling

    figures = bench_peers(report=tell) if options.peers else {}
    return figures | bench_large_reset() | {"scaling": bench_scaling(report=tell)}


def _bench_teams(options: argparse.Namespace) -> list[dict[str, Any]]:
    from twc_env.agents.roster import TEAMS
    from twc_env.config import override
    from twc_env.suite.planning_costs import bench_teams
    from twc_env.tasks import task_config

    task = options.teams if options.teams.startswith("twc/") else f"twc/{options.teams}"
    config = override(task_config(task), assignments(options.set))
    return bench_teams(config, tuple(TEAMS), options.episodes, report=tell)


def _bench_training(options: argparse.Namespace) -> dict[str, float]:
    with learning_libraries():
        from twc_env.training.mappo import Settings
        from twc_env.training.run_folder import Task, task_id
        from twc_env.training.throughput import throughput

    task = Task(task_id(options.training), overrides=assignments(options.set))
    workers = int(options.ray is None) if options.workers is None else options.workers
    found: dict[str, float] = throughput(task, options.episodes, Settings(workers=workers), options.ray)
    return found


def _bench_parts(config: EnvConfig, options: argparse.Namespace) -> None:
    from twc_env.bench.parts import bench_parts, table_of

    rows = bench_parts(config, options.episodes, report=tell)
    print(aligned_text(table_of(rows), terminal_width()))
    write_json(options.json, {row.part: round(row.robot_step_us, 3) for row in rows})


def _bench_long(config: EnvConfig, options: argparse.Namespace) -> None:
    from dataclasses import asdict

    from twc_env.bench.long_episode import bench_long

    stretches = [asdict(stretch) for stretch in bench_long(config, report=tell)]
    print(aligned(stretches, terminal_width()))
    write_json(options.json, {"stretches": stretches})
