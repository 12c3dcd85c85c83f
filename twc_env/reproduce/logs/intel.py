"""The Intel Research Lab log, from raw odometry and scans to a map, by the same engine as in the environment.

The log has 910 scans of the front half over 500 m, one every 0.5 to 0.7 m or half a radian; every scan becomes a
keyframe. Loop candidates come from proximity in the current estimate and scan similarity only. There are no signs and
no WiFi, so merging requires more closures instead. With `robots` above 1 the log is split into as many consecutive
pieces, played simultaneously, each robot in its own frame. They merge only where the geometry allows it; a relation
between robots that share no map counts as missed (`relations` is the number evaluated).

Errors are means (and medians) over the 119 hand-verified relations of the Freiburg SLAM benchmark whose two ends are
within 20 ms of scans in the log. The log omits most scans, and laser stamps come in bursts (some scans are 5 ms apart).
So 29 relations refer to an omitted neighbour of a logged scan, from which the robot may have turned by some degrees;
relations that share such a stamp have the same angular error. The columns `exact` use the 90 relations whose two stamps
match logged scans to the microsecond. The particle filter is our own GMapping-style baseline
(`twc_env.slam.front_end.particle_filter`).
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.config import from_dict
from twc_env.datasets.logs.scan_log import (
    BEAMS,
    RANGE_MAX_M,
    SETTINGS,
    Relations,
    ScanLog,
    beam_count_of,
    sensor_frames,
)
from twc_env.errors import ConfigError
from twc_env.pictures.style import new_figure
from twc_env.records.geometry import between, compose
from twc_env.records.messages import SensorFrame
from twc_env.replaying.odometry_errors import taken_from_log
from twc_env.reproduce.drawing import draw_grid, save_picture
from twc_env.reproduce.logs.laser_logs import intel_log, intel_relations
from twc_env.reproduce.runner import Runner, add_seeds
from twc_env.running.options import count, picture_options
from twc_env.slam.engine import CooperativeSlam
from twc_env.slam.front_end.particle_filter import ParticleFilterSettings, map_frames
from twc_env.slam.scans.occupancy_grid import OccupancyGrid

CHOOSES = ("robots", "seeds")

SAME_SCAN_S = 1e-6
"""Time stamps have microseconds: a larger difference means another scan."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the table."""
    parser.add_argument(
        "--robots", type=count, nargs="+", default=[1, 3], help="numbers of robots to split the log into (default: 1 3)"
    )
    parser.add_argument("--particles", type=count, default=20, help="particles of the particle filter")
    add_seeds(parser, "0-2", "seeds of the particle filter")
    parser.add_argument("--scans", type=count, default=910, help="only the first scans of the log (default: all)")


def rows(options: argparse.Namespace, runner: Runner) -> list[dict]:
    """One row per method and number of robots.

    {method, robots, relations, translation_error_m, rotation_error_deg, translation_median_m, rotation_median_deg,
    relations_exact, translation_exact_m, rotation_exact_deg, robots_in_one_map}.
    """
    if max(options.robots) > options.scans:
        most = max(options.robots)
        raise ConfigError(f"{most} robots need {most} scans or more; got {options.scans}")
    log, relations = read_log(options.scans)
    corrected = read_corrected(options.scans)
    alone = np.zeros(len(corrected), int)
    table = [
        row("odometry", log.poses, alone, relations, 1),
        row("corrected log (GMapping)", corrected, alone, relations, 1),
    ]
    for robots, run in zip(options.robots, _runs(options, runner), strict=True):
        table.append(row("engine", np.array(run["poses"]), np.array(run["group"]), relations, robots))
    for seed, path in zip(options.seeds, _particle_paths(options, runner), strict=True):
        table.append(row(f"particle filter, seed {seed}", np.array(path), alone, relations, 1))
    return table


def _particle_paths(options: argparse.Namespace, runner: Runner) -> list:
    log, _ = read_log(options.scans)
    frames = sensor_frames(log, BEAMS, RANGE_MAX_M)
    settings = ParticleFilterSettings(particles=options.particles)
    return runner.each(
        options.seeds,
        lambda seed: map_frames(frames, settings, RANGE_MAX_M, seed)[0],
        lambda seed: f"particle filter {seed}",
    )


def _runs(options: argparse.Namespace, runner: Runner) -> list[dict]:
    log, _ = read_log(options.scans)
    return runner.each(options.robots, lambda robots: run_engine(log, robots), lambda robots: f"{robots} robots")


def read_log(count: int) -> tuple[ScanLog, Relations]:
    """The first scans of the raw log, and the relations between them."""
    whole = intel_log()
    found = intel_relations(whole)
    inside = (found.first < count) & (found.second < count)
    return whole.at(slice(count)), Relations(
        found.first[inside], found.second[inside], found.pose_first_second[inside], found.away_s[inside]
    )


def read_corrected(count: int) -> Array:
    """(count, 3) poses of the first scans in the published log, corrected by GMapping."""
    return intel_log(is_corrected=True).poses[:count]


def run_engine(log: ScanLog, robots: int, is_noise_told: bool = False) -> dict:
    """Poses (scans, 3) of the engine, each in the map of its group, and the group (scans,) of each.

    is_noise_told: the errors of the odometry are those that the log shows, as in `twc-env replay`; else assumed.
    """
    pieces = np.array_split(np.arange(len(log.times_s)), robots)
    beams = beam_count_of([log])
    paths: Sequence[Sequence[SensorFrame]] = [
        sensor_frames(log, beams, RANGE_MAX_M, piece, robot) for robot, piece in enumerate(pieces)
    ]
    lidar = SETTINGS["lidar"] | {"beam_count": beams}
    config = from_dict(SETTINGS | {"lidar": lidar, "robots": robots})
    if is_noise_told:
        config, paths, _ = taken_from_log(config, paths)
    engine = CooperativeSlam(config, robots)
    placed = place_frames(engine, paths)
    group = [np.full(len(path), engine.team.group_index(robot)) for robot, path in enumerate(placed)]
    return {"poses": np.concatenate(placed), "group": np.concatenate(group)}


def place_frames(engine: CooperativeSlam, paths: Sequence[Sequence[SensorFrame]]) -> list[Array]:
    """Run the engine on the frames of all robots; (frames, 3) poses of each robot in the final map of its group."""
    poses_odom: list[list[Array]] = [[] for _ in paths]
    for step in range(max(map(len, paths))):
        frames = [path[step] for path in paths if step < len(path)]
        engine.update(frames)
        for frame in frames:
            poses_odom[frame.robot].append(engine.poses_odom[frame.robot].copy())
    engine.finish()
    return [_in_map(engine, robot, np.array(path)) for robot, path in enumerate(poses_odom)]


def _in_map(engine: CooperativeSlam, robot: int, poses_odom: Array) -> Array:
    """(scans, 3) the path of a robot, placed by its keyframes."""
    steps = engine.team.keyframe_steps(robot)
    last = np.searchsorted(steps, np.arange(len(poses_odom)), side="right") - 1
    return compose(engine.team.poses_of(robot)[last], between(poses_odom[steps[last]], poses_odom))


def row(method: str, poses: Array, group: Array, relations: Relations, robots: int) -> dict:
    """Errors of poses (scans, 3), each in the frame of its group (scans,), at relations within a group."""
    translation_m, rotation_deg = relations.errors(poses)
    is_compared = group[relations.first] == group[relations.second]
    exact = is_compared & (relations.away_s < SAME_SCAN_S)
    starts = [piece[0] for piece in np.array_split(np.arange(len(poses)), robots)]
    return {
        "method": method,
        "robots": robots,
        "relations": int(is_compared.sum()),
        "translation_error_m": float(translation_m[is_compared].mean()),
        "rotation_error_deg": float(rotation_deg[is_compared].mean()),
        "translation_median_m": float(np.median(translation_m[is_compared])),
        "rotation_median_deg": float(np.median(rotation_deg[is_compared])),
        "relations_exact": int(exact.sum()),
        "translation_exact_m": float(translation_m[exact].mean()),
        "rotation_exact_deg": float(rotation_deg[exact].mean()),
        "robots_in_one_map": int(np.bincount(group[starts]).max()),
    }


def draw(options: argparse.Namespace, runner: Runner, folder: Path) -> list[Path]:
    """Draw the map of the largest group of each run, from the scans at the engine's poses."""
    log, _ = read_log(options.scans)
    scans = np.array([frame.ranges_m for frame in sensor_frames(log, BEAMS, RANGE_MAX_M)])
    written = []
    for robots, run in zip(options.robots, _runs(options, runner), strict=True):
        poses, group = np.array(run["poses"]), np.array(run["group"])
        inside = group == np.argmax(np.bincount(group))
        grid = OccupancyGrid(0.05, RANGE_MAX_M, BEAMS)
        grid.integrate(poses[inside], scans[inside])
        figure = new_figure((9, 9), dpi=110)
        axes = figure.add_subplot()
        draw_grid(axes, grid)
        for k, piece in enumerate(np.array_split(np.arange(len(poses)), robots)):
            axes.plot(*poses[piece[inside[piece]], :2].T, linewidth=0.6, color=f"C{k}")
        near = poses[inside, :2]
        axes.set(xlim=(near[:, 0].min() - 6, near[:, 0].max() + 6), ylim=(near[:, 1].min() - 6, near[:, 1].max() + 6))
        axes.set(xlabel="x [m]", ylabel="y [m]", title=f"Intel Lab, {robots} robot(s)")
        written.append(save_picture(figure, folder / f"intel-{robots}", picture_options(options)))
    return written
