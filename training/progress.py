"""Progress of a training or an evaluation."""

from __future__ import annotations

import sys
from collections.abc import Iterable
from typing import Any

from tqdm import tqdm

LOG_INTERVAL_S = 60.0
IN_A_LOG = "{n_fmt}/{total_fmt}{unit}, {elapsed} so far, {remaining} left{postfix}"


def progress_bar(items: Iterable | None = None, **settings: Any) -> tqdm:
    """A progress bar on a terminal; in a log a line every minute."""
    if sys.stderr.isatty():
        return tqdm(items, **settings)
    lines = {"mininterval": LOG_INTERVAL_S, "maxinterval": LOG_INTERVAL_S, "delay": LOG_INTERVAL_S}
    return tqdm(items, file=_Lines(), bar_format=IN_A_LOG, **lines, **settings)


class _Lines:
    """What a bar draws over and over, as lines of stderr."""

    def write(self, text: str) -> None:
        """One state of the bar."""
        if shown := text.strip():
            sys.stderr.write(f"{shown}\n")

    def flush(self) -> None:
        """Called by tqdm after each state."""
        sys.stderr.flush()
