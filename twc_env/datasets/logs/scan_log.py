"""Logs of one robot's laser scans with poses, and hand-verified relations between them (Freiburg SLAM benchmark).

A log is JSON {"map": {"<unix seconds>": {"range": [metres], "x": m, "y": m, "theta": rad}}} or a text of CARMEN
(`carmen_log`); relations are text lines `t1 t2 dx dy dz roll pitch yaw`: the pose at t2 in the frame of the pose at t1.
All may be gzipped. `sensor_frames` converts a log to frames for the engine.
"""

from __future__ import annotations

import dataclasses
import json
import logging
import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.datasets.logs.odd_units import name_odd_units
from twc_env.datasets.logs.text_file import TextLines, read_text
from twc_env.errors import UNFIT, DataError
from twc_env.records.geometry import between, wrap_angle, wrap_one
from twc_env.records.json_values import check_lists
from twc_env.records.messages import UNSEEN_M, SensorFrame
from twc_env.records.scanner import Scanner

NO_RETURN_M = 30.0
"""Scanners of these logs report more than this (81.83 m, 50 m, 32.7 m) for a beam without return."""
NEAR_M = 0.05
"""No scanner sees most things nearer than this."""
TIME_BETWEEN_MIN_S = 1e-3
"""Minimum time between scans: some logs round times, so that scans seem simultaneous."""

SAME_DIRECTION_RAD = 1e-3
"""Directions of the beams of two scans that differ by less are the same."""
_HALF_CIRCLES = (180, 360, 720)
"""Beams of a half circle, but for one at its end."""
_RETURNS_MIN = 0.1
"""Share of beams with a return, below which ranges cannot be metres."""
_LOG = logging.getLogger(__name__)

_SINGLE_DIGITS = 5
DENSE_M, DENSE_RAD = 0.25, 0.25
"""A log is dense if the robot moves and turns by less than this from scan to scan, in the median."""
SPACING_M, SPACING_RAD = 0.1, 0.1
"""Of a dense log, only scans so far from the last one are used."""
TIME_TOLERANCE_S = 0.02
"""Largest difference between the time of a relation and that of its scan."""

BEAMS, RANGE_MAX_M = 360, 20.0
_BEAMS_MIN = 8
_COARSE = 1.2
"""Scanners whose beams are further apart than so many directions are given fewer directions."""
SETTINGS: dict = {
    "lidar": {"beam_count": BEAMS, "range_max_m": RANGE_MAX_M},
    "slam": {
        # One scan every half metre: odometry errors of a step are large, and its turn replaces the gyro.
        "odometry_filter": {
            "position_std_per_m": 0.1,
            "position_std_m": 0.02,
            "turn_std_rad": 0.1,
            "odometry_turn_std_rad": 0.02,
            "gyro_bias_std_rad_s": 1e-4,
            "gyro_bias_walk_rad_s": 0.0,
        },
        "local_map": {"size_m": 60.0, "memory_m": 40.0, "match_iterations_max": 30},
        # Every scan is a keyframe; there are no teammates in the scans.
        "keyframe": {"distance_m": 0.05, "turn_rad": 0.05, "mask_teammates": False},
        "place_recognition": {"recogniser": "lidar", "proximity_m": 4.0, "scan_similarity_min": 0.6},
        # Drift over long loops: a wider search. Steps are far apart in time, so the backlog is verified at once.
        "verification": {"window_m": 1.5, "window_rad": 0.3, "backlog_per_step": 20},
        "pose_graph": {"period_steps": 5},
        # Without signs and radio more closures must agree, at any distance.
        "merging": {"wifi_check": False, "spread_min_m": 0.0, "closures_min": 5},
    },
}
"""Settings of the engine for logs of laser and odometry only, with a scan every half metre."""


@dataclass(frozen=True, slots=True, eq=False)
class ScanLog:
    """Scans in the order they were taken."""

    times_s: Array
    """(scans,) unix time, ascending."""
    poses: Array
    """(scans, 3) x, y [m] and heading [rad] that the log holds: raw odometry or corrected."""
    ranges_m: Array
    """(scans, beams)."""
    beam_angles_rad: Array
    """(beams,) direction of each beam in the robot frame, counter-clockwise; (scans, beams) if it changes."""
    sweep_s: float = 0.0
    """Time from the first beam to the last, which is measured at the time of the scan; 0: all at once."""
    turned_rad: Array | None = None
    """(scans,) heading by a gyro, not wrapped; None: the log has none."""

    def at(self, scans: Array | slice) -> ScanLog:
        """The log with these scans alone."""
        told: dict[str, Any] = {"times_s": self.times_s, "poses": self.poses, "ranges_m": self.ranges_m}
        if self.beam_angles_rad.ndim == 2:
            told["beam_angles_rad"] = self.beam_angles_rad
        if self.turned_rad is not None:
            told["turned_rad"] = self.turned_rad
        return dataclasses.replace(self, **{name: values[scans] for name, values in told.items()})

    def ranges_of(self, scan: int) -> Array:
        """(beams,) float64; single precision stands for hundredths of a millimetre."""
        ranges_m = self.ranges_m[scan]
        return np.round(ranges_m.astype(float), _SINGLE_DIGITS) if ranges_m.dtype == np.float32 else ranges_m

    def beams_of(self, scan: int) -> Array:
        """(beams,) direction of each beam of a scan."""
        return self.beam_angles_rad[scan] if self.beam_angles_rad.ndim == 2 else self.beam_angles_rad


@dataclass(frozen=True, slots=True, eq=False)
class Relations:
    """Measured poses between pairs of scans."""

    first: Array
    """(relations,) scan numbers."""
    second: Array
    """(relations,) scan numbers, of other scans."""
    pose_first_second: Array
    """(relations, 3)."""
    away_s: Array
    """(relations,) difference between the time stamps of relation and scan, maximum of both ends."""

    def errors(self, poses: Array) -> tuple[Array, Array]:
        """Translation [m] and rotation [deg] error (relations,) of poses (scans, 3)."""
        error = between(poses[self.first], poses[self.second]) - self.pose_first_second
        return np.hypot(error[:, 0], error[:, 1]), np.degrees(np.abs(wrap_angle(error[:, 2])))


def read_scan_log(path: str | Path) -> ScanLog:
    """Read a JSON log. Raises DataError for files that are missing, truncated or of another format."""
    text = read_text(path)
    try:
        check_lists(text)
        scans = json.loads(text)["map"]
        times = sorted(scans, key=float)
        _check_equal_counts(times, [scans[t]["range"] for t in times])
        ranges_m = np.array([scans[t]["range"] for t in times], float)
        poses = [[scans[t][key] for key in ("x", "y", "theta")] for t in times]
        log = log_of(np.array(times, float), np.array(poses, float), ranges_m)
    except (KeyError, AttributeError, *UNFIT) as error:
        raise DataError(
            f"{path} is not a scan log: {short_reason(error)}; expected map -> time -> range, x, y, theta"
        ) from error
    name_half_circle(log.ranges_m.shape[1], "scan", path)
    return in_metres(log, path)


def _check_equal_counts(times: Sequence[str], scans: Sequence[Sequence[float]]) -> None:
    for time_s, ranges in zip(times, scans, strict=True):
        if len(ranges) != len(scans[0]):
            raise ValueError(f"the scan at {time_s} has {len(ranges)} beams, where the first has {len(scans[0])}")


def name_half_circle(beams: int, of: str, path: str | Path) -> None:
    """Warn that beams without a direction are taken for a half circle, unless their number says so."""
    if beams - beams % 2 not in _HALF_CIRCLES:
        _LOG.warning(
            "%s: the %d beams of a %s are taken for a half circle; if they are not, tell in a CARMEN log in lines "
            "'PARAM laser_front_laser_fov 270' and 'PARAM laser_front_laser_resolution 1.0' [degrees]",
            path, beams, of,
        )  # fmt: skip


def in_metres(log: ScanLog, path: str | Path) -> ScanLog:
    """The log; raises DataError if hardly a beam has a return, as where ranges are millimetres. Warns of ranges, poses
    and times that are hardly metres, radians and seconds."""
    is_told = (log.ranges_m > 0.0) & np.isfinite(log.ranges_m)
    returns = int((is_told & (log.ranges_m < NO_RETURN_M)).sum())
    far_m = float(np.median(log.ranges_m[is_told])) if is_told.any() else 0.0
    if far_m > NO_RETURN_M and returns < _RETURNS_MIN * is_told.sum():
        raise DataError(
            f"{path}: {returns} of {int(is_told.sum())} beams have a return below {NO_RETURN_M:g} m, and half of them "
            f"are above {far_m:g}; ranges must be metres: divide millimetres by 1000, centimetres by 100"
        )
    if not returns:
        raise DataError(
            f"{path}: no beam has a return, of {log.ranges_m.size}; ranges must be metres above 0: record the log again"
        )
    near_m = float(np.median(log.ranges_m[is_told & (log.ranges_m < NO_RETURN_M)]))
    if near_m < NEAR_M:
        _LOG.warning(
            "%s: half of all returns are nearer than %.3g m; ranges must be metres: multiply kilometres by 1000, and "
            "look what hides the scanner", path, near_m,
        )  # fmt: skip
    name_odd_units(log.times_s, log.poses, path)
    return log


def log_of(times_s: Array, poses: Array, ranges_m: Array, angles_rad: Array | None = None) -> ScanLog:
    """A log of scans (scans, beams) at angles_rad, by default the half circle. Raises ValueError for scans of different
    lengths, and for times and poses that are not finite."""
    if ranges_m.ndim != 2 or not np.isfinite(times_s).all() or not np.isfinite(poses).all():
        raise ValueError("no scans of one length, each with a finite time and pose")
    return ScanLog(times_s, poses, ranges_m, half_circle(ranges_m.shape[1]) if angles_rad is None else angles_rad)


def half_circle(beams: int) -> Array:
    """(beams,) directions counter-clockwise from the right to the left; the last one may be exactly left."""
    return np.deg2rad(np.arange(beams) * (180.0 / max(beams - beams % 2, 1)) - 90.0)


def onto_circle(ranges_m: Array, beam_angles_rad: Array, beam_count: int, range_max_m: float) -> Array:
    """(beam_count,) one scan (beams,) in the format of the world: the full circle, `UNSEEN_M` where there is no beam.

    Of several beams in one direction the nearest range is used. Ranges are limited to range_max_m; a beam without
    return has no information, since glass and black walls give no return either.
    """
    out = np.full(beam_count, np.inf)
    told = (ranges_m > 0.0) & (ranges_m < NO_RETURN_M)
    slot = np.rint(beam_angles_rad[told] * (beam_count / (2 * np.pi))).astype(int) % beam_count
    np.minimum.at(out, slot, np.minimum(ranges_m[told], range_max_m))
    out[np.isinf(out)] = UNSEEN_M
    return out


def beam_count_of(logs: Sequence[ScanLog]) -> int:
    """Beams of a full circle in which no direction of the coarsest scanner is left out, at most BEAMS."""
    coarsest_rad = max(_step_rad_of(log) for log in logs)
    if coarsest_rad * BEAMS <= _COARSE * 2 * math.pi:
        return BEAMS
    return max(int(round(2 * math.pi / coarsest_rad)), _BEAMS_MIN)


def _step_rad_of(log: ScanLog) -> float:
    """Angle between neighbouring beams; 0 if there is one beam."""
    return float(np.median(np.abs(np.diff(log.beams_of(0))))) if log.ranges_m.shape[1] > 1 else 0.0


def sensor_frames(
    log: ScanLog, beam_count: int, range_max_m: float, scans: Sequence[int] | Array | None = None, robot: int = 0
) -> list[SensorFrame]:
    """Sensor frames of a robot on the path of the log, one per scan of `scans` (default: all).

    Odometry is the motion between the poses of the log; its turn replaces the gyro where the log has none. Scans that
    take time are left as the scanner gives them, with its geometry, so that the engine can undo the motion; those of
    fewer directions than beam_count, too, so that it can draw walls between their beams.
    """
    is_raw = log.sweep_s > 0.0 or _step_rad_of(log) * beam_count > _COARSE * 2 * math.pi
    frames: list[SensorFrame] = []
    chosen = np.arange(len(log.times_s)) if scans is None else np.asarray(scans)
    time_s = 0.0
    for step, k in enumerate(chosen):
        last = chosen[max(step - 1, 0)]
        odometry = between(log.poses[last], log.poses[k])
        elapsed_s = max(log.times_s[k] - log.times_s[last], TIME_BETWEEN_MIN_S)
        time_s += elapsed_s if step else 0.0
        turn_rate_rad_s = float(odometry[2] / elapsed_s)
        if log.turned_rad is not None:
            turn_rate_rad_s = float((log.turned_rad[k] - log.turned_rad[last]) / elapsed_s)
        if is_raw:
            scan, scanner = log.ranges_of(k), _scanner_of(log, k, range_max_m)
        else:
            scan, scanner = onto_circle(log.ranges_of(k), log.beams_of(k), beam_count, range_max_m), None
        frames.append(SensorFrame(robot, step, float(time_s), odometry, turn_rate_rad_s, scan, scanner=scanner))
    return frames


def _scanner_of(log: ScanLog, scan: int, range_max_m: float) -> Scanner:
    """Geometry of a scan in the frame of the log's poses. No return tells nothing, as above."""
    first, *others = log.beams_of(scan)[:2].tolist()
    step_rad = others[0] - first if others else math.radians(1.0)
    return Scanner(first, step_rad, range_max_m=NO_RETURN_M, free_m=0.0, sweep_s=log.sweep_s)


def spaced(log: ScanLog, needed: Sequence[int] | Array = ()) -> Array:
    """Numbers of the scans to use: all, or, of a dense log, those that are
    `SPACING_M` or `SPACING_RAD` from the last one; the `needed` ones and the last one are among them."""
    motions = between(log.poses[:-1], log.poses[1:])
    moved_m, turned_rad = np.hypot(motions[:, 0], motions[:, 1]), np.abs(motions[:, 2])
    if len(motions) < 2 or not (np.median(moved_m) < DENSE_M and np.median(turned_rad) < DENSE_RAD):
        return np.arange(len(log.times_s))
    return apart(log.poses, SPACING_M, SPACING_RAD, {*np.asarray(needed, int).tolist(), len(log.times_s) - 1})


def apart(poses: Array, distance_m: float, turn_rad: float = math.inf, needed: Collection[int] = ()) -> Array:
    """Numbers of poses (n, 3): the first, then each that lies so far from the last chosen one, or is so turned, and the
    `needed` ones."""
    kept, (x, y, heading) = [0], poses.T.tolist()
    for k in range(1, len(x)):
        at = kept[-1]
        turned = abs(wrap_one(heading[k] - heading[at]))
        if math.hypot(x[k] - x[at], y[k] - y[at]) >= distance_m or turned >= turn_rad or k in needed:
            kept.append(k)
    return np.array(kept)


def read_relations(path: str | Path, log: ScanLog) -> Relations:
    """The relations between two different scans of the log. Raises DataError for lines other than of 8 numbers."""
    try:
        rows = np.array([line.split() for line in TextLines(path) if line.strip()], float)
        times, values = rows[:, :2], rows[:, [2, 3, 7]]
    except (ValueError, IndexError) as error:
        raise DataError(f"{path} holds no relations: {short_reason(error)}; expected lines of 8 numbers") from error
    scans = np.stack([_nearest(log.times_s, times[:, end]) for end in (0, 1)])
    away_s = np.abs(log.times_s[scans] - times.T).max(axis=0)
    found = (away_s <= TIME_TOLERANCE_S) & (scans[0] != scans[1])
    if not found.any():
        raise DataError(
            f"none of the {len(rows)} relations of {path} belongs to a scan of the log; wrong pair of files"
        )
    return Relations(scans[0][found], scans[1][found], values[found], away_s[found])


def _nearest(times_s: Array, wanted_s: Array) -> Array:
    after = np.clip(np.searchsorted(times_s, wanted_s), 1, len(times_s) - 1)
    return np.where(wanted_s - times_s[after - 1] < times_s[after] - wanted_s, after - 1, after)


def short_reason(error: Exception) -> str:
    """What an error says, cut off where it is long."""
    return str(error)[:120]


def __getattr__(name: str) -> NoReturn:
    if name in ("read_carmen_log", "read_any_log"):
        raise ImportError(f"{name} is now in twc_env.datasets.logs.carmen_log")
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
