"""What the commands share: settings given as KEY=VALUE, and figures written as JSON."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

from twc_env.errors import ConfigError


def assignments(texts: Sequence[str]) -> dict[str, object]:
    """`KEY=VALUE` texts of the command line as a dictionary."""
    pairs = [text.partition("=") for text in texts]
    for key, separator, _ in pairs:
        if not separator:
            raise ConfigError(f"--set takes KEY=VALUE, for example lidar.beam_count=360; got {key!r}")
    return {key: value for key, _, value in pairs}


def write_json(path: Path | None, values: dict) -> None:
    """Write figures, folders included; nothing without a path."""
    if path is not None:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(json.dumps(values, indent=2) + "\n")
