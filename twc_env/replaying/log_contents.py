"""What a log holds that is no bag: its robots, their scans, the time they span and their odometry."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.datasets.logs.carmen_log import read_any_log
from twc_env.datasets.logs.file_kind import refuse_other_kinds
from twc_env.datasets.logs.frame_log import read_frame_log
from twc_env.datasets.sample import SAMPLE, sample_files
from twc_env.records.messages import SensorFrame
from twc_env.replaying.inputs import is_frame_log


def list_robots(log: Path) -> list[dict[str, Any]]:
    """One row for each robot of a laser log, a frame log, a run folder or the sample. Raises DataError for others."""
    log = log / "frames.npz" if log.is_dir() else log
    if is_frame_log(log):
        config, steps = read_frame_log(log)
        frames = [frame for step in steps for frame in step]
        return [_of_frames(robot, [f for f in frames if f.robot == robot]) for robot in range(config.robots)]
    is_sample = str(log) == SAMPLE and not log.exists()
    return [_of_laser_log(robot, path) for robot, path in enumerate(sample_files().logs if is_sample else (log,))]


def _of_laser_log(robot: int, path: Path) -> dict[str, Any]:
    refuse_other_kinds(path)
    log = read_any_log(path)
    return _row(robot, log.times_s, log.ranges_m.shape[1], np.diff(log.poses[:, :2], axis=0))


def _of_frames(robot: int, frames: Sequence[SensorFrame]) -> dict[str, Any]:
    motions_m = np.array([frame.odometry[:2] for frame in frames]).reshape(-1, 2)
    row = _row(
        robot, np.array([f.time_s for f in frames]), max((len(f.ranges_m) for f in frames), default=0), motions_m
    )
    return row | {
        "WiFi scans": sum(frame.wifi is not None for frame in frames),
        "signs read": sum(len(frame.signs) for frame in frames),
    }


def _row(robot: int, times_s: Array, beams: int, motions_m: Array) -> dict[str, Any]:
    """Scans at times (k,) and motions (m, 2) by odometry."""
    span_s = float(np.ptp(times_s)) if len(times_s) else 0.0
    return {
        "robot": robot,
        "scans": len(times_s),
        "beams": beams,
        "begin [s]": round(float(times_s[0]), 3) if len(times_s) else None,
        "span [s]": round(span_s, 3),
        "rate [Hz]": round((len(times_s) - 1) / span_s, 2) if span_s > 0.0 else None,
        "odometry [m]": round(float(np.hypot(*motions_m.T).sum()), 2),
    }
