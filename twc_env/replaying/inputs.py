"""Logs of any kind as frames for the engine, with the settings that suit them."""

from __future__ import annotations

import dataclasses
import zipfile
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import count, zip_longest
from pathlib import Path

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.config import EnvConfig, from_dict, override
from twc_env.datasets.logs import frame_log, scan_log
from twc_env.datasets.logs.carmen_log import read_any_log
from twc_env.datasets.logs.column_units import Span
from twc_env.datasets.logs.file_kind import refuse_other_kinds
from twc_env.datasets.logs.odometry_restarts import rejoined, restarts_of
from twc_env.datasets.logs.readings_table import Readings, read_signs, read_wifi, wifi_scan
from twc_env.datasets.logs.scan_log import ScanLog
from twc_env.datasets.ros.bag_file import is_bag
from twc_env.datasets.ros.bag_log import describe, read_bag
from twc_env.datasets.ros.robot_topics import Wishes
from twc_env.datasets.sample import SAMPLE, sample_files
from twc_env.errors import ConfigError, DataError
from twc_env.records.geometry import between, compose, inverse
from twc_env.records.input_file import input_path
from twc_env.records.messages import Contacts, SensorFrame, SignReading, WifiScan

SIGNS_SETTINGS = {"slam.place_recognition.recogniser": "fused"}
"""Settings of laser logs that are accompanied by signs, ..."""
WIFI_SETTINGS = {"slam.place_recognition.recogniser": "wifi", "slam.merging.wifi_check": True}
"""... and by WiFi; `fused` looks at signs alone."""
GYRO_SETTINGS = {
    "slam.odometry_filter.turn_std_rad": 0.01,
    "slam.odometry_filter.gyro_bias_std_rad_s": 0.01,
    "slam.odometry_filter.gyro_bias_walk_rad_s": 1e-4,
}
"""Settings of laser logs with a gyro, whose turn is otherwise that of odometry."""
UNIX_TIME_MIN_S = 1e8
"""Logs that begin later tell unix time, of one clock for all: those that overlap were recorded together, and their
robots see each other, or should."""
STANDING_S = 1.0
"""With a gyro, scans that are used are at most this far apart, so that its bias is seen while the robot stands."""

TURNED_MIN_RAD, GYRO_TIMES = 3.0, (0.5, 2.0)
"""A gyro must turn between so many times as far as an odometry that turned so far in all."""

GAP_M = 5.0
"""Scans this far apart show hardly the same walls."""
STILL, LATER_SCANS = 0.05, 12
"""Odometry that stays within so many metres and radians stands still; so many scans are compared with the first."""
CHANGED_M, CHANGED_MIN = 0.5, 0.5
"""Half of a scan does not change by as much before a robot that stands, whoever walks by."""


@dataclass(slots=True)
class ReplayInput:
    """What a replay works on."""

    config: EnvConfig
    steps: Sequence[Sequence[SensorFrame]]
    """Frames of each step of the team."""
    contacts: list[Contacts]
    """Per step; empty: all robots are always in contact."""
    begun_s: Sequence[float]
    """Start time [s] of each robot's clock."""
    names: list[str]
    """Of the robots; "" if a log tells none."""
    mounts: Array
    """(robots, 3) pose of each robot's scanner, whose path the engine estimates, in the robot frame."""
    notes: list[str] = field(default_factory=list)
    """What was used, assumed or left out, one line each."""
    odometry: list[Array] | None = None
    """Per robot (frames, 3) poses of the robot by the log's odometry, in its own frame; None: the log has motions."""
    is_episode: bool = False
    """Whether it is a frame log, with the settings of its recording."""


@dataclass(frozen=True, slots=True)
class Asked:
    """What the user asks for, apart from the logs."""

    wishes: Wishes = dataclasses.field(default_factory=Wishes)
    wifi: Sequence[Path] = ()
    signs: Sequence[Path] = ()
    units: dict[str, str] = dataclasses.field(default_factory=dict)
    beam_count: int | None = None
    """Directions of laser logs; None: as many as their scanners have."""
    range_max_m: float | None = None
    """Up to where their returns are used; None: `scan_log.RANGE_MAX_M`."""


def is_frame_log(log: Path) -> bool:
    """Whether a file is a frame log: a zip archive of arrays, or anything named .npz."""
    if log.suffix == ".npz" or log.is_dir() or is_bag(log):
        return log.suffix == ".npz"
    if not zipfile.is_zipfile(log):
        return False
    with zipfile.ZipFile(log) as archive:
        return any(name.endswith(".npy") for name in archive.namelist())


def read_input(logs: Sequence[Path], asked: Asked) -> ReplayInput:
    """Read logs. Raises DataError for files of another kind, damaged ones, and readings that do not belong to them."""
    logs = [input_path(log) for log in logs]
    if is_frame_log(logs[0]):
        if asked.wifi or asked.signs:
            raise DataError(f"{logs[0]} holds its own WiFi and sign readings: leave out --wifi and --signs")
        config, steps = frame_log.read_frame_log(logs[0])
        robots = config.robots
        contacts = frame_log.read_contacts(logs[0])
        return ReplayInput(
            config, steps, contacts, [0.0] * robots, [""] * robots, np.zeros((robots, 3)), is_episode=True
        )
    if [str(log) for log in logs] == [SAMPLE] and not logs[0].exists():
        files = sample_files()
        logs = files.logs
        asked = dataclasses.replace(asked, wifi=asked.wifi or files.wifi, signs=asked.signs or files.signs)
    found = [robot for log in logs for robot in _read_log(log, asked.wishes)]
    return input_of([f[0] for f in found], [f[1] for f in found], asked, _told_apart([f[2] for f in found]))


def _told_apart(told: Sequence[tuple[str, list[str], bool]]) -> list[tuple[str, list[str], bool]]:
    """Name, notes and clock of each robot, with numbers behind names that several have, as the logs of two days do."""
    plain = [name.strip("/").replace("/", "_") or f"robot_{robot}" for robot, (name, _, _) in enumerate(told)]
    taken, apart = set(plain), []
    for own, (name, notes, is_shared) in zip(plain, told, strict=True):
        if plain.count(own) > 1:
            name = next(each for number in count(1) if (each := f"{own}_{number}") not in taken)
            taken.add(name)
            notes = [*notes, f"several robots are called {own}: this one is {name} from here on"]
        apart.append((name, notes, is_shared))
    return apart


def _read_log(path: Path, wishes: Wishes) -> list[tuple[ScanLog, Array, tuple[str, list[str], bool]]]:
    """Log, mount, and name, notes and whether its clock is shared with other logs, of each robot of a file."""
    if is_bag(path):
        robots = read_bag(path, wishes)
        return [(r.log, r.mount, (r.name, list(describe([r])), True)) for r in robots]
    refuse_other_kinds(path)
    return [(read_any_log(path), np.zeros(3), ("", [], False))]


def input_of(
    logs: Sequence[ScanLog],
    mounts: Sequence[Array],
    asked: Asked,
    told: Sequence[tuple[str, list[str], bool]] = (),
) -> ReplayInput:
    """Logs of one robot each as frames; told: name, notes and whether its clock is that of the others, of each."""
    told = told or [("", [], False)] * len(logs)
    names, notes = [name for name, _, _ in told], [note for _, own, _ in told for note in own]
    logs = [_in_one_piece(log, name, notes) for log, name in zip(logs, names, strict=True)]
    beams, range_max_m = asked.beam_count or scan_log.beam_count_of(logs), asked.range_max_m or scan_log.RANGE_MAX_M
    if range_max_m > scan_log.NO_RETURN_M:
        raise ConfigError(
            f"lidar.range_max_m={range_max_m:g}: in laser logs and bags {scan_log.NO_RETURN_M:g} m and more are no "
            f"return; use at most {scan_log.NO_RETURN_M:g}"
        )
    wifi, signs = (_readings(files, read, logs, names, asked, notes)
                   for files, read in ((asked.wifi, read_wifi), (asked.signs, read_signs)))  # fmt: skip
    paths, odometry, dropped = [], [], 0
    for robot, (log, mount) in enumerate(zip(logs, mounts, strict=True)):
        needed = [_nearest(log.times_s, each.times_s) for each in (*wifi[robot], *signs[robot])]
        if log.turned_rad is not None:
            needed.append(np.flatnonzero(np.diff(np.floor(log.times_s / STANDING_S), prepend=-1.0)))
        chosen = scan_log.spaced(log, np.concatenate(needed) if needed else ())
        dropped += len(log.times_s) - len(chosen)
        frames = scan_log.sensor_frames(log, beams, range_max_m, chosen, robot)
        paths.append(_with_readings(frames, log, chosen, mount, wifi[robot], signs[robot]))
        odometry.append(compose(log.poses[chosen], inverse(mount)))
    if dropped:
        notes.append(f"{sum(map(len, paths))} scans are used; {dropped} more, hardly apart from these, are not needed")
    lidar = scan_log.SETTINGS["lidar"] | {"beam_count": beams, "range_max_m": range_max_m}
    begun_s = [float(log.times_s[0]) for log in logs]
    share_clock = all(shared for _, _, shared in told) or min(begun_s) > UNIX_TIME_MIN_S
    steps, is_together = _steps(paths, begun_s, share_clock)
    config = from_dict(scan_log.SETTINGS | {"lidar": lidar, "robots": len(logs), "max_cycles": len(steps)})
    if any(wifi):
        config = override(config, WIFI_SETTINGS)
    if any(signs):
        config = override(config, SIGNS_SETTINGS)
    for log, name in zip(logs, names, strict=True):
        notes += filter(None, (_gap(log, name), _odd_odometry(log, name), _odd_gyro(log, name)))
    if all(log.turned_rad is not None for log in logs):
        config = override(config, GYRO_SETTINGS)
    if is_together and share_clock and len(logs) > 1:
        config = override(config, {"slam.keyframe.mask_teammates": True})
    if not is_together:
        config = override(config, {"slam.merging.mutual_observations_check": False})
        notes.append("the robots were recorded at different times: they are not looked for in each other's scans")
    return ReplayInput(config, steps, [], begun_s, names, np.array(mounts), notes, odometry)


def _in_one_piece(log: ScanLog, name: str, notes: list[str]) -> ScanLog:
    """The log, without the jumps of its odometry."""
    restarts = restarts_of(log)
    if not len(restarts):
        return log
    first, jump_m = restarts[0], np.hypot(*(log.poses[restarts[0]] - log.poses[restarts[0] - 1])[:2])
    times = f"{len(restarts)} times, first " if len(restarts) > 1 else ""
    notes.append(
        f"the odometry{f' of {name}' if name else ''} jumps {times}by {jump_m:.3g} m within "
        f"{log.times_s[first] - log.times_s[first - 1]:.3g} s, {log.times_s[first] - log.times_s[0]:.1f} s after the "
        "log begins: it is taken to begin anew there, and the robot to move as before"
    )
    return rejoined(log, restarts)


def _gap(log: ScanLog, name: str) -> str:
    """Where the robot moved furthest without a scan; "" if it always saw where it went."""
    moved_m = np.hypot(*np.diff(log.poses[:, :2], axis=0).T)
    gaps = int((moved_m > GAP_M).sum())
    if not gaps:
        return ""
    before = int(np.argmax(moved_m))
    begin_s, end_s = (float(time_s) for time_s in log.times_s[before : before + 2] - log.times_s[0])
    more = f", and more than {GAP_M:g} m {gaps - 1} more times" if gaps > 1 else ""
    return (
        f"{name or 'the robot'} moves {moved_m[before]:.1f} m by odometry without a scan, for {end_s - begin_s:.3g} s "
        f"from {begin_s:.1f} s after the log begins{more}: the map may bend there"
    )


def _odd_odometry(log: ScanLog, name: str) -> str:
    """What is odd about odometry that stands still while the scans show other places; "" if nothing is."""
    moved = np.abs(between(log.poses[0], log.poses)).max(axis=0)
    if moved.max() > STILL:
        return ""
    later = np.linspace(0, len(log.times_s) - 1, LATER_SCANS).astype(int)[1:]
    if np.median([_changed_share(log.ranges_m[0], log.ranges_m[k]) for k in later]) < CHANGED_MIN:
        return ""
    return (
        f"the odometry{f' of {name}' if name else ''} never moves, but the scans show other places: the map is that of "
        "a robot that stands still; look whether its poses were recorded"
    )


def _changed_share(first: Array, second: Array) -> float:
    """Share of the beams with a return in both scans (beams,) whose ranges differ by more than `CHANGED_M`."""
    told = (first > 0.0) & (first < scan_log.NO_RETURN_M) & (second > 0.0) & (second < scan_log.NO_RETURN_M)
    return float((np.abs(first - second)[told] > CHANGED_M).mean()) if told.any() else 0.0


def _odd_gyro(log: ScanLog, name: str) -> str:
    """What is odd about a gyro that does not turn about as far as the odometry; "" if nothing is."""
    if log.turned_rad is None:
        return ""
    turns, gyro = between(log.poses[:-1], log.poses[1:])[:, 2], np.diff(np.asarray(log.turned_rad, float))
    turns, gyro = turns[np.isfinite(gyro)], gyro[np.isfinite(gyro)]
    if np.abs(turns).sum() < TURNED_MIN_RAD:
        return ""
    times = float(turns @ gyro / (turns @ turns))
    if GYRO_TIMES[0] < times < GYRO_TIMES[1]:
        return ""
    return (
        f"the gyro{f' of {name}' if name else ''} turns {times:.1f} times as far as the odometry: it must be in "
        "radians per second, positive to the left; leave it out with --imu-topic none"
    )


def _steps(
    paths: Sequence[Sequence[SensorFrame]], begun_s: Sequence[float], share_clock: bool
) -> tuple[list[tuple[SensorFrame, ...]], bool]:
    """Frames of each step, and whether those of one step were taken together.

    Robots without a common clock all begin with the first step. With one, a step holds frames of about one time, unless
    the robots were out at different times.
    """
    ends_s = [b + p[-1].time_s for b, p in zip(begun_s, paths, strict=True)]
    if len(paths) == 1 or not share_clock or max(begun_s) >= min(ends_s):
        steps = [tuple(frame for frame in frames if frame is not None) for frames in zip_longest(*paths)]
        return steps, len(paths) == 1 or not share_clock
    waits = [np.median(np.diff([f.time_s for f in path])) for path in paths if len(path) > 1]
    apart_s = 0.5 * float(min(waits, default=0.0))
    merged = sorted(
        ((begun_s[f.robot] + f.time_s, f.robot, f) for path in paths for f in path), key=lambda row: row[:2]
    )
    steps, open_s = [], -np.inf
    for time_s, robot, frame in merged:
        if time_s - open_s > apart_s or any(other.robot == robot for other in steps[-1]):
            steps.append(())
            open_s = time_s
        steps[-1] = (*steps[-1], dataclasses.replace(frame, step=len(steps) - 1))
    return steps, True


def _readings(files, read, logs, names, asked: Asked, notes: list[str]) -> list[list[Readings]]:
    """Per robot, the readings of all tables."""
    begin_s, end_s = min(log.times_s[0] for log in logs), max(log.times_s[-1] for log in logs)
    found: list[list[Readings]] = [[] for _ in logs]
    for path in files:
        tables, remarks = read(path, Span(float(begin_s), float(end_s), tuple(names), asked.units))
        notes.extend(remarks)
        for own, table in zip(found, tables, strict=True):
            if len(table.times_s):
                own.append(table)
    return found


def _nearest(times_s: Array, wanted_s: Array) -> Array:
    if len(times_s) < 2:
        return np.zeros(len(wanted_s), int)
    after = np.clip(np.searchsorted(times_s, wanted_s), 1, len(times_s) - 1)
    return np.where(wanted_s - times_s[after - 1] < times_s[after] - wanted_s, after - 1, after)


def _with_readings(
    frames: list[SensorFrame], log: ScanLog, chosen: Array, mount: Array, wifi: Sequence[Readings],
    signs: Sequence[Readings],
) -> list[SensorFrame]:  # fmt: skip
    """The frames of one robot with the readings nearest to each; signs as they would be seen from the scan's pose."""
    scans: dict[int, list[WifiScan]] = {}
    for table in wifi:
        for k, scan in zip(_nearest(log.times_s[chosen], table.times_s).tolist(), table.values, strict=True):
            scans.setdefault(k, []).append(scan)
    read: dict[int, list[SignReading]] = {}
    for table in signs:
        at = np.stack([np.interp(table.times_s, log.times_s, column) for column in _unwrapped(log.poses).T], axis=1)
        nearest = _nearest(log.times_s[chosen], table.times_s)
        for k, pose, sign in zip(nearest.tolist(), at, table.values, strict=True):
            place = sign.range_m * np.cos(sign.bearing_rad), sign.range_m * np.sin(sign.bearing_rad), 0.0
            seen = compose(between(log.poses[chosen[k]], pose), compose(inverse(mount), np.array(place)))
            bearing = float(np.arctan2(seen[1], seen[0]))
            read.setdefault(k, []).append(SignReading(sign.text, bearing, float(np.hypot(seen[0], seen[1]))))
    out = list(frames)
    for k, heard in scans.items():
        macs, rssi_dbm = (np.concatenate([getattr(s, name) for s in heard]) for name in ("macs", "rssi_dbm"))
        out[k] = dataclasses.replace(out[k], wifi=wifi_scan(macs, rssi_dbm))
    for k, texts in read.items():
        out[k] = dataclasses.replace(out[k], signs=tuple(texts))
    return out


def _unwrapped(poses: Array) -> Array:
    return np.column_stack([poses[:, :2], np.unwrap(poses[:, 2])])
