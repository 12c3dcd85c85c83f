"""Progress, remarks and tables on the terminal; in a log a line per minute."""

from __future__ import annotations

import logging
import math
import os
import sys
import time
from collections import deque
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

from twc_env.records.text_tables import aligned_text

LOG_INTERVAL_S = 60.0
LINE_WIDTH = 110
RATE_COUNT = 10
"""Counts from which the time left is estimated."""
COMPILING_SHARE = 0.05
"""Of the whole: the first count may have waited for kernels, so up to here it says nothing about the time left."""
BAR_LEAST, BAR_MOST = 8, 40
"""Characters of a progress bar."""
_progress: dict[str, Any] = {"logged_s": time.monotonic(), "is_open": False, "shown": 0, "is_quiet": False}
"""Time of the last progress line in a log, whether the line of the terminal shows progress and how many characters of
it, and whether --quiet was given."""
_COMMANDS = logging.getLogger("twc_env.commands")


def show_count(done: int, total: int, what: str = "", every: int = 1) -> None:
    """Show how much of a command is done, whenever the count is a multiple of `every`; see `show_line`."""
    if done % every == 0 or done == total:
        show_line(f"{done}/{total}{what}", done == total)


class Bar:
    """Progress as a bar with the time left; it fits terminals of any width.

    what: is counted. where: it happens; told if there is room.
    """

    def __init__(self, total: int, what: str, where: str = "", every: int = 1):
        self._total, self._what, self._where, self._every = total, what, where, every
        self._latest: deque[tuple[int, float]] = deque([(0, time.monotonic())], maxlen=RATE_COUNT)
        """The last counts with their times [s], which give the rate: a slow beginning does not count for long."""

    def show(self, done: int, more: str = "", brief: str = "") -> None:
        """Show the progress, whenever `done` is a multiple of `every`. more: what has been reached so far; brief: the
        same, where there is little room."""
        if done % self._every == 0 or done == self._total:
            (first, since_s), now_s = self._latest[0], time.monotonic()
            self._latest.append((done, now_s))
            left = f"{_clock((now_s - since_s) * (self._total - done) / max(done - first, 1))} left"
            if first == 0 and len(self._latest) == 2 and done <= COMPILING_SHARE * self._total:
                self._latest.popleft()
                left = ""
            texts = self._texts(done, more, brief, left)
            width = _width_of(sys.stderr)
            show_line(texts[0] if width is None else bar_line(done / self._total, texts, width), done == self._total)

    def _texts(self, done: int, more: str, brief: str, left: str) -> list[str]:
        """What may stand beside the bar, from all there is to say to the least."""
        count, counted = f"{done}/{self._total}", f"{done}/{self._total} {self._what}"
        at_most, where = f"{left} at most" * bool(left), f" {self._where}" * bool(self._where)
        choices = (
            (counted + where, more, at_most), (counted, more, left), (counted, brief or more, left), (count, left),
            (count,),
        )  # fmt: skip
        return [", ".join(filter(None, parts)) for parts in choices]


def bar_line(share: float, texts: Sequence[str], width: int) -> str:
    """A bar and a text in at most `width` characters: the longest of the texts (all but the last two) with room for a
    bar; if there is none, the longest that fits alone, or the shortest, cut.

    texts: longest first.
    """
    for text in texts[:-2]:
        room = width - len(text) - 4
        if room >= BAR_LEAST:
            full = round(min(room, BAR_MOST) * share)
            return f"[{'#' * full}{'-' * (min(room, BAR_MOST) - full)}] {text}"
    return next((text for text in texts if len(text) < width), texts[-1])[: max(width - 1, 0)]


def _clock(seconds: float) -> str:
    minutes, seconds = divmod(math.ceil(seconds), 60)
    hours, minutes = divmod(int(minutes), 60)
    return f"{hours}:{minutes:02d}:{int(seconds):02d}" if hours else f"{minutes}:{int(seconds):02d}"


@contextmanager
def without_progress() -> Iterator[None]:
    """No progress is shown in this block."""
    before, _progress["is_quiet"] = _progress["is_quiet"], True
    try:
        yield
    finally:
        _progress["is_quiet"] = before


def show_line(text: str, is_last: bool = False) -> None:
    """Show the progress of a command: on a terminal in one line that is overwritten, in a log in a line per minute;
    not at all with --quiet."""
    if _progress["is_quiet"]:
        return
    width = _width_of(sys.stderr)
    if width is not None:
        shown = text[: max(width - 1, 0)]
        sys.stderr.write(f"\r{shown}{' ' * (_progress['shown'] - len(shown))}")
        sys.stderr.flush()
        _progress["is_open"], _progress["shown"] = True, len(shown)
        if is_last:
            end_line()
    elif time.monotonic() - _progress["logged_s"] >= LOG_INTERVAL_S:
        sys.stderr.write(f"{text}\n")
        _progress["logged_s"] = time.monotonic()


def _width_of(stream: Any) -> int | None:
    """Width of the terminal that a stream writes to, in characters; None if it writes to no terminal."""
    if not stream.isatty():
        return None
    try:
        return os.get_terminal_size(stream.fileno()).columns or LINE_WIDTH
    except (OSError, ValueError):
        return LINE_WIDTH


def terminal_width() -> int | None:
    """Width to which tables are folded; None if the output goes to a file or another program, which gets all."""
    return _width_of(sys.stdout)


def end_line() -> None:
    """End the line that shows progress, so that the next output begins a new line."""
    if _progress["is_open"]:
        sys.stderr.write("\n")
        _progress["is_open"], _progress["shown"] = False, 0


def tell(text: str) -> None:
    """A remark on stderr; not with --quiet."""
    _COMMANDS.info(text)


class _ToTerminal(logging.Handler):
    """Writes messages to stderr, below the line that shows progress."""

    def emit(self, record: logging.LogRecord) -> None:
        """Write one message."""
        end_line()
        sys.stderr.write(f"{record.getMessage()}\n")
        sys.stderr.flush()


@contextmanager
def logging_to_terminal(is_quiet: bool = False, is_verbose: bool = False) -> Iterator[None]:
    """Messages of the package appear on stderr while a command runs: remarks and warnings; with --quiet only warnings,
    with --verbose also what happens inside."""
    package, handler, level = logging.getLogger("twc_env"), _ToTerminal(), logging.getLogger("twc_env").level
    if is_quiet:
        handler.addFilter(lambda record: record.module != "compilation")  # that it takes a while is a remark
    package.addHandler(handler)
    package.setLevel(logging.WARNING if is_quiet else logging.DEBUG if is_verbose else logging.INFO)
    _progress["is_quiet"] = is_quiet
    try:
        yield
    finally:
        package.removeHandler(handler)
        package.setLevel(level)
        _progress["is_quiet"] = False


def aligned(rows: Sequence[dict[str, Any]], width: int | None = None) -> str:
    """Rows as a table of aligned columns, which are the keys of the first row, folded to a width."""
    if not rows:
        return "no rows"
    columns = list(rows[0])
    lines = [columns, *([_cell(row.get(column)) for column in columns] for row in rows)]
    return aligned_text(lines, width, left=len(columns))


def _cell(value: Any) -> str:
    if value is None:
        return "-"
    if isinstance(value, float):
        return f"{value:.4g}" if abs(value) < 1e4 else f"{value:.0f}"
    return str(value)
