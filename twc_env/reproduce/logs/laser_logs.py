"""The public laser logs of several tables, in the folder of real data."""

from __future__ import annotations

from pathlib import Path

from twc_env.datasets.logs.carmen_log import read_carmen_log
from twc_env.datasets.logs.scan_log import Relations, ScanLog, read_relations, read_scan_log
from twc_env.reproduce.runner import data_folder

INTEL = RAW, CORRECTED, RELATIONS = "intel_gfs.json.gz", "intel_corrected_log.json.gz", "intel.relations.gz"
"""Files of the Intel Lab log in `intel_folder`."""
LOGS = ("aces", "freiburg-079", "freiburg-101", "intel", "orebro")


def corrected_log(name: str) -> ScanLog:
    """One of LOGS, of Radish: the poses are corrected."""
    return read_carmen_log(data_folder() / "lidar" / "carmen" / f"{name}-corrected.log.gz")


def intel_folder() -> Path:
    """Raises DataError without TWC_DATA."""
    return data_folder() / "lidar" / "raw_odometry"


def intel_log(is_corrected: bool = False) -> ScanLog:
    """The Intel Lab log of the Freiburg SLAM benchmark, with raw odometry, or with the poses of GMapping."""
    return read_scan_log(intel_folder() / (CORRECTED if is_corrected else RAW))


def intel_relations(log: ScanLog) -> Relations:
    """The hand-verified relations of that benchmark."""
    return read_relations(intel_folder() / RELATIONS, log)
