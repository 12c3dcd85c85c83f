"""Logs as real robots would record them, of a simulated episode: scans, odometry, WiFi, signs; the truth apart."""

from __future__ import annotations

import csv
import gzip
import io
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.bench.rates import wander
from twc_env.config import EnvConfig
from twc_env.datasets.logs.carmen_writer import write_carmen_log
from twc_env.datasets.logs.scan_log import ScanLog
from twc_env.datasets.logs.tum import write_tum
from twc_env.datasets.ros.bag_writer import RobotRecording, write_recording
from twc_env.exploration.environment import ExplorationEnv
from twc_env.records.geometry import compose, poses_along
from twc_env.records.messages import SensorFrame
from twc_env.records.scanner import Scanner
from twc_env.records.whole_file import whole_file
from twc_env.running.terminal import show_count

BEGUN_S = 1_767_225_600.0
"""Unix time at which the episode begins: 2026-01-01, 00:00 UTC."""
SCAN_PERIOD_S, WIFI_PERIOD_S = 1.0, 1.0
"""A CARMEN log holds a laser scan of each robot in this interval, and the table of WiFi a scan."""


@dataclass(frozen=True, slots=True, eq=False)
class SimulatedLog:
    """What all robots of an episode have measured."""

    config: EnvConfig
    frames: tuple[list[SensorFrame], ...]
    """Per robot."""
    true_poses: Array
    """(steps + 1, robots, 3)."""

    def recordings(self, names: Sequence[str]) -> list[RobotRecording]:
        """What the drivers of the robots publish."""
        return [
            RobotRecording(
                name, self.times_s(robot), self.odometry(robot), [f.ranges_m for f in own], self.scanner(robot),
                np.array([f.turn_rate_rad_s for f in own]),
            )
            for robot, (name, own) in enumerate(zip(names, self.frames, strict=True))
        ]  # fmt: skip

    def times_s(self, robot: int) -> Array:
        """(frames,) unix time."""
        return np.array([BEGUN_S + frame.time_s for frame in self.frames[robot]])

    def odometry(self, robot: int) -> Array:
        """(frames, 3) poses by the robot's odometry, from its start."""
        return poses_along(np.array([frame.odometry for frame in self.frames[robot][1:]]))

    def scanner(self, robot: int) -> Scanner:
        """Its scanner; that of the default kind looks all around."""
        own = next((frame.scanner for frame in self.frames[robot] if frame.scanner is not None), None)
        lidar = self.config.lidar
        return own or Scanner(0.0, 2.0 * np.pi / lidar.beam_count, range_max_m=lidar.range_max_m)


def simulate(config: EnvConfig, seed: int) -> SimulatedLog:
    """Play an episode of robots that wander."""
    env = ExplorationEnv(config=config)
    env.reset(seed=seed)
    frames: tuple[list[SensorFrame], ...] = tuple([] for _ in range(config.robots))
    rounds = [list(env.frames)]
    for done, actions in enumerate(wander(env, seed), 1):
        env.step(actions)
        rounds.append(list(env.frames))
        show_count(done, config.max_cycles, " steps", every=50)
    for together in rounds:
        for frame in together:
            frames[frame.robot].append(frame)
    return SimulatedLog(config, frames, env.episode.record.true_poses[: len(rounds)].copy())


def write_bags(folder: Path, log: SimulatedLog, suffix: str) -> list[Path]:
    """One bag of all robots, by namespace; suffix: that of the kind of bag, "" for a folder of ROS 2."""
    path = folder / f"robots{suffix}"
    names = [f"robot_{robot}" for robot in range(len(log.frames))] if len(log.frames) > 1 else [""]
    write_recording(path, log.recordings(names))
    return [path, *_write_readings(folder, log)]


def write_carmen(folder: Path, log: SimulatedLog) -> list[Path]:
    """One CARMEN log of each robot, with a scan every second."""
    written = []
    for robot, own in enumerate(log.frames):
        times_s, odometry, scanner = log.times_s(robot), log.odometry(robot), log.scanner(robot)
        scans = [k for k, frame in enumerate(own) if len(frame.ranges_m)]
        kept = scans[:: max(1, round(SCAN_PERIOD_S / float(np.median(np.diff(times_s[scans])))))]
        angles = scanner.first_rad + scanner.step_rad * np.arange(len(own[kept[0]].ranges_m))
        poses = compose(odometry[kept], np.array(scanner.mount))
        lines = ScanLog(times_s[kept], poses, np.array([own[k].ranges_m for k in kept]), angles)
        path = folder / f"robot_{robot}.log.gz"
        write_carmen_log(path, lines, min(scanner.range_max_m, log.config.lidar.range_max_m))
        written.append(path)
    return [*written, *_write_readings(folder, log)]


def _write_readings(folder: Path, log: SimulatedLog) -> list[Path]:
    """WiFi and sign readings as tables, and the true paths, which no replay reads."""
    heard, read = [], []
    for robot, own in enumerate(log.frames):
        scanned_s = -np.inf
        for time_s, frame in zip(log.times_s(robot).tolist(), own, strict=True):
            if frame.wifi is not None and time_s - scanned_s >= WIFI_PERIOD_S - 1e-6:
                scanned_s = time_s
                for mac, level in zip(frame.wifi.macs.tolist(), frame.wifi.rssi_dbm.tolist(), strict=True):
                    heard.append((f"{time_s:.1f}", robot, _address(mac), f"{level:.1f}"))
            for sign in frame.signs:
                read.append((f"{time_s:.1f}", robot, sign.text, f"{sign.bearing_rad:.4f}", f"{sign.range_m:.3f}"))
    written = [folder / "wifi.csv.gz", folder / "signs.csv"]
    _write_csv(written[0], ("timestamp", "robot", "bssid", "rssi_dbm"), heard)
    _write_csv(written[1], ("timestamp", "robot", "text", "bearing_rad", "range_m"), read)
    for robot in range(len(log.frames)):
        written.append(folder / f"truth_{robot}.tum")
        write_tum(written[-1], log.times_s(robot), log.true_poses[: len(log.frames[robot]), robot])
    return written


def _address(mac: int) -> str:
    digits = f"{mac:012x}"
    return ":".join(digits[k : k + 2] for k in range(0, len(digits), 2))


def _write_csv(path: Path, header: Sequence[str], rows: Sequence[Sequence]) -> None:
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows([header, *rows])
    raw = text.getvalue().encode()
    with whole_file(path) as beside:
        beside.write_bytes(gzip.compress(raw, mtime=0) if path.suffix == ".gz" else raw)
