"""The drives of the flat as sensor frames: laser scans, open-loop odometry from the commands, and BLE strengths.

Files as described in `ble_flat`; a scan is a line of unix seconds, then [angles, millidegrees] and [ranges, cm],
wrapped over lines; commands are lines `unix_s,command,speed`.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.datasets.logs.scan_log import onto_circle
from twc_env.datasets.logs.text_file import read_text
from twc_env.datasets.surveys.ble_flat import ANCHORS, POSE_LAYOUT_RUN
from twc_env.datasets.surveys.fingerprints import NUMBER_MAX, numbered_words, numbers, read_numbers
from twc_env.errors import DataError
from twc_env.records.geometry import between, compose, transform_points
from twc_env.records.messages import SensorFrame, WifiScan

SPEED_M_S = 0.28 / 0.15
"""Metres per second for each unit of commanded speed."""
TURN_RAD_S = {"left": np.pi / 2 / 1.2 / 0.15, "right": -np.pi / 2 / 1.1 / 0.15}
SCAN_S = 0.52
"""Duration of one scanner revolution, which ends at the time of the scan; scans while the robot turns are left out."""
RANGE_MIN_M, RANGE_RELIABLE_M = 0.2, 15.0
DRIVES = ("calib3", "calib4")


@dataclass(frozen=True, slots=True, eq=False)
class Drive:
    """Measurements of the robot, and the tracked positions of its tag."""

    frames: list[SensorFrame]
    tracked_m: Array
    """(frames, 2) in the frame of the wall plan; NaN while the tag was not tracked."""


def read_ble_drive(folder: str | Path, run: str, beam_count: int, range_max_m: float) -> Drive:
    """One drive, "calib3" or "calib4", one frame per scan. Raises DataError for missing or invalid files."""
    if run not in DRIVES:
        raise DataError(f"the flat has no drive {run!r}; known are {', '.join(DRIVES)}")
    folder = Path(folder)
    ends_s, angles_rad, ranges_m = _scans(folder / f"{run}_scan.txt.gz")
    times_s = ends_s - 0.5 * SCAN_S
    path, is_turning = _commanded(folder / f"{run}_motion.txt.gz", times_s)
    columns = ("ts", "x", "y", *(f"rssi_{a}" for a in ANCHORS[run]))
    table = read_numbers(folder / f"{run}_df.csv.gz", columns, filled=3)
    tracked_s, rssi_dbm = table[:, 0] * 1e-9, table[:, 3:]
    positions = transform_points(POSE_LAYOUT_RUN[run], table[:, 1:3])
    frames: list[SensorFrame] = []
    last, tracked = 0, []
    for k in np.flatnonzero(~is_turning).tolist():
        last = k if not frames else last
        odometry = between(path[last], path[k])
        elapsed_s = float(times_s[k] - times_s[last])
        frames.append(
            SensorFrame(
                robot=0,
                step=len(frames),
                time_s=float(times_s[k] - times_s[0]),
                odometry=odometry,
                turn_rate_rad_s=float(odometry[2] / elapsed_s) if elapsed_s > 0 else 0.0,
                ranges_m=onto_circle(ranges_m[k], angles_rad[k], beam_count, range_max_m),
                wifi=_heard(rssi_dbm[(tracked_s > times_s[last]) & (tracked_s <= times_s[k])]),
            )
        )
        tracked.append([np.interp(times_s[k], tracked_s, positions[:, axis], np.nan, np.nan) for axis in (0, 1)])
        last = k
    return Drive(frames, np.array(tracked).reshape(-1, 2))


def _heard(rssi_dbm: Array) -> WifiScan | None:
    """The mean of the readings (rows, anchors) since the last frame; None without any."""
    heard = np.isfinite(rssi_dbm).any(axis=0) if len(rssi_dbm) else np.zeros(0, bool)
    if not heard.any():
        return None
    return WifiScan(np.flatnonzero(heard).astype(np.int64) + 1, np.nanmean(rssi_dbm[:, heard], axis=0))


def _scans(path: Path) -> tuple[Array, list[Array], list[Array]]:
    """Times (scans,), and angles [rad] and ranges [m] of each scan; ranges too near or too far are 0 (no
    information)."""
    times, lines, blocks = [], [], []
    parts = _parts(path)
    for (line, time), (first, angles), (second, ranges) in zip(parts[::3], parts[1::3], parts[2::3], strict=True):
        times.append(float(time))
        lines.append(line)
        blocks.append((_block(angles, f"{path}, line {first}"), _block(ranges, f"{path}, line {second}")))
        if len(blocks[-1][0]) != len(blocks[-1][1]):
            counts = f"{len(blocks[-1][1])} ranges, where line {first} has {len(blocks[-1][0])} angles"
            raise DataError(f"{path}, line {second}: {counts}; {_REMEDY}")
    if not times:
        raise DataError(f"{path} holds no scans: expected a time, angles and ranges for each; {_REMEDY}")
    _check_order(times, lines, path)
    kept = [np.where((r > 100 * RANGE_MIN_M) & (r < 100 * RANGE_RELIABLE_M), 0.01 * r, 0.0) for _, r in blocks]
    return np.array(times), [np.deg2rad(0.001 * a) for a, _ in blocks], kept


def _parts(path: Path) -> list[tuple[int, str]]:
    """Times and contents of brackets of a scan file with the lines on which they begin: a time, angles, ranges, ...

    Raises DataError for anything else, and for a file that ends within a scan.
    """
    text = read_text(path)
    found: list[tuple[int, str]] = []
    line, end = 1, 0
    for match in _PART.finditer(text):
        line += text.count("\n", end, match.start())
        end = match.start()
        expected = _CYCLE[len(found) % 3]
        if match.lastgroup != ("time" if expected == _CYCLE[0] else "block"):
            raise DataError(f"{path}, line {line}: expected {expected}; got {match[0].split()[0][:40]!r}; {_REMEDY}")
        found.append((line, match[match.lastgroup]))
    if len(found) % 3:
        last = text.count("\n", 0, len(text.rstrip())) + 1
        raise DataError(f"{path}, line {last}: the file ends where {_CYCLE[len(found) % 3]} should follow; {_REMEDY}")
    return found


_PART = re.compile(r"^(?P<time>\d+(?:\.\d*)?)[ \t\r]*$|\[(?P<block>[^\[\]]*)\]|\S+", re.MULTILINE)
_CYCLE = ("a time in unix seconds", "angles in brackets", "ranges in brackets")
_REMEDY = "fetch the file again"


def _block(text: str, where: str) -> Array:
    """The numbers in a pair of brackets that opens at this line."""
    try:
        values = np.array(text.split(), float)
    except ValueError as error:
        raise DataError(f"{where}: {error}; expected numbers in brackets") from error
    if not (np.abs(values) < NUMBER_MAX).all():
        raise DataError(f"{where}: expected finite numbers in brackets; {_REMEDY}")
    return values


def _check_order(times_s: Sequence[float], lines: Sequence[int], path: Path) -> None:
    """Raise DataError if times go back."""
    back = np.flatnonzero(np.diff(times_s) < 0)
    if len(back):
        k = back[0] + 1
        raise DataError(f"{path}, line {lines[k]}: time {times_s[k]:.3f} follows {times_s[k - 1]:.3f}; {_REMEDY}")


def _commanded(path: Path, times_s: Array) -> tuple[Array, Array]:
    """Poses (k, 3) according to the commands, in the middle of each scan, and whether the robot turned during it."""
    rows, lines = numbered_words(path)
    for k, words in zip(lines, rows, strict=True):
        if len(words) < 3:
            raise DataError(f"{path}, line {k}: expected unix_s,command,speed; got {','.join(words)[:40]!r}")
    starts, speed = numbers([[words[0], words[2]] for words in rows], lines, path).T
    _check_order(starts.tolist(), lines, path)
    ahead = np.array([{"forward": 1.0, "reverse": -1.0}.get(words[1], 0.0) for words in rows]) * speed * SPEED_M_S
    turn = np.array([TURN_RAD_S.get(words[1], 0.0) for words in rows]) * speed
    at_start = np.zeros((len(starts), 3))
    for k in range(1, len(starts)):
        at_start[k] = compose(at_start[k - 1], _moved(ahead[k - 1], turn[k - 1], starts[k] - starts[k - 1]))
    now = np.searchsorted(starts, times_s, side="right") - 1
    poses = np.zeros((len(times_s), 3))
    for i in np.flatnonzero(now >= 0):
        k = now[i]
        poses[i] = compose(at_start[k], _moved(ahead[k], turn[k], times_s[i] - starts[k]))
    ends = np.append(starts[1:], np.inf)
    turns = turn != 0.0
    is_turning = [bool((turns & (starts < t + 0.5 * SCAN_S) & (ends > t - 0.5 * SCAN_S)).any()) for t in times_s]
    return poses, np.array(is_turning)


def _moved(ahead_m_s: float, turn_rad_s: float, time_s: float) -> Array:
    """Motion at constant speeds; the robot never drives and turns simultaneously."""
    return np.array([ahead_m_s * time_s, 0.0, turn_rad_s * time_s])
