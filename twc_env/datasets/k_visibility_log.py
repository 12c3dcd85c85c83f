"""WiFi strengths along the walks of the inverse k-visibility experiments (their own logs, positions in pixels)."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from numpy.typing import NDArray

from twc_env.datasets.fingerprints import numbers, read_table

Array = NDArray

_FILES = {
    "E3": ("Exp1_1router.csv", ("rssi",)),
    "E5": ("Exp3_2router.csv", ("router1_2.4", "router1_5", "router2_2.4", "router2_5")),
}
"""By the experiment's name in the paper's Table I (42.5 m2, with one and with two routers)."""


@dataclass(frozen=True, slots=True, eq=False)
class KVisibilityLog:
    """One experiment."""

    position_px: Array
    """(k, 2)."""
    rssi_dbm: Array
    """(k, signals); those of E3 were smoothed along the path by the authors."""
    signals: tuple[str, ...]


def read_k_visibility_log(folder: str | Path, experiment: str) -> KVisibilityLog:
    """Experiment "E3" or "E5". Raises DataError for files that are missing or broken, KeyError for other names."""
    name, signals = _FILES[experiment]
    path = Path(folder) / name
    header, rows = read_table(path, ("x_pixel", "y_pixel", *signals))
    table = numbers(rows, path)
    at = {column: i for i, column in enumerate(header)}
    return KVisibilityLog(
        table[:, [at["x_pixel"], at["y_pixel"]]], table[:, [at[signal] for signal in signals]], signals
    )
