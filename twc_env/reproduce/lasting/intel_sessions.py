"""The Intel Lab log in consecutive sessions, each of which begins with the map that the one before has saved.

The raw log of the table `intel`; no signs and no WiFi, so scans alone find the earlier map. `relation_error_m` is the
mean error of the benchmark's hand-verified relations between a scan of the session and one of the same or an earlier
one, all poses in the frame of the first session's map; a session that did not find it has those within itself alone.
"""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np

from twc_env.config import from_dict
from twc_env.datasets.lasting_maps import read_lasting_map, write_lasting_map
from twc_env.datasets.logs.scan_log import BEAMS, RANGE_MAX_M, SETTINGS, sensor_frames
from twc_env.reproduce.logs.intel import place_frames, read_log
from twc_env.slam.engine import CooperativeSlam

WRONG_M = 1.0
"""A session with a larger mean error is in a wrong place."""


def intel_sessions(sessions: int) -> list[dict]:
    """One row per session of the log, cut into as many pieces."""
    log, relations = read_log(910)
    config, rows = from_dict(SETTINGS | {"robots": 1}), []
    placed, group = np.full((910, 3), np.nan), np.full(910, -1)
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "map.npz"
        for number, piece in enumerate(np.array_split(np.arange(910), sessions)):
            engine = CooperativeSlam(config, 1, read_lasting_map(file) if number else None)
            (placed[piece],) = place_frames(engine, [sensor_frames(log, BEAMS, RANGE_MAX_M, piece)])
            is_found = number == 0 or engine.found_prior(0)
            group[piece] = 0 if is_found else number
            is_here = np.isin(relations.first, piece) | np.isin(relations.second, piece)
            is_here &= (group[relations.first] == group[relations.second]) & (group[relations.first] >= 0)
            error_m = relations.errors(placed)[0][is_here]
            lasting = engine.lasting_map()
            rows.append({
                "building": f"intel session {number + 1}",
                "merged": int(is_found) if number else None,
                "wrong": int(error_m.mean() > WRONG_M),
                "relation_error_m": float(error_m.mean()),
                "relations": len(error_m),
                "file_kb": write_lasting_map(file, lasting) / 1000,
                "keyframes": len(lasting.poses),
            })  # fmt: skip
    return rows
