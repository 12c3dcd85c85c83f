"""Progress of a training or an evaluation."""

from __future__ import annotations

import sys
from collections.abc import Iterable
from typing import Any

from tqdm import tqdm

LOG_INTERVAL_S = 30.0


def progress_bar(items: Iterable | None = None, **settings: Any) -> tqdm:
    """A progress bar on a terminal; in a log a line every half minute."""
    interval_s = 0.1 if sys.stderr.isatty() else LOG_INTERVAL_S
    return tqdm(items, mininterval=interval_s, maxinterval=max(interval_s, 10.0), **settings)
