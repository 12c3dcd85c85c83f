"""BLE strengths and 2D LiDAR of a robot in a flat with a known wall plan (Kolakowski 2021, CC BY 4.0).

Six fixed receivers hear one moving tag; by reciprocity they are treated as six transmitters heard by the robot.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.datasets.surveys.fingerprints import RadioSurvey, read_numbers
from twc_env.errors import DataError
from twc_env.records.geometry import transform_points

_HALF_TURN_RAD = float(np.deg2rad(179.5))
POSE_LAYOUT_RUN = {
    "calibration": (0.0, 0.0, 0.0),
    "calib3": (0.43, 6.31, _HALF_TURN_RAD),
    "calib4": (0.47, 6.34, _HALF_TURN_RAD),
}
"""Pose of the frame of each run in the frame of the wall plan."""
ANCHORS = {"calibration": (1, 2, 3, 4, 5, 6), "calib3": (3, 4, 5, 8, 10, 11), "calib4": (3, 4, 5, 8, 10, 11)}
"""Numbers of the six fixed radios in each run, in the order of the plan."""
_PAUSE_NS = 60e9
"""A longer pause separates the drives of a run."""


@dataclass(frozen=True, slots=True, eq=False)
class Flat:
    """The wall plan."""

    outline_m: Array
    """(k, 2) contour of the free space, not closed."""
    anchors_m: Array
    """(6, 2) fixed radios."""


def read_flat(folder: str | Path) -> Flat:
    """The outline and the anchors. Raises DataError for missing or invalid files."""
    ring = read_numbers(Path(folder) / "layout.csv", ("x", "y"))
    anchors = read_numbers(Path(folder) / "anchors.csv", ("id", "x", "y", "z"))
    return Flat(ring[:-1] if np.array_equal(ring[0], ring[-1]) else ring, anchors[:, 1:3])


def read_ble_run(folder: str | Path, run: str) -> RadioSurvey:
    """The run "calibration", "calib3" or "calib4", in the frame of the wall plan.

    The calibration consists of four drives, walks 0 to 3: walk 2 is calib3 and walk 3 is calib4. Raises
    DataError for other runs.
    """
    if run not in POSE_LAYOUT_RUN:
        raise DataError(f"the flat has no run {run!r}; known are {', '.join(POSE_LAYOUT_RUN)}")
    columns = tuple(f"rssi_{anchor}" for anchor in ANCHORS[run])
    table = read_numbers(Path(folder) / f"{run}_df.csv.gz", ("ts", "x", "y", *columns), filled=3)
    return RadioSurvey(
        name=f"ble_lidar/{run}",
        position_m=transform_points(POSE_LAYOUT_RUN[run], table[:, 1:3]),
        floor=np.zeros(len(table), int),
        time_s=(table[:, 0] - table[0, 0]) * 1e-9,
        walk=np.cumsum(np.diff(table[:, 0], prepend=table[0, 0]) > _PAUSE_NS),
        addresses=tuple(f"anchor-{i + 1}" for i in range(len(columns))),
        rssi_dbm=table[:, 3:].astype(np.float32),
        transmitter_m=read_flat(folder).anchors_m,
        transmitter_floor=np.zeros(len(columns), int),
        is_high_band=np.zeros(len(columns), bool),
    )
