"""Intervals of shares counted in few cases: what 0 wrong of n shows."""

from __future__ import annotations

from twc_env.errors import DataError

CONFIDENCE = 0.95


def share_interval(count: int, of: int) -> tuple[float, float]:
    """The 95 % interval of a share of which `count` in `of` cases were counted (Clopper and Pearson 1934).

    Of none or all, the whole 5 % are at the one open end: 0 of n leaves less than about 3 / n (the rule of three).
    Raises DataError unless 0 <= count <= of and of >= 1.
    """
    from scipy.special import betaincinv  # imported here: slow to import, and no step needs it

    if not 0 <= count <= of or of < 1:
        raise DataError(f"a share is counted in one case or more, 0 <= count <= cases; got {count} of {of}")
    tail = (1.0 - CONFIDENCE) / (1 if count in (0, of) else 2)
    low = float(betaincinv(count, of - count + 1, tail)) if count else 0.0
    high = float(betaincinv(count + 1, of - count, 1.0 - tail)) if count < of else 1.0
    return low, high
