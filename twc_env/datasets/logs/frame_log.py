"""Logs of recorded sensor frames, without ground truth, which the engine can replay."""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.config import ROBOTS_MAX, EnvConfig, from_dict, to_dict
from twc_env.datasets.logs.arrays_file import (
    REAL,
    TEXT,
    TRUTH_VALUE,
    WHOLE,
    fault_of_types,
    read_arrays,
    write_arrays,
)
from twc_env.errors import UNFIT, DataError, TwcError
from twc_env.records.messages import Contacts, SensorFrame, SignReading, WifiScan
from twc_env.records.scanner import Scanner

FORMAT = "twc_env/frames-1"
TRUTH_FORMAT = "twc_env/truth-1"
REMEDY = "record it again"
PER_FRAME = ("robot", "step", "time_s", "odometry", "turn_rate_rad_s", "ranges_m", "wifi_count")
PER_READING = ("sign_frame", "sign_place")
PER_ADDRESS = ("wifi_macs", "wifi_rssi_dbm")
"""Columns of the same length."""
_TYPES = {
    WHOLE: ("robot", "step", "step_frames", "wifi_count", "wifi_macs", "sign_frame"),
    REAL: ("time_s", "odometry", "turn_rate_rad_s", "ranges_m", "wifi_rssi_dbm", "wifi_age_s", "sign_place"),
    TRUTH_VALUE: ("contacts_tried", "contacts_heard"),
    TEXT: ("config", "sign_text"),
}


def write_frame_log(
    path: str | Path, config: EnvConfig, steps: Sequence[Sequence[SensorFrame]], contacts: Sequence[Contacts] = ()
) -> None:
    """Write the frames of an episode (one sequence of frames per step) to a compressed .npz file.

    `contacts`, one per step, are the radio contacts; a log without them is replayed with all robots in contact.
    Raises DataError if frames do not match the team and scanner of `config`, or if the file cannot be written.
    """
    if any(isinstance(step, SensorFrame) for step in steps):
        raise DataError("steps must be sequences of frames, one frame per robot: of one robot [[frame], [frame], ...]")
    frames = [frame for step in steps for frame in step]
    if not frames:
        raise DataError(f"no frames to write to {path}: record at least one step in which a robot works")
    robots = {frame.robot for frame in frames}
    beams = {np.shape(f.ranges_m) for f in frames if f.scanner is None and len(f.ranges_m)}
    if not all(robot in range(config.robots) for robot in robots):
        raise DataError(
            f"config.robots is {config.robots}, but there are frames of robots {', '.join(map(str, robots))}"
        )
    if beams - {(config.lidar.beam_count,)}:
        raise DataError(
            f"config.lidar.beam_count is {config.lidar.beam_count}, but there are scans of shape "
            f"{', '.join(map(str, sorted(beams)))}: set it to that of the scanner"
        )
    if contacts and len(contacts) != len(steps):
        raise DataError(f"{len(contacts)} contacts for {len(steps)} steps: give one per step, or none")
    heard = [frame.wifi for frame in frames]
    signs = [(k, sign) for k, frame in enumerate(frames) for sign in frame.signs]
    scans = [wifi for wifi in heard if wifi is not None]
    write_arrays(
        path,
        format=np.array(FORMAT),
        config=np.array(json.dumps(to_dict(config), sort_keys=True)),
        step_frames=np.array([len(step) for step in steps], np.int32),
        robot=np.array([f.robot for f in frames], np.int32),
        step=np.array([f.step for f in frames], np.int64),
        time_s=np.array([f.time_s for f in frames]),
        odometry=np.array([f.odometry for f in frames]),
        turn_rate_rad_s=np.array([f.turn_rate_rad_s for f in frames]),
        **_scans(frames),
        wifi_count=np.array([-1 if wifi is None else len(wifi.macs) for wifi in heard], np.int32),
        wifi_macs=np.concatenate([s.macs for s in scans]) if scans else np.zeros(0, np.int64),
        wifi_rssi_dbm=np.concatenate([s.rssi_dbm for s in scans]) if scans else np.zeros(0),
        **_ages(scans),
        sign_frame=np.array([k for k, _ in signs], np.int64),
        sign_place=np.array([(s.bearing_rad, s.range_m) for _, s in signs]).reshape(-1, 2),
        sign_text=np.array(json.dumps([s.text for _, s in signs])),
        contacts_tried=np.array([c.tried for c in contacts], bool),
        contacts_heard=np.array([c.heard for c in contacts], bool),
    )


def _scans(frames: Sequence[SensorFrame]) -> dict[str, Any]:
    """Columns of laser scans. Those of scanners that frames name, of any length, are filled up with NaN, and have
    columns of their lengths, of the numbers of their scanners, and of these scanners."""
    scanners = list(dict.fromkeys(frame.scanner for frame in frames if frame.scanner is not None))
    counts = [len(frame.ranges_m) for frame in frames]
    if not scanners and len(set(counts)) == 1:
        return {"ranges_m": np.array([frame.ranges_m for frame in frames])}
    ranges_m = np.full((len(frames), max(counts)), np.nan)
    for row, frame, count in zip(ranges_m, frames, counts, strict=True):
        row[:count] = frame.ranges_m
    numbers = {scanner: k for k, scanner in enumerate(scanners)}
    return {
        "ranges_m": ranges_m,
        "ranges_count": np.array(counts, np.int32),
        "scanner_number": np.array([numbers.get(f.scanner, -1) if f.scanner else -1 for f in frames], np.int32),
        "scanners": np.array(json.dumps([dataclasses.asdict(scanner) for scanner in scanners])),
    }


def _scanners(log: dict[str, Array]) -> list[Scanner | None]:
    """The scanner of each frame."""
    if "scanner_number" not in log:
        return [None] * len(log["robot"])
    known = [
        Scanner(**values | {"mount": tuple(map(float, values["mount"]))}) for values in json.loads(str(log["scanners"]))
    ]
    return [known[k] if k >= 0 else None for k in log["scanner_number"].tolist()]


def _ages(scans: Sequence[WifiScan]) -> dict[str, Any]:
    """The column of ages; none if no scan has ages."""
    if all(scan.age_s is None for scan in scans):
        return {}
    ages = [np.zeros(len(scan.macs)) if scan.age_s is None else scan.age_s for scan in scans]
    return {"wifi_age_s": np.concatenate(ages)}


def read_frame_log(path: str | Path) -> tuple[EnvConfig, list[tuple[SensorFrame, ...]]]:
    """The config of the recording and its frames, one tuple per step, empty where all robots have failed.

    Raises DataError if the file is missing, truncated or not a frame log.
    """
    log = _read(path)
    try:
        config, steps = from_dict(json.loads(str(log["config"]))), _steps(log)
    except TwcError:
        raise
    except (LookupError, *UNFIT) as error:
        raise DataError(f"{path} contradicts itself: {error}; {REMEDY}") from error
    return config, steps


def wifi_readings(steps: Sequence[Sequence[SensorFrame]], robot: int = 0) -> tuple[Array, Array, Array]:
    """WiFi scans of one robot: indices of its frames (scans,), addresses (m,), and dBm (scans, m), NaN where not heard.

    In the form that `k_visibility.map_structure` takes. Readings repeated from the robot's earlier scans, as their ages
    tell, were taken elsewhere and are left out.
    """
    own = [frame for frames in steps for frame in frames if frame.robot == robot]
    heard, scanned_s = [], -math.inf
    for k, frame in enumerate(own):
        if frame.wifi is not None:
            heard.append((k, _renewed(frame.wifi, frame.time_s - scanned_s)))
            scanned_s = frame.time_s
    macs = np.unique(np.concatenate([wifi.macs for _, wifi in heard])) if heard else np.zeros(0, np.int64)
    rssi_dbm = np.full((len(heard), len(macs)), np.nan)
    for row, (_, wifi) in zip(rssi_dbm, heard, strict=True):
        row[np.searchsorted(macs, wifi.macs)] = wifi.rssi_dbm
    return np.array([k for k, _ in heard], np.int64), macs, rssi_dbm


def _renewed(scan: WifiScan, period_s: float) -> WifiScan:
    """The readings of a scan that are younger than the time since the scan before it."""
    if scan.age_s is None:
        return scan
    is_new = scan.age_s < period_s
    return WifiScan(scan.macs[is_new], scan.rssi_dbm[is_new], scan.age_s[is_new])


def read_contacts(path: str | Path) -> list[Contacts]:
    """Radio contacts in each step of a recording; empty if not recorded. Raises DataError as above."""
    log = _read(path)
    if "contacts_heard" not in log or "contacts_tried" not in log:
        return []
    tried, heard = log["contacts_tried"], log["contacts_heard"]
    steps = len(log["step_frames"] if "step_frames" in log else np.unique(log["step"]))
    if tried.shape != heard.shape or (len(tried) and len(tried) != steps):
        raise DataError(f"{path} contradicts itself: contacts {tried.shape} and {heard.shape}; {REMEDY}")
    return [Contacts(*both) for both in zip(tried, heard, strict=True)]


def write_truth_log(path: str | Path, seed: int, map_name: str, true_poses: Array) -> None:
    """Write the true poses (steps + 1, robots, 3) in the building frame to a file of their own."""
    write_arrays(
        path, format=np.array(TRUTH_FORMAT), seed=np.array(seed), map=np.array(map_name), true_poses=true_poses
    )


def read_truth_log(path: str | Path) -> tuple[int, str, Array]:
    """Seed, map and true poses (steps + 1, robots, 3) of a recording; raises DataError as `read_frame_log` does."""
    log = read_arrays(path, "truth log", TRUTH_FORMAT, ("seed", "map", "true_poses"), REMEDY)
    fault = fault_of_types(log, {WHOLE: ("seed",), TEXT: ("map",), REAL: ("true_poses",)})
    if fault is None and not np.isfinite(log["true_poses"]).all():
        fault = "true_poses that are not finite"
    if fault is not None:
        raise DataError(f"{path} contradicts itself: {fault}; {REMEDY}")
    try:
        return int(log["seed"]), str(log["map"]), log["true_poses"].astype(float)
    except UNFIT as error:
        raise DataError(f"{path} contradicts itself: {error}; {REMEDY}") from error


def _read(path: str | Path) -> dict[str, Array]:
    log = read_arrays(
        path, "frame log", FORMAT, ("config", *PER_FRAME, *PER_READING, *PER_ADDRESS, "sign_text"), REMEDY
    )
    for keys in (PER_FRAME, PER_READING, PER_ADDRESS):
        lengths = {key: log[key].shape[0] if log[key].ndim else None for key in keys}
        if len(set(lengths.values())) > 1:
            raise DataError(f"{path} contradicts itself: columns of different length, {lengths}; {REMEDY}")
    if not len(log["robot"]):
        raise DataError(f"{path} holds no frames; {REMEDY}")
    if fault := _fault(log):
        raise DataError(f"{path} contradicts itself: {fault}; {REMEDY}")
    return log


def _fault(log: dict[str, Array]) -> str | None:
    """The first inconsistency of columns of correct length, or None."""
    if fault := fault_of_types(log, _TYPES):
        return fault
    flat = set(PER_FRAME + PER_READING + PER_ADDRESS) - {"odometry", "ranges_m", "sign_place"}
    for key in sorted(flat | {"step_frames"} & log.keys()):
        if log[key].ndim != 1:
            return f"{key} of shape {log[key].shape}, one value a row is possible"
    frames, readings, counts, robots = len(log["robot"]), len(log["wifi_macs"]), log["wifi_count"], log["robot"]
    if robots.min() < 0 or robots.max() >= ROBOTS_MAX:
        return f"frames of robots {robots.min()} to {robots.max()}, 0 to {ROBOTS_MAX - 1} are possible"
    if log["odometry"].shape != (frames, 3) or log["ranges_m"].ndim != 2:
        return f"odometry of shape {log['odometry'].shape} and ranges_m of {log['ranges_m'].shape}"
    if (counts < -1).any() or np.maximum(counts, 0).sum() != readings:
        return f"wifi_count counts {np.maximum(counts, 0).sum()} readings and wifi_macs holds {readings}"
    for key in ("ranges_count", "scanner_number"):
        if key in log and (log[key].shape != (frames,) or log[key].dtype.kind not in "iu"):
            return f"{key} of shape {log[key].shape} and type {log[key].dtype}, a whole number per frame is possible"
    if "ranges_count" in log and not (
        0 <= log["ranges_count"].min() <= log["ranges_count"].max() <= len(log["ranges_m"].T)
    ):
        return f"ranges_count up to {log['ranges_count'].max()}, and scans of {log['ranges_m'].shape[1]} beams"
    if "wifi_age_s" in log and log["wifi_age_s"].shape != (readings,):
        return f"wifi_age_s of shape {log['wifi_age_s'].shape} for {readings} readings"
    counted = log.get("step_frames", np.ones(0, int))
    if "step_frames" in log and (counted.sum() != frames or counted.min() < 0):
        return f"step_frames counts {counted.sum()} frames, and there are {frames}"
    if not np.isin(log["sign_frame"], np.arange(frames)).all():
        return f"sign_frame names frames beyond the {frames} that there are"
    return None


def _steps(log: dict[str, Array]) -> list[tuple[SensorFrame, ...]]:
    texts = json.loads(str(log["sign_text"]))
    if not all(isinstance(text, str) for text in texts):
        raise TypeError("sign_text holds something that is not text")
    signs: dict[int, list[SignReading]] = {}
    for frame, (bearing, range_m), text in zip(log["sign_frame"].tolist(), log["sign_place"], texts, strict=True):
        signs.setdefault(frame, []).append(SignReading(text, float(bearing), float(range_m)))
    ends = np.cumsum(np.maximum(log["wifi_count"], 0))
    beams = log["ranges_count"] if "ranges_count" in log else np.full(len(log["robot"]), log["ranges_m"].shape[1])
    scanners = _scanners(log)
    frames: list[SensorFrame] = []
    for k, step in enumerate(log["step"].tolist()):
        count = int(log["wifi_count"][k])
        heard = slice(ends[k] - max(count, 0), ends[k])
        age_s = log["wifi_age_s"][heard] if "wifi_age_s" in log else None
        wifi = None if count < 0 else WifiScan(log["wifi_macs"][heard], log["wifi_rssi_dbm"][heard], age_s)
        frame = SensorFrame(
            robot=int(log["robot"][k]),
            step=step,
            time_s=float(log["time_s"][k]),
            odometry=log["odometry"][k],
            turn_rate_rad_s=float(log["turn_rate_rad_s"][k]),
            ranges_m=log["ranges_m"][k, : beams[k]],
            wifi=wifi,
            signs=tuple(signs.get(k, ())),
            scanner=scanners[k],
        )
        frames.append(frame)
    if "step_frames" in log:
        step_ends = np.cumsum(log["step_frames"]).tolist()
        return [tuple(frames[first:last]) for first, last in zip([0, *step_ends[:-1]], step_ends, strict=True)]
    steps: dict[int, list[SensorFrame]] = {}
    for frame in frames:
        steps.setdefault(frame.step, []).append(frame)
    return [tuple(of_step) for _, of_step in sorted(steps.items())]
