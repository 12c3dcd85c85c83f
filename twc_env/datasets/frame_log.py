"""Recorded sensor frames: what robots sensed, without any truth, so that the engine can be run again on them."""

from __future__ import annotations

import json
import zipfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twc_env.config import EnvConfig, from_dict, to_dict
from twc_env.errors import DataError
from twc_env.messages import Contacts, SensorFrame, SignReading, WifiScan

Array = NDArray

FORMAT = "twc_env/frames-1"
TRUTH_FORMAT = "twc_env/truth-1"


def write_frame_log(
    path: str | Path, config: EnvConfig, steps: Sequence[Sequence[SensorFrame]], contacts: Sequence[Contacts] = ()
) -> None:
    """Write the frames of an episode (one sequence of frames per step) to a compressed .npz file.

    `contacts`, one per step, say who heard whom; a log without them is replayed with all robots in touch.
    """
    frames = [frame for step in steps for frame in step]
    if not frames:
        raise DataError(f"no frames to write to {path}: record at least one step")
    heard = [frame.wifi for frame in frames]
    signs = [(k, sign) for k, frame in enumerate(frames) for sign in frame.signs]
    scans = [wifi for wifi in heard if wifi is not None]
    np.savez_compressed(
        path,
        format=np.array(FORMAT),
        config=np.array(json.dumps(to_dict(config), sort_keys=True)),
        robot=np.array([f.robot for f in frames], np.int32),
        step=np.array([f.step for f in frames], np.int64),
        time_s=np.array([f.time_s for f in frames]),
        odometry=np.array([f.odometry for f in frames]),
        turn_rate_rad_s=np.array([f.turn_rate_rad_s for f in frames]),
        ranges_m=np.array([f.ranges_m for f in frames]),
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


def _ages(scans: Sequence[WifiScan]) -> dict[str, Any]:
    """The column of ages; none where the receivers repeat no old readings (all scans of an episode are alike)."""
    ages = [scan.age_s for scan in scans if scan.age_s is not None]
    return {"wifi_age_s": np.concatenate(ages)} if ages else {}


def read_frame_log(path: str | Path) -> tuple[EnvConfig, list[tuple[SensorFrame, ...]]]:
    """The config of the recording and its frames, one tuple per step.

    Raises DataError when the file is missing, cut off or no frame log.
    """
    log = _read(path, FORMAT, "frame log")
    try:
        return from_dict(json.loads(str(log["config"]))), _steps(log)
    except (KeyError, IndexError) as error:
        raise DataError(f"{path} lacks or contradicts {error}; record it again") from error


def read_contacts(path: str | Path) -> list[Contacts]:
    """Who heard whom in each step of a recording; empty where the log does not say. Raises DataError as above."""
    log = _read(path, FORMAT, "frame log")
    if "contacts_heard" not in log:
        return []
    return [Contacts(tried, heard) for tried, heard in zip(log["contacts_tried"], log["contacts_heard"], strict=True)]


def write_truth_log(path: str | Path, seed: int, map_name: str, true_poses: Array) -> None:
    """Write where the robots truly were, (steps + 1, robots, 3) in the building frame, beside a frame log."""
    np.savez_compressed(
        path, format=np.array(TRUTH_FORMAT), seed=np.array(seed), map=np.array(map_name), true_poses=true_poses
    )


def read_truth_log(path: str | Path) -> tuple[int, str, Array]:
    """Seed, map and true poses (steps + 1, robots, 3) of a recording; raises DataError as `read_frame_log` does."""
    log = _read(path, TRUTH_FORMAT, "truth log")
    try:
        return int(log["seed"]), str(log["map"]), log["true_poses"]
    except KeyError as error:
        raise DataError(f"{path} lacks {error}; record it again") from error


def _read(path: str | Path, expected: str, kind: str) -> dict[str, Array]:
    try:
        with Path(path).open("rb") as file, np.load(file) as data:
            log = {key: data[key] for key in data.files}
    except OSError as error:
        raise DataError(f"cannot read the {kind} {path}: {error.strerror or error}") from error
    except (ValueError, EOFError, zipfile.BadZipFile) as error:
        raise DataError(f"{path} is no {kind} or is cut off: {error}; record it again") from error
    if str(log.get("format")) != expected:
        raise DataError(f"{path} has format {str(log.get('format'))!r}; expected {expected!r}: record it again")
    return log


def _steps(log: dict[str, Array]) -> list[tuple[SensorFrame, ...]]:
    texts = json.loads(str(log["sign_text"]))
    signs: dict[int, list[SignReading]] = {}
    for frame, (bearing, range_m), text in zip(log["sign_frame"].tolist(), log["sign_place"], texts, strict=True):
        signs.setdefault(frame, []).append(SignReading(text, float(bearing), float(range_m)))
    ends = np.cumsum(np.maximum(log["wifi_count"], 0))
    steps: dict[int, list[SensorFrame]] = {}
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
            ranges_m=log["ranges_m"][k],
            wifi=wifi,
            signs=tuple(signs.get(k, ())),
        )
        steps.setdefault(step, []).append(frame)
    return [tuple(frames) for _, frames in sorted(steps.items())]
