"""Play the episodes of a benchmark: on this machine or on a Ray cluster; finished episodes are kept and reused."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from twc_env.config import to_dict
from twc_env.errors import DataError
from twc_env.running.finished_parts import FinishedParts, code_digest
from twc_env.running.ray_cluster import spread_out
from twc_env.running.terminal import COMPILING_SHARE, show_line
from twc_env.suite.entries import Entry
from twc_env.suite.player import digest_of_team, play

Played = tuple[str, dict[str, Any]]
"""Digest of the code that played an episode, and its values."""
BAR_WIDTH = 24


def play_all(
    entries: Sequence[Entry],
    folder: Path,
    jobs: int = 1,
    ray_address: str | None = None,
    tell: Callable[[str], None] = lambda text: None,
) -> list[dict[str, Any]]:
    """The values of every entry, in their order; episodes that an earlier run with the same code finished are read.

    jobs: worker processes; ray_address: play on a Ray cluster instead, see `running.ray_cluster`. `tell` gets a
    sentence about what is reused. Raises DataError if the folder cannot be written to or a worker process dies; what is
    finished by then is kept.
    """
    digests: dict[tuple[str, str], str] = {}
    stores = {}
    for entry in entries:
        if (entry.task, entry.team) not in digests:
            digests[entry.task, entry.team] = digest_of_team(entry)
        if entry.task not in stores:
            stores[entry.task] = FinishedParts(folder, "episode", _settings(entry), ("twc_env.agents",))
    keys = [f"{e.config.map} {e.team} {digests[e.task, e.team]} {e.number}" for e in entries]
    found = [stores[e.task].find(key) for e, key in zip(entries, keys, strict=True)]
    waiting = [k for k, values in enumerate(found) if values is None]
    for remark in dict.fromkeys(store.remark for store in stores.values() if store.remark):
        tell(remark)
    if len(waiting) < len(entries):
        tell(f"{len(entries) - len(waiting)} of {len(entries)} episodes are finished already")
    progress = Progress(entries, waiting)
    parts = [entries[k] for k in waiting]
    for at, (digest, values) in spread_out(play_here, parts, min(jobs, len(parts)), ray_address):
        if digest != code_digest("twc_env.agents"):
            raise DataError(
                f"a worker has other code ({digest}) than this machine ({code_digest('twc_env.agents')}): install the "
                "same version of twc_env everywhere"
            )
        k = waiting[at]
        found[k] = stores[entries[k].task].keep(keys[k], values)
        progress.note(entries[k])
    return [values for values in found if values is not None]


def play_here(entry: Entry) -> Played:
    """Play one entry, and tell by which code."""
    return code_digest("twc_env.agents"), play(entry)


def _settings(entry: Entry) -> dict[str, Any]:
    """Settings of a task without the building."""
    return {key: value for key, value in to_dict(entry.config).items() if key != "map"}


class Progress:
    """How many episodes are finished, and how long the others will take at the speed so far."""

    def __init__(self, entries: Sequence[Entry], waiting: Sequence[int], clock_s: Callable[[], float] = time.monotonic):
        self._total, self._done = len(entries), len(entries) - len(waiting)
        self._weight_left = sum(entries[k].weight for k in waiting)
        self._weight_done, self._is_first = 0.0, True
        self._clock_s, self._began_s = clock_s, clock_s()

    def note(self, entry: Entry) -> None:
        """One more episode is finished."""
        self._done += 1
        self._weight_done += entry.weight
        self._weight_left -= entry.weight
        if self._is_first and self._done <= COMPILING_SHARE * self._total:
            self._weight_done, self._began_s = 0.0, self._clock_s()  # it may have waited for kernels
        self._is_first = False
        show_line(f"{self.line}: {entry.task} {entry.config.map} {entry.team}", self._done == self._total)

    @property
    def line(self) -> str:
        """A bar, the number of episodes and the time left, as soon as that can be told."""
        filled = BAR_WIDTH * self._done // max(self._total, 1)
        bar = "#" * filled + "-" * (BAR_WIDTH - filled)
        text = f"[{bar}] {self._done}/{self._total} episodes"
        if not self._weight_done:
            return text
        left_s = (self._clock_s() - self._began_s) * self._weight_left / self._weight_done
        return f"{text}, {_duration(left_s)} left"


def _duration(seconds: float) -> str:
    if seconds < 100:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 6000 else f"{seconds / 3600:.1f} h"
