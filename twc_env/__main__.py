"""Command line: python -m twc_env maps | ocr | bench | soak | record | replay | reproduce."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from twc_env.errors import ConfigError, TwcError
from twc_env.maps_cli import add_maps_parser
from twc_env.ocr_cli import add_ocr_parser
from twc_env.reproduce.runner import TABLES, add_parser

if TYPE_CHECKING:
    from twc_env.config import EnvConfig
    from twc_env.slam.engine import CooperativeSlam
    from twc_env.slam.team import TeamMapper


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command; bad input ends with one line on stderr and exit status 2."""
    options = _parser().parse_args(arguments)
    try:
        options.run(options)
    except TwcError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m twc_env",
        description="Look at maps, measure speed, record and replay sensor logs, reproduce tables.",
    )
    commands = parser.add_subparsers(required=True, metavar="COMMAND")

    add_maps_parser(commands)
    add_ocr_parser(commands)

    speed = commands.add_parser(
        "bench",
        help="steps per second of the world alone and of the whole step with SLAM",
        description="Robots wander by reflex through whole episodes; medians over the episodes are printed. "
        "Compare figures from one machine and one run only.",
    )
    speed.add_argument("--map", default="twin-01", help="bundled name or file (default: %(default)s)")
    speed.add_argument("--robots", type=int, default=3, help="default: %(default)s")
    speed.add_argument("--beams", type=int, default=180, help="beams per scan (default: %(default)s)")
    speed.add_argument("--steps", type=int, default=1500, help="steps per episode (default: %(default)s)")
    speed.add_argument("--episodes", type=int, default=3, help="seeds 0, 1, ... (default: %(default)s)")
    speed.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", help="any setting, by dotted key")
    speed.add_argument("--parts", action="store_true", help="the table of what costs what, instead of rates")
    speed.add_argument(
        "--peers",
        action="store_true",
        help="in one run on one core: ours beside IR-SIM and MPE2 (pip install 'twc_env[peers]'), start-up, memory, "
        "two workers; fixed settings",
    )
    speed.add_argument(
        "--scaling", action="store_true", help="cost of the world against walls, beams, robots and area; large resets"
    )
    speed.add_argument("--json", type=Path, metavar="FILE", help="write the figures as one object")
    speed.set_defaults(run=_bench)

    long = commands.add_parser(
        "soak",
        help="play for very long in changing buildings and watch memory; misuse it; check what it shows",
        description="Robots wander by reflex through episodes of 500 steps, each in another building of the training "
        "split. Prints what memory did after a warm-up; an exception ends it with the seed of its episode. With "
        "--actions or --observations, that is done instead.",
    )
    long.add_argument("--steps", type=int, default=1_000_000, help="time steps in all (default: %(default)s)")
    long.add_argument(
        "--actions",
        type=int,
        metavar="COUNT",
        help="throw so many broken actions; each must be refused and leave no mark",
    )
    long.add_argument(
        "--observations",
        type=int,
        metavar="STEPS",
        help="random steps of all kinds of action, all blocks on: in their spaces, never constant, no shared memory",
    )
    long.add_argument("--seed", type=int, default=0, help="of the first episode (default: %(default)s)")
    long.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", help="any setting, by dotted key")
    long.add_argument("--json", type=Path, metavar="FILE", help="write the figures as one flat object")
    long.set_defaults(run=_soak)

    record = commands.add_parser(
        "record",
        help="record what robots sense in an episode, the truth in a separate file",
        description="Robots wander by reflex. Writes frames.npz (sensor frames and settings, no truth) and truth.npz "
        "(true poses); docs/frames.md describes both. `python -m agents explore` records its episodes too.",
    )
    record.add_argument("--map", default="twin-01", help="bundled name, generated name or file (default: %(default)s)")
    record.add_argument("--robots", type=int, default=3, help="default: %(default)s")
    record.add_argument("--steps", type=int, default=600, help="default: %(default)s")
    record.add_argument("--seed", type=int, default=0, help="default: %(default)s")
    record.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", help="any setting, by dotted key")
    record.add_argument("--out", type=Path, required=True, metavar="DIR", help="folder to write to")
    record.set_defaults(run=_record)

    replay = commands.add_parser(
        "replay",
        help="run the SLAM engine on recorded sensor frames, or make a page or Rerun recording of a run",
        description="The engine sees the frames of a log (frames.npz of a run folder) and nothing else. "
        "Prints what it found; the same log gives the same numbers every time. With --html, nothing is run: the run "
        "folder's trace.npz and report.json become one page with a time slider, to be opened in any browser; with "
        "--rerun a recording for the Rerun viewer (`rerun RUN/replay.rrd`).",
    )
    replay.add_argument("log", type=Path, help="a run folder, or a frame log (frames.npz)")
    replay.add_argument(
        "--html", type=Path, nargs="?", const=Path(), metavar="FILE", help="write the page (default: RUN/replay.html)"
    )
    replay.add_argument(
        "--rerun",
        type=Path,
        nargs="?",
        const=Path(),
        metavar="FILE",
        help="write a recording for the Rerun viewer (default: RUN/replay.rrd; pip install 'twc_env[rerun]')",
    )
    replay.add_argument("--truth", type=Path, metavar="FILE", help="truth.npz: also print the team's trajectory error")
    replay.add_argument(
        "--filter",
        choices=("compiled", "filterpy"),
        default="compiled",
        help="odometry filter: the compiled kernel, or filterpy's EKF, its oracle (default: %(default)s)",
    )
    replay.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", help="any setting, by dotted key")
    replay.add_argument("--out", type=Path, metavar="DIR", help="write merged maps (map_server) and pose_graph.g2o")
    replay.add_argument("--json", type=Path, metavar="FILE", help="write the figures")
    replay.set_defaults(run=_replay)
    if TABLES:
        add_parser(commands)
    return parser


def _bench(options: argparse.Namespace) -> None:
    from twc_env.bench import bench
    from twc_env.bench_scaling import scaling_table
    from twc_env.config import EnvConfig, override

    settings = {"map": options.map, "robots": options.robots, "lidar.beam_count": options.beams}
    config = override(EnvConfig(), {**settings, "max_cycles": options.steps, **assignments(options.set)})
    if options.parts:
        _bench_parts(config, options)
        return
    if options.peers or options.scaling:
        figures = _bench_peers(options)
    else:
        figures = bench(config, options.episodes, report=_report)
    for key, value in figures.items():
        if key == "scaling":
            print(scaling_table(value))
        else:
            print(f"{key:<28} {value:,.3f}" if isinstance(value, float) else f"{key:<28} {value}")
    _write_json(options.json, figures)


def _bench_peers(options: argparse.Namespace) -> dict:
    from twc_env.bench_peers import bench_peers
    from twc_env.bench_scaling import bench_large_reset, bench_scaling

    figures = bench_peers(report=_report) if options.peers else {}
    return figures | bench_large_reset() | {"scaling": bench_scaling(report=_report)}


def _report(line: str) -> None:
    print(line, file=sys.stderr, flush=True)


def _bench_parts(config: EnvConfig, options: argparse.Namespace) -> None:
    from twc_env.bench_parts import bench_parts, table_of, time_matching

    rows = bench_parts(config, options.episodes, report=_report)
    print(table_of(rows))
    matching = time_matching(config)
    for key, value in matching.items():
        print(f"{key:<32}{value:>18.3f}")
    _write_json(options.json, {row.part: round(row.robot_step_us, 3) for row in rows} | matching)


def _soak(options: argparse.Namespace) -> None:
    if options.actions is not None or options.observations is not None:
        _misuse(options)
        return
    from twc_env.config import EnvConfig, override
    from twc_env.soak import soak

    config = override(EnvConfig(), assignments(options.set))
    figures = soak(options.steps, options.seed, config, lambda line: print(f"\r{line}", end="", file=sys.stderr))
    print(file=sys.stderr)
    for key, value in figures.items():
        print(f"{key:<28} {value:,.1f}" if isinstance(value, float) else f"{key:<28} {value}")
    _write_json(options.json, figures)


def _misuse(options: argparse.Namespace) -> None:
    """Broken actions and a long look at observations. Raises TwcError with what was found."""
    from twc_env.action_fuzz import fuzz_actions
    from twc_env.observation_check import check_observations

    figures: dict[str, object] = {}
    faults: list[str] = []
    if options.actions is not None:
        _at_least_one("--actions", options.actions)
        thrown = fuzz_actions(options.actions, options.seed, _count)
        print(
            f"{thrown.count} broken actions: {thrown.refused} refused, {thrown.accepted} sound after all, "
            f"{len(thrown.escaped)} raised something else; {thrown.steps_compared} steps equal to those of a team "
            "that was spared them" + (f", but for {thrown.changed}" if thrown.changed else "")
        )
        faults += thrown.escaped[:5] + [f"refused actions of kind {kind} left a mark" for kind in thrown.changed]
        figures["actions"] = {name: getattr(thrown, name) for name in thrown.__slots__}
    if options.observations is not None:
        _at_least_one("--observations", options.observations)
        seen = check_observations(options.observations, options.seed, _count)
        print(f"{seen.steps} random steps, {seen.blocks} blocks looked at, {len(seen.faults)} faults")
        faults += seen.faults
        figures["observations"] = {name: getattr(seen, name) for name in seen.__slots__}
    _write_json(options.json, figures)
    if faults:
        raise TwcError("; ".join(faults))


def _at_least_one(name: str, value: int) -> None:
    if value < 1:
        raise ConfigError(f"{name} must be 1 or more; got {value}")


def _count(done: int, total: int) -> None:
    if sys.stderr.isatty():
        print(f"\r{done}/{total}", end="\n" if done == total else "", file=sys.stderr, flush=True)


def _record(options: argparse.Namespace) -> None:
    from twc_env.bench import wander
    from twc_env.config import EnvConfig, override
    from twc_env.datasets.frame_log import write_frame_log, write_truth_log
    from twc_env.errors import DataError
    from twc_env.exploration.environment import ExplorationEnv

    settings = {"map": options.map, "robots": options.robots, "max_cycles": options.steps}
    env = ExplorationEnv(config=override(EnvConfig(), {**settings, **assignments(options.set)}))
    env.reset(seed=options.seed)
    steps, contacts = [env.frames], [env.contacts]
    for actions in wander(env, options.seed):
        env.step(actions)
        steps.append(env.frames)
        contacts.append(env.contacts)
        _progress(len(steps) - 1, env.config.max_cycles)
    try:
        options.out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise DataError(f"cannot make the folder {options.out}: {error.strerror}; choose another with --out") from error
    write_frame_log(options.out / "frames.npz", env.config, steps, contacts)
    write_truth_log(options.out / "truth.npz", options.seed, env.config.map, env.result().true_poses)
    print(f"recorded {len(steps) - 1} steps of {env.config.robots} robots: {options.out}/frames.npz and truth.npz")


def _progress(done: int, total: int) -> None:
    if sys.stderr.isatty() and (done % 50 == 0 or done == total):
        print(f"\r{done}/{total} steps", end="\n" if done == total else "", file=sys.stderr, flush=True)


def _replay(options: argparse.Namespace) -> None:
    run = options.log if options.log.is_dir() else options.log.parent
    if options.html is not None:
        from twc_env.replay_page import write_page

        print(write_page(run, run / "replay.html" if options.html == Path() else options.html))
    if options.rerun is not None:
        from twc_env.rerun_export import write_rerun

        print(write_rerun(run, run / "replay.rrd" if options.rerun == Path() else options.rerun))
    if options.html is not None or options.rerun is not None:
        return
    _replay_frames(options, options.log / "frames.npz" if options.log.is_dir() else options.log)


def _replay_frames(options: argparse.Namespace, log: Path) -> None:
    from twc_env.config import digest, override
    from twc_env.datasets.frame_log import read_contacts, read_frame_log, read_truth_log
    from twc_env.slam.engine import CooperativeSlam

    config, steps = read_frame_log(log)
    config = override(config, {**assignments(options.set), "slam.odometry_filter.backend": options.filter})
    robots = 1 + max(frame.robot for frames in steps for frame in frames)
    engine = CooperativeSlam(config, robots)
    odom_poses = []
    contacts = read_contacts(log)
    for count, frames in enumerate(steps):
        engine.update(frames, contacts[count] if contacts else None)
        odom_poses.append([front_end.pose_odom for front_end in engine.robots])
        _progress(count + 1, len(steps))
    if steps[-1][0].step >= config.max_cycles:  # the episode was played to its end, where the mapper clears its desk
        engine.finish()
    team = engine.team
    figures = {
        "log": str(log),
        "steps": len(steps),
        "filter": options.filter,
        "groups": [list(group.robots) for group in team.groups],
        "keyframes": [len(keyframes) for keyframes in team.keyframes],
        "closures_accepted": sum(c.status == "accepted" for c in team.closures),
        "closures_proposed": len(team.closures),
        "final_poses": [[round(float(v), 6) for v in engine.pose_map_robot(r)] for r in range(len(engine.robots))],
        "config_digest": digest(config),
    }
    if options.truth:
        figures["team_ate_m"] = _error_of_log(engine, np.array(odom_poses), read_truth_log(options.truth)[2])
    for key, value in figures.items():
        print(f"{key:<20} {value}")
    _write_json(options.json, figures)
    if options.out:
        _write_maps(options.out, team)


def _error_of_log(engine: CooperativeSlam, odom_poses: np.ndarray, true_poses: np.ndarray) -> float:
    """Team ATE [m] over a whole log, each group of robots aligned once."""
    from twc_env.errors import DataError
    from twc_env.exploration.team_alignment import team_error_m

    if odom_poses.shape != true_poses.shape:
        raise DataError(f"the truth has shape {true_poses.shape}, the log {odom_poses.shape}: give the pair of one run")
    return team_error_m(engine, odom_poses, true_poses)


def _write_maps(folder: Path, team: TeamMapper) -> None:
    from twc_env.datasets.g2o import write_g2o
    from twc_env.datasets.ros_map import write_ros_map

    folder.mkdir(parents=True, exist_ok=True)
    for index in range(len(team.groups)):
        write_ros_map(team.grid_of(index), folder, "map" if index == 0 else f"map_{index}")
    write_g2o(folder / "pose_graph.g2o", team.graph())


def assignments(texts: Sequence[str]) -> dict[str, object]:
    """`KEY=VALUE` texts of the command line as a dictionary."""
    pairs = [text.partition("=") for text in texts]
    for key, separator, _ in pairs:
        if not separator:
            raise ConfigError(f"--set takes KEY=VALUE, for example lidar.beam_count=360; got {key!r}")
    return {key: value for key, _, value in pairs}


def _write_json(path: Path | None, values: dict) -> None:
    if path is not None:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(json.dumps(values, indent=2) + "\n")


if __name__ == "__main__":
    sys.exit(main())
