"""The sample log of the package: two simulated robots with laser, WiFi and signs, written by `twc-env data sample`."""

from __future__ import annotations

from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path

SAMPLE = "sample"
"""What `twc-env replay` calls it."""


@dataclass(frozen=True, slots=True)
class SampleFiles:
    """Its files."""

    logs: tuple[Path, ...]
    """CARMEN logs, one of each robot."""
    wifi: tuple[Path, ...]
    signs: tuple[Path, ...]


def sample_files(folder: Path | None = None) -> SampleFiles:
    """The files of the sample in a folder (None: in the package)."""
    place = Path(str(files(__package__))) if folder is None else folder
    return SampleFiles(tuple(sorted(place.glob("robot_*.log.gz"))), (place / "wifi.csv.gz",), (place / "signs.csv",))
