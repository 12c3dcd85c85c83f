"""Seeds of a command line."""

from __future__ import annotations

from twc_env.errors import ConfigError


def parse_seeds(text: str) -> tuple[int, ...]:
    """Seeds of a list such as 0-3,7 -> (0, 1, 2, 3, 7). Raises ConfigError for anything else."""
    seeds: list[int] = []
    for part in text.split(","):
        first, dash, last = part.strip().partition("-")
        if not first.isdecimal() or (dash and not last.isdecimal()) or (dash and int(last) < int(first)):
            raise ConfigError(f"seeds must be numbers and ranges such as 0-9 or 1,4,7-9; got {text!r}")
        seeds += range(int(first), int(last if dash else first) + 1)
    return tuple(dict.fromkeys(seeds))
