"""`twc-env replay`: the SLAM engine on recorded logs, and exports of runs."""

from __future__ import annotations

import argparse
import zipfile
from collections.abc import Sequence
from itertools import accumulate, zip_longest
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from twc_env.errors import DataError
from twc_env.records.json_values import check_folder, write_json
from twc_env.running.command_line import (
    add_allow_code,
    add_json,
    add_set,
    assignments,
    make_folder,
    refuse_code,
    show_count,
    tell,
)

if TYPE_CHECKING:
    from twc_env.config import EnvConfig
    from twc_env.records.messages import Contacts, SensorFrame
    from twc_env.slam.modes import Engine
    from twc_env.slam.team import TeamMapper


def add_arguments(replay: argparse.ArgumentParser) -> None:
    """Fill the command's parser."""
    replay.description = (
        "Run the SLAM engine on the frames of a log and print the result, which is deterministic. LOG is "
        "frames.npz of a run folder, or a laser log of one robot (CARMEN FLASER or ROBOTLASER1 lines, or the Freiburg "
        "benchmark's JSON). Several laser logs are a team of one robot each that starts at the same time; their maps "
        "are merged where scans fit. The engine uses nothing but the logs. --html and --rerun run nothing: they "
        "convert the run folder's trace.npz and report.json to a web page with a time slider, or to a recording for "
        "the Rerun viewer (`rerun RUN/replay.rrd`)."
    )
    replay.epilog = (
        "examples:\n  twc-env replay runs/log/frames.npz --truth runs/log/truth.npz\n"
        "  twc-env replay runs/demo --set slam.place_recognition.recogniser=text --out runs/text\n"
        "  twc-env replay intel.log.gz --set slam.pose_graph.robust=dcs --out runs/intel\n"
        "  twc-env replay monday.log tuesday.log --out runs/both\n"
        "  twc-env replay runs/demo --html"
    )
    replay.add_argument(
        "logs",
        type=Path,
        nargs="+",
        metavar="LOG",
        help="a run folder, a frame log (frames.npz), or laser logs, one of each robot (.log, .json; .gz too)",
    )
    replay.add_argument(
        "--html",
        type=Path,
        nargs="?",
        const=Path(),
        metavar="FILE",
        help="write the web page (default: RUN/replay.html)",
    )
    replay.add_argument(
        "--rerun",
        type=Path,
        nargs="?",
        const=Path(),
        metavar="FILE",
        help="write a recording for the Rerun viewer (default: RUN/replay.rrd; pip install 'twc_env[rerun]')",
    )
    replay.add_argument(
        "--truth", type=Path, metavar="FILE", help="truth.npz, to also print the team's trajectory error"
    )
    replay.add_argument(
        "--filter",
        choices=("compiled", "filterpy"),
        help="odometry filter: compiled kernel, or filterpy's EKF as a reference (default: as in the log)",
    )
    add_set(replay)
    add_allow_code(replay)
    replay.add_argument(
        "--out",
        type=Path,
        metavar="FOLDER",
        help="write map.pgm + .yaml (map_server), pose_graph.g2o, trajectories/*.tum",
    )
    add_json(replay)
    replay.set_defaults(run=_replay)


def _replay(options: argparse.Namespace) -> None:
    is_export = options.html is not None or options.rerun is not None
    for log in options.logs:
        if not log.exists():
            what = "run folder" if is_export else "run folder or log"
            raise DataError(f"there is no {what} {log}: `twc-env explore --out RUN` writes one")
        if log.is_dir() and not is_export and not (log / "frames.npz").exists():
            raise DataError(f"{log} is no run folder (no frames.npz): `twc-env explore --out RUN` writes one")
        if len(options.logs) > 1 and (log.is_dir() or _is_frame_log(log)):
            raise DataError(f"{log} is of a whole team: give it alone; several logs are laser logs, one of each robot")
    log = options.logs[0]
    run = log if log.is_dir() else log.parent
    if options.html is not None:
        from twc_env.pictures.replay_page import write_page

        print(f"written: {write_page(run, run / 'replay.html' if options.html == Path() else options.html)}")
    if options.rerun is not None:
        from twc_env.pictures.rerun_export import write_rerun

        print(f"written: {write_rerun(run, run / 'replay.rrd' if options.rerun == Path() else options.rerun)}")
    if not is_export:
        _replay_frames(options, [log / "frames.npz"] if log.is_dir() else options.logs)


def _replay_frames(options: argparse.Namespace, logs: Sequence[Path]) -> None:
    from twc_env.config import digest, override
    from twc_env.datasets.logs.frame_log import read_truth_log
    from twc_env.slam.modes import make_engine

    check_folder(options.out)
    asked = assignments(options.set)
    config, steps, contacts, begun_s = _read_logs(logs, asked.get("lidar.beam_count"))
    if not options.allow_code:
        refuse_code(config, logs[0], asked)
    chosen = {} if options.filter is None else {"slam.odometry_filter.backend": options.filter}
    config = override(config, {**asked, **chosen})
    odom_poses: list[np.ndarray] = []
    if config.slam.oracle != "none":
        tell(f"slam.oracle = {config.slam.oracle!r}: ignored, since logs contain no ground truth")
    if config.slam.k_visibility.enabled and config.slam.k_visibility.are_transmitters_known:
        ignored = "slam.k_visibility.are_transmitters_known"
        tell(f"{ignored}: ignored, since logs contain no ground truth")
    if config.link.topology == "peer":
        tell("each robot has a mapper of its own: groups, closures, map and graph are those of robot 0")
    seen = 1 + max(frame.robot for frames in steps for frame in frames)
    robots = contacts[0].heard.shape[1] if contacts else seen
    engine = make_engine(config, robots)
    first = next(frames[0].step - k for k, frames in enumerate(steps) if frames)
    for step, frames in enumerate(steps, first):  # steps in the frames may differ between robots
        if frames:
            engine.track(frames)
        engine.absorb(step, contacts[step - first] if contacts else None)
        odom_poses.append(engine.poses_odom)
        show_count(step - first + 1, len(steps), " steps", every=50)
    last = max([step, *(frame.step for frame in steps[-1])])
    if last >= config.max_cycles or not _is_frame_log(logs[0]):  # a complete episode: the backlog is processed
        engine.finish()
    team = engine.team
    figures = {
        "log": " ".join(map(str, logs)),
        "steps": len(steps),
        "filter": config.slam.odometry_filter.backend,
        "groups": [list(group.robots) for group in team.groups],
        "keyframes": [len(team.keyframe_steps(robot)) for robot in range(robots)],
        "closures_accepted": sum(c.status == "accepted" for c in team.closures),
        "closures_proposed": team.closures_verified,
        "final_poses": [[round(float(v), 6) for v in engine.pose_map_robot(r)] for r in range(robots)],
        "config_digest": digest(config),
    }
    if options.truth:
        figures["team_ate_m"] = _error_of_log(engine, np.array(odom_poses), read_truth_log(options.truth)[2])
    for key, value in figures.items():
        print(f"{key:<20} {value}")
    write_json(options.json, figures)
    if options.out:
        _write_maps(options.out, team)
        _write_paths(options.out, engine, steps, np.array(odom_poses), begun_s)
        print(f"\nwritten: {options.out}")


def _read_logs(
    logs: Sequence[Path],
    beam_count: object = None,
) -> tuple[EnvConfig, Sequence[Sequence[SensorFrame]], list[Contacts], Sequence[float]]:
    """Settings, frames per step, contacts per step ([] for laser logs), and start time [s] of each robot's clock.

    beam_count: directions of laser logs; None: as many as their scanners have.
    """
    from twc_env.config import from_dict
    from twc_env.datasets.logs import frame_log, scan_log

    if _is_frame_log(logs[0]):
        config, steps = frame_log.read_frame_log(logs[0])
        return config, steps, frame_log.read_contacts(logs[0]), [0.0] * config.robots
    scans = [scan_log.read_any_log(log) for log in logs]
    beams = beam_count if isinstance(beam_count, int) and beam_count > 0 else scan_log.beam_count_of(scans)
    paths = [scan_log.sensor_frames(s, beams, scan_log.RANGE_MAX_M, robot=r) for r, s in enumerate(scans)]
    steps = [tuple(frame for frame in frames if frame is not None) for frames in zip_longest(*paths)]
    lidar = scan_log.SETTINGS["lidar"] | {"beam_count": beams}
    config = from_dict(scan_log.SETTINGS | {"lidar": lidar, "robots": len(logs), "max_cycles": len(steps)})
    return config, steps, [], [float(s.times_s[0]) for s in scans]


def _is_frame_log(log: Path) -> bool:
    """Whether a file is a frame log: a zip archive, or anything named .npz."""
    return log.suffix == ".npz" or zipfile.is_zipfile(log)


def _error_of_log(engine: Engine, odom_poses: np.ndarray, true_poses: np.ndarray) -> float:
    """Team ATE [m] over a whole log, each group of robots aligned once."""
    from twc_env.exploration.assessment.team_alignment import team_error_m

    if odom_poses.shape != true_poses.shape:
        raise DataError(f"the truth has shape {true_poses.shape}, the log {odom_poses.shape}: give the pair of one run")
    return team_error_m(engine, odom_poses, true_poses)


def _write_maps(folder: Path, team: TeamMapper) -> None:
    from twc_env.datasets.buildings.ros_map import write_ros_maps
    from twc_env.datasets.logs.g2o import write_g2o

    make_folder(folder)
    largest_first = sorted(range(len(team.groups)), key=lambda group: -len(team.groups[group].robots))
    write_ros_maps(map(team.grid_of, largest_first), folder)
    write_g2o(folder / "pose_graph.g2o", team.graph())


def _write_paths(
    folder: Path,
    engine: Engine,
    steps: Sequence[Sequence[SensorFrame]],
    odom_poses: np.ndarray,
    begun_s: Sequence[float],
) -> None:
    """Write each robot's trajectory at the times of its frames: in its group's map, and by odometry from its start."""
    from twc_env.datasets.logs.tum import write_tum
    from twc_env.exploration.assessment.team_alignment import TeamPaths
    from twc_env.records.geometry import compose

    rows, last = [], -1  # row of odom_poses for each step; a step missing in the log has the previous row
    for row, frames in enumerate(steps):
        step = frames[0].step if frames else last + 1
        rows += [row - 1] * (step - last - 1) + [row]
        last = step
    estimated = TeamPaths(engine, odom_poses[np.maximum(rows, 0)]).as_seen()
    make_folder(folder / "trajectories")
    for robot in sorted({frame.robot for frames in steps for frame in frames}):
        own = [frame for frames in steps for frame in frames if frame.robot == robot]
        odometry = accumulate((frame.odometry for frame in own), compose, initial=np.zeros(3))
        paths = {
            "estimated": estimated[[frame.step for frame in own], robot],
            "odometry": np.array(list(odometry))[1:],
        }
        for kind, poses in paths.items():
            path = folder / "trajectories" / f"robot_{robot}_{kind}.tum"
            write_tum(path, np.array([begun_s[robot] + frame.time_s for frame in own]), poses)
