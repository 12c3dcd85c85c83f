"""Command line: python -m twc_env maps | bench | replay | reproduce."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from pathlib import Path

from twc_env.errors import ConfigError, TwcError
from twc_env.maps_cli import add_maps_parser
from twc_env.reproduce.runner import TABLES, add_parser


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
    parser = argparse.ArgumentParser(prog="python -m twc_env", description="Look at maps, measure speed, replay logs.")
    commands = parser.add_subparsers(required=True, metavar="COMMAND")

    add_maps_parser(commands)

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
    speed.add_argument("--json", type=Path, metavar="FILE", help="write the figures as one flat object")
    speed.set_defaults(run=_bench)

    replay = commands.add_parser(
        "replay",
        help="run the SLAM engine on recorded sensor frames, without any world",
        description="The engine sees the frames of a log (frames.npz of a run folder) and nothing else. "
        "Prints what it found; the same log gives the same numbers every time.",
    )
    replay.add_argument("log", type=Path, help="a frame log written by `python -m agents explore`")
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
    from twc_env.config import EnvConfig, override

    settings = {"map": options.map, "robots": options.robots, "lidar.beam_count": options.beams}
    config = override(EnvConfig(), {**settings, "max_cycles": options.steps, **assignments(options.set)})
    figures = bench(config, options.episodes, report=lambda line: print(line, file=sys.stderr))
    for key, value in figures.items():
        print(f"{key:<28} {value:,.3f}" if isinstance(value, float) else f"{key:<28} {value}")
    _write_json(options.json, figures)


def _replay(options: argparse.Namespace) -> None:
    from twc_env.config import digest, override
    from twc_env.datasets.frame_log import read_frame_log
    from twc_env.slam.engine import CooperativeSlam

    config, steps = read_frame_log(options.log)
    config = override(config, {**assignments(options.set), "slam.odometry_filter.backend": options.filter})
    engine = CooperativeSlam(config, 1 + max(frame.robot for frames in steps for frame in frames))
    for count, frames in enumerate(steps):
        engine.update(frames)
        if sys.stderr.isatty() and count % 50 == 0:
            print(f"\r{count}/{len(steps)} steps", end="", file=sys.stderr)
    if steps[-1][0].step >= config.max_cycles:  # the episode was played to its end, where the mapper clears its desk
        engine.finish()
    if sys.stderr.isatty():
        print(file=sys.stderr)
    team = engine.team
    figures = {
        "log": str(options.log),
        "steps": len(steps),
        "filter": options.filter,
        "groups": [list(group.robots) for group in team.groups],
        "keyframes": [len(keyframes) for keyframes in team.keyframes],
        "closures_accepted": sum(c.status == "accepted" for c in team.closures),
        "closures_proposed": len(team.closures),
        "final_poses": [[round(float(v), 6) for v in engine.pose_map_robot(r)] for r in range(len(engine.robots))],
        "config_digest": digest(config),
    }
    for key, value in figures.items():
        print(f"{key:<20} {value}")
    _write_json(options.json, figures)
    if options.out:
        _write_maps(options.out, team)


def _write_maps(folder: Path, team) -> None:
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
