"""Radio and LiDAR on real drives through a furnished flat: trajectory against a tracked tag, map against the plan.

The robot has no encoders, so its odometry is the commanded motion. `commands` integrates it. `scan odometry` takes the
motion from matching consecutive scans, searched around the command, because a short pulse may turn the robot by any
angle. `lidar` is the engine on that, with loop candidates from proximity and scan similarity; `radio+lidar` proposes
loops from BLE signal strength (6 transmitters) and scans together (`fused`). Scans taken while the robot turns are
ignored. The interpretation of scan stamps as the end of a scanner revolution, and the size of the search around the
command, were chosen on these two drives, from how well scans match across turns and from the tracked tag: the results
are not a test on unseen drives.

Positions are compared with those of the UWB tag after one rigid alignment; the tag's own error and its lever arm of
0.13 m are included. The flat is furnished and the plan is not, so no map can reach a wall IoU of 1.
"""

from __future__ import annotations

import argparse
import dataclasses
import itertools
from pathlib import Path

import numpy as np
from numpy.typing import NDArray as Array

from twc_env import metrics
from twc_env.config import EnvConfig, from_dict
from twc_env.datasets.surveys.ble_drive import DRIVES, Drive, read_ble_drive
from twc_env.datasets.surveys.ble_flat import read_flat
from twc_env.pictures.style import new_figure
from twc_env.records.geometry import compose, poses_along
from twc_env.records.messages import SensorFrame
from twc_env.reproduce.drawing import draw_grid, save_picture
from twc_env.reproduce.logs.intel import place_frames
from twc_env.reproduce.radio_places import flat
from twc_env.reproduce.runner import Runner, add_some, data_folder
from twc_env.running.options import count, picture_options
from twc_env.slam.engine import CooperativeSlam
from twc_env.slam.matching.scan_matching import LineField, scan_points
from twc_env.slam.scans.occupancy_grid import OccupancyGrid
from twc_env.world.building.floorplan import Floorplan

CHOOSES = ("runs",)

BEAMS, RANGE_MAX_M = 360, 12.0
RECOGNISERS = {"lidar": "lidar", "radio+lidar": "fused"}
CELL_M = 0.1
SEARCH, SEARCH_SHARE = (0.15, 0.15), (0.4, 0.35)
"""Search window around the commanded motion [m, rad], its growth per commanded metre or radian ..."""
SEARCH_STEP = (0.05, 0.03)
"""... and its steps."""
REFINE_REACH_M, REFINE_ITERATIONS, DEGENERATE_SHARE, NEAR_WALL_M = 0.4, 20, 0.04, 0.15
MET_MIN = 0.5
"""If a match explains a smaller share of the scan, the commanded motion is used."""
SETTINGS: dict = {
    "robots": 1,
    "lidar": {"beam_count": BEAMS, "range_max_m": RANGE_MAX_M},
    "slam": {
        "odometry_filter": {
            "position_std_per_m": 0.2,
            "position_std_m": 0.02,
            "turn_std_rad": 0.05,
            "odometry_turn_std_rad": 0.02,
            "gyro_bias_std_rad_s": 1e-4,
            "gyro_bias_walk_rad_s": 0.0,
        },
        "local_map": {"match_iterations_max": 30},
        "keyframe": {"distance_m": 0.3, "turn_rad": 0.3, "mask_teammates": False},
        "place_recognition": {"proximity_m": 2.0, "scan_similarity_min": 0.6},
        "verification": {"window_m": 0.8, "window_rad": 0.4, "overlap_min": 0.55, "backlog_per_step": 20},
        "pose_graph": {"period_steps": 5},
    },
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the table."""
    add_some(parser, "--runs", DRIVES, "drives")
    parser.add_argument("--frames", type=count, default=10_000, help="only the first frames of a drive (default: all)")


def rows(options: argparse.Namespace, runner: Runner) -> list[dict]:
    """One row per drive and method.

    {run, method, positions, error_mean_m, error_std_m, wall_iou, map_iou, coverage}.
    """
    runner.notes.append("settings were chosen on these drives: no drive was held out")
    return [row for result in _results(options, runner) for row in result["rows"]]


def _results(options: argparse.Namespace, runner: Runner) -> list[dict]:
    folder = data_folder() / "wifi" / "ble_lidar"
    return runner.each(options.runs, lambda run: evaluate_drive(folder, run, options.frames))


def evaluate_drive(folder: Path, run: str, count: int) -> dict:
    """The rows of one drive, and the poses (frames, 3) of each method on the plan."""
    drive = read_ble_drive(folder, run, BEAMS, RANGE_MAX_M)
    frames, tracked_m = drive.frames[:count], drive.tracked_m[:count]
    matched = scan_odometry(frames)
    paths = {"commands": _summed(frames), "scan odometry": _summed(matched)}
    for method, recogniser in RECOGNISERS.items():
        paths[method] = place_frames(CooperativeSlam(_config(recogniser), 1), [matched])[0]
    plan = flat(read_flat(folder), wall_db=12.0)
    aligned = {method: _on_plan(path, tracked_m) for method, path in paths.items()}
    scans = np.array([frame.ranges_m for frame in frames])
    table = [_row(run, method, path, Drive(frames, tracked_m), scans, plan) for method, path in aligned.items()]
    return {"rows": table, "paths": aligned}


def _config(recogniser: str) -> EnvConfig:
    slam = SETTINGS["slam"]
    place = slam["place_recognition"] | {"recogniser": recogniser}
    return from_dict(SETTINGS | {"slam": slam | {"place_recognition": place}})


def _summed(frames: list[SensorFrame]) -> Array:
    return poses_along(np.array([frame.odometry for frame in frames[1:]]).reshape(-1, 3))


def scan_odometry(frames: list[SensorFrame]) -> list[SensorFrame]:
    """The frames with the motion from matching each scan to the previous one, in a window around the command."""
    field = LineField(2 * (RANGE_MAX_M + 1.0), CELL_M, RANGE_MAX_M)
    out = frames[:1]
    for before, frame in itertools.pairwise(frames):
        field.reset(np.zeros(2))
        field.add(np.zeros((1, 3)), before.ranges_m[None])
        points = scan_points(frame.ranges_m, RANGE_MAX_M)
        told = float(np.hypot(*frame.odometry[:2])), abs(float(frame.odometry[2]))
        window = SEARCH[0] + SEARCH_SHARE[0] * told[0], SEARCH[1] + SEARCH_SHARE[1] * told[1]
        guess, _ = field.correlate(points, frame.odometry, window, SEARCH_STEP, stride=3)
        motion = field.refine(points, guess, REFINE_REACH_M, REFINE_ITERATIONS, DEGENERATE_SHARE).pose
        if field.share_near(points, motion, NEAR_WALL_M) < MET_MIN:
            motion = frame.odometry
        turn_rate_rad_s = float(motion[2] / (frame.time_s - before.time_s))
        out.append(dataclasses.replace(frame, odometry=motion, turn_rate_rad_s=turn_rate_rad_s))
    return out


def _on_plan(path: Array, tracked_m: Array) -> Array:
    """The path (frames, 3) aligned rigidly with the tracked positions."""
    known = np.isfinite(tracked_m[:, 0])
    return compose(metrics.align_team(path[known, :2], tracked_m[known]), path)


def _row(run: str, method: str, path: Array, drive: Drive, scans: Array, plan: Floorplan) -> dict:
    known = np.isfinite(drive.tracked_m[:, 0])
    error_m = np.linalg.norm(path[known, :2] - drive.tracked_m[known], axis=1)
    grid, cells = draw_map(path, scans), plan.cells(CELL_M)
    score = metrics.score_map(
        grid.log_odds, grid.origin_m, CELL_M, np.zeros(3), cells.free, cells.wall, cells.origin_m, CELL_M
    )
    return {
        "run": run,
        "method": method,
        "positions": int(known.sum()),
        "error_mean_m": float(error_m.mean()),
        "error_std_m": float(error_m.std()),
        "wall_iou": score.wall_iou,
        "map_iou": score.map_iou,
        "coverage": score.coverage_correct,
    }


def draw_map(path: Array, scans: Array) -> OccupancyGrid:
    """The map of scans (frames, beams) at poses (frames, 3)."""
    grid = OccupancyGrid(CELL_M, RANGE_MAX_M, BEAMS)
    grid.integrate(path, scans)
    return grid


def draw(options: argparse.Namespace, runner: Runner, folder: Path) -> list[Path]:
    """Draw the map and path of each method for each drive, with the outline of the flat."""
    data = data_folder() / "wifi" / "ble_lidar"
    ring = read_flat(data).outline_m
    written = []
    for run, result in zip(options.runs, _results(options, runner), strict=True):
        drive = read_ble_drive(data, run, BEAMS, RANGE_MAX_M)
        figure = new_figure((5 * len(result["paths"]), 6), dpi=80)
        for axes, (method, poses) in zip(
            figure.subplots(1, len(result["paths"])), result["paths"].items(), strict=True
        ):
            path = np.array(poses)
            scans = np.array([frame.ranges_m for frame in drive.frames[: len(path)]])
            draw_grid(axes, draw_map(path, scans))
            axes.plot(*np.append(ring, ring[:1], axis=0).T, color="tab:red", linewidth=1)
            axes.plot(*drive.tracked_m.T, color="tab:green", linewidth=0.8)
            axes.plot(*path[:, :2].T, color="tab:blue", linewidth=0.8)
            low, top = ring.min(axis=0) - 1, ring.max(axis=0) + 1
            axes.set(xlim=(low[0], top[0]), ylim=(low[1], top[1]), title=f"{run}: {method}", xlabel="x [m]")
        written.append(save_picture(figure, folder / f"ble-lidar-{run}", picture_options(options)))
    return written
