"""CARMEN logs read: lines FLASER, ROBOTLASER1, or RAWLASER1 with ODOM; and laser logs of either format."""

from __future__ import annotations

import logging
import math
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.datasets.logs.scan_log import (
    SAME_DIRECTION_RAD,
    ScanLog,
    half_circle,
    in_metres,
    log_of,
    name_half_circle,
    read_scan_log,
    short_reason,
)
from twc_env.datasets.logs.text_file import TextLines, first_bytes, text_encoding
from twc_env.errors import DataError
from twc_env.records.geometry import compose

_PADDED_MAX, _PADDED_FREE = 4, 1_000_000
"""Scans of fewer beams are filled up to as many as the others have, to so many times what they tell; few always."""
_HEAD = 4096
"""Bytes that tell JSON from CARMEN."""
_LOG = logging.getLogger(__name__)


def read_carmen_log(path: str | Path) -> ScanLog:
    """Read the scans of a CARMEN log in the order of their times, all of the kind of the first.

    The lines `FLASER n r1 .. rn x y theta ...` or, in newer ones, `ROBOTLASER1` are read, with the pose of the laser,
    or else `RAWLASER1` with the poses of `ODOM` lines. Raises DataError for anything without such scans.
    """
    kind, scans, params, odometry = "", [], {}, []
    others: Counter[str] = Counter()
    lines = TextLines(path, errors="replace")
    known = _READERS if any(line.startswith(_WITH_POSES) for line in lines) else _READERS | {"RAWLASER1": _raw_laser}
    for k, line in enumerate(lines, 1):
        words = line.split()
        if words and words[0] in _LASERS:
            others[words[0]] += 1
        if len(words) > 2 and words[0] == "PARAM":
            params[words[1]] = words[2]
        if len(words) > 7 and words[0] == "ODOM" and kind not in _READERS:
            odometry.append((k, words))
        if not words or words[0] not in ((kind,) if kind else known):
            continue
        kind = words[0]
        try:
            scans.append(known[kind](words[1:]))
            beams, before = (len(scan.ranges_m) for scan in (scans[-1], scans[0]))
            if beams != before and scans[-1].directions is None:
                raise ValueError(f"{beams} beams, where those before have {before}")
            if not all(map(math.isfinite, (*scans[-1].pose, scans[-1].time_s))):
                raise ValueError("its pose or its time is not finite")
        except (ValueError, IndexError) as error:
            reason = "it is cut off" if isinstance(error, IndexError) else short_reason(error)
            raise DataError(f"{path}, line {k} is not a scan: {reason}; fix or delete it") from error
    del others[kind]
    if others:
        told = ", ".join(f"{count} {name}" for name, count in others.items())
        _LOG.warning("%s: lines of other lasers left out, since %s come first: %s", path, kind, told)
    if not scans:
        raise DataError(
            f"{path} is not a CARMEN log: expected lines {', '.join(_READERS)}, or RAWLASER1 with ODOM; of "
            "other formats `write_frame_log` makes a log in a dozen lines (docs/library.md)"
        )
    scans = _by_time(scans, path)
    if kind == "RAWLASER1":
        scans = _with_odometry(scans, odometry, params, path)
    poses, times_s = np.array([scan.pose for scan in scans]), np.array([scan.time_s for scan in scans])
    try:
        log = log_of(times_s, poses, *_beams(scans, params, path))
    except ValueError as error:
        raise DataError(f"{path} is not a CARMEN log: {short_reason(error)}; record it again") from error
    return in_metres(log, path)


def read_any_log(path: str | Path) -> ScanLog:
    """Read a log of either format, JSON if it begins like that. Raises the same errors."""
    head, _ = first_bytes(path, _HEAD)
    begins = head.decode(text_encoding(head), "replace").lstrip("\ufeff\n\r\t ")[:1]
    return read_scan_log(path) if begins == "{" else read_carmen_log(path)


def _by_time(scans: list[_Scan], path: str | Path) -> list[_Scan]:
    """Scans in order of time; those without times (0) in the order of their lines."""
    times_s = [scan.time_s for scan in scans]
    order = sorted(range(len(scans)), key=times_s.__getitem__)
    if min(times_s) <= 0.0 or order == list(range(len(scans))):
        return scans
    moved = sum(k != at for k, at in enumerate(order))
    _LOG.warning("%s: time goes back; %d of %d scans are put in order of time", path, moved, len(scans))
    return [scans[k] for k in order]


def _beams(scans: list[_Scan], params: dict[str, str], path: str | Path) -> tuple[Array, Array]:
    """Ranges (scans, beams) and directions (beams,), or (scans, beams) where those of the scans differ."""
    counts = [len(scan.ranges_m) for scan in scans]
    count = max(counts)
    told = scans[0].directions
    if count * len(scans) > max(_PADDED_MAX * sum(counts), _PADDED_FREE):
        raise ValueError(f"scans of {min(counts)} to {count} beams, mostly of few: they are of different scanners")
    if told is None:
        return np.array([scan.ranges_m for scan in scans], float), _flaser_directions(count, params, path)
    ranges_m = np.full((len(scans), count), np.inf)
    directions = np.zeros((len(scans), count))
    for k, scan in enumerate(scans):
        beams = len(scan.ranges_m)
        first_rad, step_rad = scan.directions or told
        ranges_m[k, :beams] = scan.ranges_m
        directions[k] = first_rad + step_rad * np.arange(count)
    is_same = np.abs(directions - directions[0]).max() <= SAME_DIRECTION_RAD
    return ranges_m, directions[0] if is_same else directions


def _flaser_directions(beams: int, params: dict[str, str], path: str | Path) -> Array:
    """(beams,) as the field of view and the resolution of the log's PARAM lines say, else a half circle."""
    try:
        fov_deg = float(params["laser_front_laser_fov"])
        fov_deg = fov_deg if fov_deg > 2 * math.pi else math.degrees(fov_deg)
        step_deg = float(params.get("laser_front_laser_resolution", fov_deg / max(beams - beams % 2, 1)))
    except (KeyError, ValueError):
        fov_deg = step_deg = 0.0
    if fov_deg and abs(fov_deg - 180.0) > 1.0 and 0.0 <= fov_deg - (beams - 1) * step_deg <= 1.5 * step_deg:
        return np.deg2rad(np.arange(beams) * step_deg - fov_deg / 2)
    name_half_circle(beams, "FLASER line", path)
    return half_circle(beams)


class _Scan(NamedTuple):
    ranges_m: list[float]
    pose: list[float]
    time_s: float
    directions: tuple[float, float] | None = None
    """Direction of the first beam and angle between beams [rad]; None: the half circle ahead."""


def _flaser(words: Sequence[str]) -> _Scan:
    """n r1 .. rn, pose of the laser, pose of odometry, time; IndexError if it is incomplete."""
    count, values = int(words[0]), words[1:]
    _check_count(count)
    numbers = [float(v) for v in values[: count + 3]]
    return _Scan(numbers[:count], numbers[count:], float(values[count + 6]))


def _robot_laser(words: Sequence[str]) -> _Scan:
    """type, first direction, field of view, resolution, range, accuracy, mode, n r1 .. rn, m remissions (old logs have
    no m), pose of the laser, that of the robot, two speeds, two distances, turn axis (old logs have none), time, host,
    time. IndexError if it is incomplete."""
    first_rad, resolution_rad, range_max_m, count = float(words[1]), float(words[3]), float(words[4]), int(words[7])
    _check_count(count)
    rest = words[8 + count : -3]
    if len(rest) != 10:
        rest = rest[1 + int(rest[0]) :]
        if len(rest) != 11:
            raise IndexError
    ranges_m = [float(word) for word in words[8 : 8 + count]]
    told_m = [range_m if range_m < range_max_m else math.inf for range_m in ranges_m]
    return _Scan(told_m, [float(word) for word in rest[:3]], float(words[-3]), (first_rad, resolution_rad))


def _raw_laser(words: Sequence[str]) -> _Scan:
    """As a ROBOTLASER1 line up to the remissions, then time, host, time; without a pose."""
    first_rad, resolution_rad, range_max_m, count = float(words[1]), float(words[3]), float(words[4]), int(words[7])
    _check_count(count)
    ranges_m = [float(word) for word in words[8 : 8 + count]]
    remissions = int(words[8 + count])
    told_m = [range_m if range_m < range_max_m else math.inf for range_m in ranges_m]
    return _Scan(told_m, [0.0, 0.0, 0.0], float(words[9 + count + remissions]), (first_rad, resolution_rad))


def _with_odometry(
    scans: list[_Scan], lines: Sequence[tuple[int, list[str]]], params: dict[str, str], path: str | Path
) -> list[_Scan]:
    """The scans within the time of the lines `ODOM x y theta v w a time ...`, with interpolated poses of the laser."""
    try:
        rows = np.array([[float(word) for word in (words[7], *words[1:4])] for _, words in lines])
        ahead_m = float(params.get("robot_frontlaser_offset", "0"))
    except ValueError as error:
        raise DataError(
            f"{path}: a line ODOM or PARAM is no number: {short_reason(error)}; fix or delete it"
        ) from error
    if not len(rows) or not np.isfinite(rows).all():
        raise DataError(
            f"{path} has RAWLASER1 lines but no ODOM lines that are finite: odometry is needed; record both"
        )
    rows = rows[np.argsort(rows[:, 0], kind="stable")]
    inside = [scan for scan in scans if rows[0, 0] <= scan.time_s <= rows[-1, 0]]
    if inside and len(inside) < len(scans):
        _LOG.warning(
            "%s: %d of %d RAWLASER1 lines left out: they are before or after all ODOM lines",
            path, len(scans) - len(inside), len(scans),
        )  # fmt: skip
    if not inside:
        raise DataError(f"{path}: no RAWLASER1 line is within the time of the ODOM lines; record both together")
    columns = rows[:, 1], rows[:, 2], np.unwrap(rows[:, 3])
    times_s = [scan.time_s for scan in inside]
    poses = np.stack([np.interp(times_s, rows[:, 0], column) for column in columns], axis=1)
    lasers = compose(poses, np.array([ahead_m, 0.0, 0.0])).tolist()
    return [scan._replace(pose=pose) for scan, pose in zip(inside, lasers, strict=True)]


_READERS = {"FLASER": _flaser, "ROBOTLASER1": _robot_laser}
_LASERS = {f"{name}{k}" for name in ("ROBOTLASER", "RAWLASER") for k in range(1, 6)} | {"FLASER", "RLASER", "LLASER"}
_WITH_POSES = tuple(f"{kind} " for kind in _READERS)


def _check_count(count: int) -> None:
    if count < 1:
        raise ValueError(f"a scan of {count} beams")
