"""Seeds of a command line."""

from __future__ import annotations

from twc_env.errors import ConfigError

RANGE_MAX = 100_000


def parse_seeds(text: str) -> tuple[int, ...]:
    """Seeds of a list such as 0-3,7 -> (0, 1, 2, 3, 7). Raises ConfigError for others and for endless ranges."""
    seeds: list[int] = []
    for part in text.split(","):
        first, dash, last = part.strip().partition("-")
        if not first.isdecimal() or (dash and not last.isdecimal()) or (dash and int(last) < int(first)):
            raise ConfigError(f"seeds must be numbers and ranges such as 0-9 or 1,4,7-9; got {text!r}")
        begin, end = int(first), int(last if dash else first) + 1
        if end - begin > RANGE_MAX:
            raise ConfigError(f"a range holds at most {RANGE_MAX} seeds; got {part.strip()}")
        seeds += range(begin, end)
    return tuple(dict.fromkeys(seeds))
