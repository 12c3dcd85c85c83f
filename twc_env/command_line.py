"""What the commands share: settings given as KEY=VALUE."""

from __future__ import annotations

from collections.abc import Sequence

from twc_env.errors import ConfigError


def assignments(texts: Sequence[str]) -> dict[str, object]:
    """`KEY=VALUE` texts of the command line as a dictionary."""
    pairs = [text.partition("=") for text in texts]
    for key, separator, _ in pairs:
        if not separator:
            raise ConfigError(f"--set takes KEY=VALUE, for example lidar.beam_count=360; got {key!r}")
    return {key: value for key, _, value in pairs}
