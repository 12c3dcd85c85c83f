"""CARMEN logs written: ROBOTLASER1 lines with the scanner's own angles."""

from __future__ import annotations

import gzip
import math
from pathlib import Path

import numpy as np

from twc_env.datasets.logs.scan_log import ScanLog
from twc_env.records.whole_file import whole_file

_NO_RETURN_M = 81.83
"""What SICK scanners report for no return."""


def write_carmen_log(path: str | Path, log: ScanLog, range_max_m: float) -> None:
    """Write the scans of a log whose beams are evenly spaced, with ranges to the centimetre; a name that ends in .gz is
    packed. A beam without return reads more than the maximum range."""
    lines = ["# message_name [message contents] ipc_timestamp ipc_hostname logger_timestamp"]
    for k, (time_s, pose) in enumerate(zip(log.times_s.tolist(), log.poses, strict=True)):
        angles, ranges_m = log.beams_of(k), log.ranges_of(k)
        step = float(angles[1] - angles[0]) if len(angles) > 1 else math.radians(1.0)
        is_return = (ranges_m > 0.0) & (ranges_m < range_max_m)
        told = " ".join(f"{value:.2f}" for value in np.where(is_return, ranges_m, _NO_RETURN_M))
        place = " ".join(f"{value:.4f}" for value in pose)
        head = f"{angles[0]:.7f} {step * len(angles):.6f} {step:.9f} {range_max_m:g} 0.010000 0"
        lines.append(
            f"ROBOTLASER1 0 {head} {len(angles)} {told} 0 {place} {place} 0 0 0 0 0 {time_s:.3f} robot {time_s:.3f}"
        )
    text = ("\n".join(lines) + "\n").encode()
    with whole_file(path) as beside:
        beside.write_bytes(gzip.compress(text, mtime=0) if str(path).endswith(".gz") else text)
