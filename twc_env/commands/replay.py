"""`twc-env replay`: the SLAM engine on recorded logs, and exports of runs."""

from __future__ import annotations

import argparse
import itertools
import time
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from twc_env.errors import DataError
from twc_env.records.json_values import TERMINAL, check_folder, check_writable, write_json
from twc_env.running.options import (
    PICTURE_FORMATS,
    add_allow_code,
    add_json,
    add_lasting,
    add_pictures,
    add_set,
    assignments,
    picture_options,
    prior_setting,
    refuse_code,
)
from twc_env.running.terminal import aligned, end_line, tell, terminal_width

if TYPE_CHECKING:
    from twc_env.config import EnvConfig
    from twc_env.replaying.inputs import Asked, ReplayInput
    from twc_env.replaying.run import Replay

SAMPLE = "sample"
SCANS_ALONE = (
    "maps fit each other by their scans alone, and rooms that look alike fit, too: look at the picture, or give WiFi "
    "or signs (--wifi, --signs)"
)
LOST_MIN = 0.5
"""A robot that is lost longer than this share of its scans may be sought in another way."""
READINGS_ALONE = (
    "places were sought by the readings of --wifi and --signs: few signs, or access points and signs that were moved "
    "since, find none; leave a table out, or both, to seek them by scans"
)


def add_arguments(replay: argparse.ArgumentParser) -> None:
    """Fill the command's parser."""
    replay.description = (
        "Run the SLAM engine on the frames of a log and print the result, which is deterministic. LOG is frames.npz of "
        "a run folder; or a ROS bag (.bag of ROS 1; the folder, .db3 or .mcap of ROS 2; needs no ROS, but "
        "`pip install 'twc_env[ros]'`) with LaserScan and Odometry or tf of one robot or of several by namespace; or a "
        "CARMEN log of one robot (FLASER, ROBOTLASER1, or RAWLASER1 with ODOM), or the Freiburg benchmark's JSON. "
        "Several logs are a team; their maps are merged where scans fit. `sample` is a log of the package. The engine "
        "uses nothing but the logs.\n\n"
        "With --out, the folder gets map.pgm + .yaml (ROS map_server; map_2 ... of robots whose maps are not merged), "
        "pose_graph.g2o, pose_graph.csv (whose keyframe each vertex is), trajectories/*.tum (for evo), table.csv, "
        "map.png and the page replay.html. Of a run folder, --html and --rerun run nothing: they convert its trace.npz "
        "and report.json to a web page with a time slider, replay.html, or to a recording for the Rerun "
        "viewer, replay.rrd, in that folder or in --out."
    )
    replay.epilog = (
        "examples:\n  twc-env replay sample --out runs/sample\n"
        "  twc-env replay mine.bag --list\n"
        "  twc-env replay mine.bag --wifi wifi.csv --out runs/mine --bag runs/mine/poses.bag\n"
        "  twc-env replay rosbag2_folder --scan-topic /front/scan --odom-topic none --out runs/mine\n"
        "  twc-env replay runs/log/frames.npz --truth runs/log/truth.npz\n"
        "  twc-env replay runs/demo --set slam.place_recognition.recogniser=text --out runs/text\n"
        "  twc-env replay intel.log.gz --set slam.pose_graph.robust=dcs --out runs/intel --format pdf\n"
        "  twc-env replay monday.log tuesday.log --out runs/both\n"
        "  twc-env replay tuesday.log --prior monday.npz --save both.npz\n"
        "  twc-env replay tuesday.log --prior building.yaml --localise --out runs/tuesday\n"
        "  twc-env replay runs/demo --html"
    )
    replay.add_argument(
        "logs",
        type=Path,
        nargs="+",
        metavar="LOG",
        help="a run folder, a frame log (frames.npz), ROS bags, laser logs (.log, .json; .gz too), or `sample`",
    )
    replay.add_argument(
        "--list",
        action="store_true",
        help="list the topics of bags, their types, counts, rates and frames, and what they would be used for, and the "
        "robots of other logs, their scans, time and odometry; run nothing",
    )
    for option, what in (
        ("--scan-topic", "LaserScan"),
        ("--odom-topic", "Odometry; `none`: tf"),
        ("--imu-topic", "Imu; `none`: no gyro"),
    ):
        replay.add_argument(
            option,
            action="append",
            default=[],
            metavar="TOPIC",
            help=f"use this topic of a bag ({what}) instead of the one found; repeatable, for several robots",
        )
    for option, what in (
        ("--wifi", "WiFi readings beside the log: columns timestamp, bssid, rssi and, for several robots, robot"),
        ("--signs", "sign readings: columns timestamp, text, bearing, range as seen from the robot, and robot"),
    ):
        replay.add_argument(
            option, type=Path, action="append", default=[], metavar="FILE.csv", help=f"{what}; repeatable"
        )
    replay.add_argument(
        "--units",
        action="append",
        default=[],
        metavar="QUANTITY=UNIT",
        help="units of these tables where they are not recognised: time=s|ms|us|ns, angle=rad|deg, length=m|cm|mm, "
        "date=dmy|mdy",
    )
    for option, what in (
        ("--html", "of a run folder: write only the web page; of other logs: write the page beside them without --out"),
        ("--rerun", "of a run folder: write only the recording for the Rerun viewer (pip install 'twc_env[rerun]')"),
    ):
        replay.add_argument(option, action="store_true", help=what)
    replay.add_argument(
        "--truth", type=Path, metavar="FILE", help="truth.npz, to also print the team's trajectory error"
    )
    add_set(replay)
    replay.add_argument(
        "--noise",
        choices=("from-log", "assumed"),
        default="from-log",
        help="errors of a laser log's odometry: found by matching its scans, the constant ones taken off and the rest "
        "told to the engine, or assumed (default: from-log; but assumed with a gyro, of dense scans, with --localise)",
    )
    add_lasting(replay)
    replay.add_argument(
        "--localise",
        action="store_true",
        help="only find the robots' poses in the map of --prior, which does not change; may be a ROS map.yaml",
    )
    add_allow_code(replay)
    replay.add_argument(
        "--out",
        type=Path,
        metavar="FOLDER",
        help="write maps, pose graph, trajectories, table, picture and page, see above",
    )
    add_pictures(replay)
    replay.add_argument("--no-pictures", action="store_true", help="do not draw the map")
    replay.add_argument(
        "--bag",
        type=Path,
        metavar="FILE",
        help="write estimated poses (Odometry, Path, tf from map to odom) and maps (OccupancyGrid) as a new ROS bag: "
        "NAME.bag of ROS 1, NAME.mcap or NAME.db3 of ROS 2, any other name a folder of ROS 2",
    )
    add_json(replay)
    replay.set_defaults(run=_replay)


def _replay(options: argparse.Namespace) -> None:
    from twc_env.datasets.logs.file_kind import refuse_output_of_replay
    from twc_env.datasets.ros.bag_file import is_bag

    is_run = options.logs[0].is_dir() and not is_bag(options.logs[0])
    is_of_run = is_run or options.logs[0].suffix == ".npz"
    is_export = is_of_run and (options.html or options.rerun)
    for log in options.logs:
        if not log.exists() and [str(each) for each in options.logs] != [SAMPLE]:
            if options.html or options.rerun:
                raise DataError(f"there is no run folder {log}: `twc-env explore --out RUN` writes one")
            raise DataError(f"there is no run folder or log {log}: check the path; `sample` is a log of the package")
        is_own_run = log.is_dir() and not is_bag(log)
        if is_own_run and not is_export and not (log / "frames.npz").exists():
            refuse_output_of_replay(log)
            raise DataError(
                f"{log} is no run folder (no frames.npz): name a log, or a folder of `explore --out`; "
                "a bag of ROS 2 is a folder with metadata.yaml"
            )
        if len(options.logs) > 1 and (is_own_run or log.suffix == ".npz"):
            raise DataError(f"{log} is of a whole team: give it alone; several logs are laser logs, one of each robot")
    if options.list:
        _list_contents(options)
        return
    log = options.logs[0]
    run = log if log.is_dir() else log.parent
    if is_export:
        _convert(options, run)
    elif options.rerun:
        raise DataError(f"--rerun converts a run folder of `explore --out`; {log} is a log: leave it out")
    else:
        _replay_frames(options, [log / "frames.npz"] if is_run else options.logs)


def _convert(options: argparse.Namespace, run: Path) -> None:
    """Write the page, the recording, or both, of a run folder."""
    folder = options.out or run
    if options.html:
        from twc_env.pictures.replay_page import write_page

        print(f"written: {write_page(run, folder / 'replay.html')}")
    if options.rerun:
        from twc_env.pictures.rerun_export import write_rerun

        print(f"written: {write_rerun(run, folder / 'replay.rrd')}")


def _asked(options: argparse.Namespace, beam_count: object, range_max: object = None) -> Asked:
    from twc_env.config import EnvConfig, override
    from twc_env.datasets.logs.column_units import unit_choices
    from twc_env.datasets.ros.robot_topics import Wishes
    from twc_env.replaying.inputs import Asked

    wishes = Wishes(tuple(options.scan_topic), tuple(options.odom_topic), tuple(options.imu_topic))
    beams = int(str(beam_count)) if str(beam_count).isdigit() and int(str(beam_count)) > 0 else None
    wished = {} if range_max is None else {"lidar.range_max_m": range_max}
    range_max_m = override(EnvConfig(), wished).lidar.range_max_m if wished else None
    return Asked(wishes, tuple(options.wifi), tuple(options.signs), unit_choices(options.units), beams, range_max_m)


def _list_contents(options: argparse.Namespace) -> None:
    from twc_env.datasets.ros.bag_file import is_bag
    from twc_env.datasets.ros.bag_log import list_topics
    from twc_env.replaying.log_contents import list_robots

    tables = {}
    for log in options.logs:
        rows = list_topics(log, _asked(options, None).wishes) if is_bag(log) else list_robots(log)
        tables[str(log)] = rows
        if options.json != TERMINAL:
            print(f"{log}\n{aligned(rows, terminal_width())}")
    write_json(options.json, tables)


def _replay_frames(options: argparse.Namespace, logs: Sequence[Path]) -> None:
    from twc_env.config import digest, override
    from twc_env.datasets.lasting_maps import prior_of, save_map
    from twc_env.datasets.logs.frame_log import read_truth_log
    from twc_env.pictures.log_page import LogPage
    from twc_env.replaying.inputs import read_input
    from twc_env.replaying.odometry_errors import with_errors_of_log
    from twc_env.replaying.outputs import write_bag
    from twc_env.replaying.run import engine_robots, groups_by_size, run
    from twc_env.slam.map_localisation import MapLocalisation

    check_folder(options.out)
    check_writable(options.bag)
    if options.bag is not None and options.bag.exists():
        raise DataError(f"{options.bag} exists: bags are not overwritten; name another, or delete it")
    asked, begun_s = assignments(options.set), time.monotonic()
    source = read_input(logs, _asked(options, asked.get("lidar.beam_count"), asked.get("lidar.range_max_m")))
    config = source.config
    if not options.allow_code:
        refuse_code(config, logs[0], asked)
    if options.localise and options.save is not None:
        raise DataError("--save writes a map, and --localise changes none: leave one of them out")
    mode = {"slam.mode": "localisation"} if options.localise else {}
    chosen: dict[str, object] = {**asked, **mode, **prior_setting(options)}
    wished = override(config, chosen)
    prior_of(wished)  # a file that is none is refused before the log is looked at for long
    if options.noise == "from-log" and wished.slam.mode == "cooperative":
        source = with_errors_of_log(source)
    config = override(source.config, chosen)
    is_told = options.json != TERMINAL
    _say_what_is_ignored(config)
    for note in source.notes if is_told else ():
        print(note)
    page_path = (options.out or logs[0].parent) / "replay.html" if options.out or options.html else None
    has_page = page_path is not None and config.slam.mode != "off"
    read_s = time.monotonic() - begun_s
    page = None
    if has_page:
        page = LogPage(engine_robots(source, config), len(source.steps), config.dynamics.robot_radius_m)
    begun_cpu_s = time.process_time()
    done = run(source, config, None if page is None else page.note)
    cpu_s = time.process_time() - begun_cpu_s
    end_line()
    team = done.engine.team
    groups = [
        [robot for robot in range(done.robots) if team.group_index(robot) == group] for group in groups_by_size(team)
    ]
    figures = {
        "log": " ".join(map(str, logs)),
        "steps": len(source.steps),
        "groups": groups,
        "maps": done.maps(),
        "keyframes": [len(team.keyframe_steps(robot)) for robot in range(done.robots)],
        "closures_accepted": sum(c.status == "accepted" for c in team.closures),
        "closures_proposed": team.closures_verified,
        "final_poses": [[round(float(v), 6) for v in done.engine.pose_map_robot(r)] for r in range(done.robots)],
        "config_digest": digest(config),
    }
    if options.truth:
        figures["team_ate_m"] = _error_of_log(done, read_truth_log(options.truth)[2])
    if config.slam.prior:
        figures["found_prior"] = [robot for robot in range(done.robots) if done.engine.found_prior(robot)]
    if isinstance(done.engine, MapLocalisation):
        figures["lost_share"] = [round(own.lost_share, 3) for own in done.engine.localisers]
    if options.save:
        figures["saved"] = save_map(options.save, done.engine)
    if is_told:
        for name, value in _told(done, figures):
            print(f"{name:<16} {value}")
        print(f"{'duration':<16} {_pace(done, read_s, cpu_s)}")
        print("\n" + aligned(done.table(), terminal_width()))
        lacked = [done.by_name(line) for line in done.engine.lacked()]
        if len(team.groups) > 1 and lacked:
            print("\nwhy there is more than one map:", *lacked, sep="\n  ")
        elif carried := [line for line in lacked if "put down elsewhere" in line]:
            print("\nnoticed, as scans do not go on from those before:", *carried, sep="\n  ")
        if _rests_on_scans(source, groups, bool(figures.get("found_prior"))):
            print(f"\n{SCANS_ALONE}")
        elif _rests_on_readings(source, config, figures):
            print(f"\n{READINGS_ALONE}")
    write_json(options.json, figures | {"robots": done.table()})
    if options.out:
        _write_folder(options.out, done, options)
    if page is not None and page_path is not None:
        _write_page(page, page_path, done, figures)
    if options.bag is not None:
        write_bag(options.bag, done)
    if is_told:
        for place in (options.out, page_path if has_page and not options.out else None, options.bag):
            if place is not None:
                print(f"\nwritten: {_named(place) if place is options.out else place}")


def _rests_on_scans(source: ReplayInput, groups: Sequence[Sequence[int]], is_in_prior: bool) -> bool:
    """Whether robots share a map, groups (maps, robots of each), or one with a prior map, by nothing but scans."""
    return not _has_readings(source) and (is_in_prior or any(len(robots) > 1 for robots in groups))


def _rests_on_readings(source: ReplayInput, config: EnvConfig, figures: dict[str, Any]) -> bool:
    """Whether robots of laser logs found neither each other nor a prior map by readings, which scans may do."""
    if source.is_episode or not _has_readings(source):
        return False
    if "lost_share" in figures:
        return max(figures["lost_share"]) > LOST_MIN
    is_apart = len([robots for robots in figures["groups"] if robots]) > 1
    is_new = "found_prior" in figures and len(figures["found_prior"]) < len(source.names)
    return config.slam.place_recognition.recogniser in ("fused", "wifi", "text", "twc") and (is_apart or is_new)


def _has_readings(source: ReplayInput) -> bool:
    return any(frame.wifi is not None or frame.signs for frames in source.steps for frame in frames)


def _named(folder: Path) -> str:
    """A folder, and what in it one looks at first."""
    names = (*(f"map.{each}" for each in PICTURE_FORMATS), "replay.html")
    shown = [name for name in names if (folder / name).exists()]
    return f"{folder}: {', '.join([*shown, 'table.csv'])} and more"


def _told(done: Replay, figures: dict[str, Any]) -> list[tuple[str, str]]:
    """The summary for the terminal: names and values with units; a table of the robots follows."""
    rows = [
        ("log", figures["log"]),
        ("time steps", f"{figures['steps']:,}"),
        ("maps", "; ".join(_maps_told(figures["maps"]))),
        ("loop closures", f"{figures['closures_accepted']} accepted of {figures['closures_proposed']} proposed"),
    ]
    if "team_ate_m" in figures:
        rows.append(("team ATE", f"{figures['team_ate_m']:.3f} m"))
    if "found_prior" in figures:
        found = ", ".join(map(str, figures["found_prior"]))
        rows.append(("in the old map", done.by_name(f"robots {found}") if found else "no robot"))
    if "lost_share" in figures:
        shares = ", ".join(f"robot {robot} {share:.0%}" for robot, share in enumerate(figures["lost_share"]))
        rows.append(("lost", done.by_name(f"{shares} of the scans")))
    if "saved" in figures:
        rows.append(("map saved", str(figures["saved"])))
    return [*rows, ("settings digest", figures["config_digest"])]


def _maps_told(maps: Sequence[str]) -> list[str]:
    """Who is in each map; one entry for neighbours of the same."""
    told, number = [], 1
    for robots, same in itertools.groupby(maps):
        last = number + len(list(same)) - 1
        told.append(f"map {number}: {robots}" if last == number else f"maps {number} to {last}: {robots}")
        number = last + 1
    return told


def _pace(done: Replay, read_s: float, cpu_s: float) -> str:
    """How long the log is, and how long it took: only for the terminal, since it differs from run to run."""
    log_s, took_s = float(_times_of_steps(done.source)[-1]), done.elapsed_s
    return f"{log_s:,.0f} s of log replayed in {took_s:.1f} s ({cpu_s:.1f} s of processor time), read in {read_s:.1f} s"


def _say_what_is_ignored(config: EnvConfig) -> None:
    if config.slam.oracle != "none":
        tell(f"slam.oracle = {config.slam.oracle!r}: ignored, since logs contain no ground truth")
    if config.slam.k_visibility.enabled and config.slam.k_visibility.are_transmitters_known:
        ignored = "slam.k_visibility.are_transmitters_known"
        tell(f"{ignored}: ignored, since logs contain no ground truth")
    if config.link.topology == "peer":
        tell("each robot has a mapper of its own: groups, closures, map and graph are those of robot 0")


def _error_of_log(done: Replay, true_poses: np.ndarray) -> float:
    """Team ATE [m] over a whole log, each group of robots aligned once."""
    from twc_env.exploration.assessment.team_alignment import team_error_m

    if done.odom_poses.shape != true_poses.shape:
        raise DataError(
            f"the truth has shape {true_poses.shape}, the log {done.odom_poses.shape}: give the pair of one run"
        )
    return team_error_m(done.engine, done.odom_poses, true_poses)


def _write_folder(folder: Path, done: Replay, options: argparse.Namespace) -> None:
    from twc_env.replaying.outputs import write_maps, write_paths, write_table

    write_maps(folder, done.engine.team)
    write_paths(folder, done)
    write_table(folder / "table.csv", done.table())
    if (asked := picture_options(options)) is not None:
        from twc_env.pictures.log_picture import draw_log

        draw_log(done, folder / f"map.{asked[0]}", asked[1])
    elif not options.no_pictures:
        tell("no picture of the map: it needs `pip install 'twc_env[viz]'`")


def _write_page(page, path: Path, done: Replay, figures: dict) -> None:
    from twc_env._version import __version__

    times_s = _times_of_steps(done.source)
    robots = f"{done.robots} robot{'s' if done.robots > 1 else ''}"
    subtitle = (
        f"{robots}, {len(times_s)} steps in {times_s[-1]:.0f} s, settings {figures['config_digest']}, version "
        f"{__version__}. White and black: estimated map (free, wall); maps that are not merged stand side by side. "
        "Ring: estimated pose. A log holds no true poses."
    )
    title, report = f"replay of {figures['log']}", {**figures, "table": _keyed(done)}
    page.write(path, done.engine, title, subtitle, report, times_s, _told(done, figures))


def _keyed(done: Replay) -> dict:
    return {str(row["robot"]): {key: value for key, value in row.items() if key != "robot"} for row in done.table()}


def _times_of_steps(source: ReplayInput) -> np.ndarray:
    """(steps,) time since the start [s]; that of the first frame of each."""
    begun_s = min(source.begun_s)
    times_s, last_s = [], 0.0
    for frames in source.steps:
        if frames:
            robot, first = frames[0].robot, frames[0]
            offset_s = source.begun_s[robot] - begun_s if source.odometry is not None else 0.0
            last_s = max(last_s, offset_s + first.time_s)
        times_s.append(last_s)
    return np.array(times_s) - times_s[0]
