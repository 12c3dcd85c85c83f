"""How far a long run has come."""

from __future__ import annotations

import sys
from collections.abc import Iterable
from typing import Any

from tqdm import tqdm

LOG_INTERVAL_S = 30.0


def progress_bar(items: Iterable | None = None, **settings: Any) -> tqdm:
    """A bar that moves on a terminal; in a log file, where nothing moves, a line every half minute."""
    interval_s = 0.1 if sys.stderr.isatty() else LOG_INTERVAL_S
    return tqdm(items, mininterval=interval_s, maxinterval=max(interval_s, 10.0), **settings)
