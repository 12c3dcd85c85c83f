"""The Intel Lab log in consecutive sessions, each of which begins with the map that the one before has saved.

The raw log of the table `intel`; no signs and no WiFi, so scans alone find the earlier map. `ate_m` is the root mean
square distance of the session's scans from their poses in the published corrected log, in the frame of the first
session's map, which alone was aligned with that log. `wrong` is 1 if a scan of a session that found the map is more
than 1 m or 10 degrees off. `relation_error_m` is the mean error of the benchmark's hand-verified relations between a
scan of the session and one of the same or an earlier one. A session that did not find the map has no `ate_m`, and the
relations within itself alone.
"""

from __future__ import annotations

import math
import tempfile
from pathlib import Path

import numpy as np

from twc_env.config import from_dict
from twc_env.datasets.lasting_maps import read_lasting_map, write_lasting_map
from twc_env.datasets.logs.scan_log import BEAMS, RANGE_MAX_M, SETTINGS, sensor_frames
from twc_env.errors import DataError
from twc_env.metrics import lay_map
from twc_env.records.geometry import compose, wrap_angle
from twc_env.replaying.odometry_errors import taken_from_log
from twc_env.reproduce.logs.intel import place_frames, read_corrected, read_log
from twc_env.reproduce.logs.laser_logs import INTEL, intel_folder
from twc_env.slam.engine import CooperativeSlam

WRONG_M, WRONG_RAD = 1.0, math.radians(10)
SCANS = 910


def lacks_log() -> str:
    """Why the log cannot be read: TWC_DATA or a file that is lacking; empty if it can."""
    try:
        lacking = [name for name in INTEL if not (intel_folder() / name).exists()]
    except DataError as error:
        return str(error)
    return f"{intel_folder()} lacks {', '.join(lacking)} (docs/real_data.md names the source)" if lacking else ""


def intel_sessions(sessions: int, scans: int = SCANS) -> list[dict]:
    """One row per session of the first scans of the log, cut into as many pieces."""
    (log, relations), corrected = read_log(scans), read_corrected(scans)
    config, rows = from_dict(SETTINGS | {"robots": 1}), []
    placed, group = np.full((scans, 3), np.nan), np.full(scans, -1)
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "map.npz"
        for number, piece in enumerate(np.array_split(np.arange(scans), sessions)):
            told, paths, _ = taken_from_log(config, [sensor_frames(log, BEAMS, RANGE_MAX_M, piece)])
            engine = CooperativeSlam(told, 1, read_lasting_map(file) if number else None)
            (placed[piece],) = place_frames(engine, paths)
            is_found = number == 0 or engine.found_prior(0)
            group[piece] = 0 if is_found else number
            if number == 0:
                pose_log_map = lay_map(placed[piece], corrected[piece])
            errors = compose(pose_log_map, placed[piece]) - corrected[piece]
            off_m, off_rad = np.hypot(errors[:, 0], errors[:, 1]), np.abs(wrap_angle(errors[:, 2]))
            is_here = np.isin(relations.first, piece) | np.isin(relations.second, piece)
            is_here &= (group[relations.first] == group[relations.second]) & (group[relations.first] >= 0)
            relation_m = relations.errors(placed)[0][is_here]
            lasting = engine.lasting_map()
            rows.append({
                "building": f"intel session {number + 1}",
                "merged": int(is_found) if number else None,
                "wrong": int(is_found and bool(((off_m > WRONG_M) | (off_rad > WRONG_RAD)).any())),
                "ate_m": float(np.sqrt((off_m**2).mean())) if is_found else None,
                "off_max_m": float(off_m.max()) if is_found else None,
                "relation_error_m": float(relation_m.mean()) if len(relation_m) else None,
                "relations": len(relation_m),
                "file_kb": write_lasting_map(file, lasting) / 1000,
                "keyframes": len(lasting.poses),
            })  # fmt: skip
    return rows
