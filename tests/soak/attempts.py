"""Attempts with malformed input: each must succeed or raise one error of its kind, in one line, soon and with little
memory, and touch no file elsewhere and start no process."""

from __future__ import annotations

import contextlib
import json
import os
import sys
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

from twc_env.errors import TwcError
from twc_env.kernels.cache_folder import cache_folder
from twc_env.maps import load_map
from twc_env.processes.process_memory import peak_mb
from twc_env.world.building.floorplan import Floorplan

SECONDS_MAX = 2.0
"""Limit of CPU time of one attempt, or, if it exceeds that, of its repetition; exceeding it, or the next two, is
wrong."""
WALL_SECONDS_MAX = 30.0
"""Waiting counts too, on a machine that others use."""
MEMORY_MAX_MB = 1000.0
"""Limit of the growth of the process's peak memory over all attempts."""
LINE_MAX = 1500
"""Characters of an error's line."""
_HIDDEN = ("/etc/", "/root/", "/home/", "/proc/", "/sys/", "/var/")
"""Places whose files no input may name; those of this program are known."""


@cache
def _own() -> tuple[str, ...]:
    places = sys.prefix, sys.base_prefix, Path(__file__).parents[2], cache_folder()
    return tuple(str(Path(place).resolve()) for place in places)


_OF_KERNELS = ("numba", "llvmlite", "twc_env.", "numpy", "copyreg", "builtins", "collections")

Attempt = tuple[str, Callable[[], Any]]
"""What is tried, in words, and the call."""


@dataclass(slots=True)
class Attempts:
    """Counts of attempts."""

    tried: int = 0
    refused: int = 0
    accepted: int = 0
    wrong: list[str] = field(default_factory=list)
    slowest_s: float = 0.0
    slowest: str = ""
    grown_mb: float = 0.0
    """Increase of the peak memory of the process; NaN if the system does not report it."""

    def figures(self) -> dict[str, Any]:
        """The counts as JSON has them."""
        return {
            "tried": self.tried,
            "refused": self.refused,
            "accepted": self.accepted,
            "wrong": len(self.wrong),
            "slowest_s": self.slowest_s,
            "slowest": self.slowest,
            "memory_grown_mb": self.grown_mb,
            "faults": self.wrong[:20],
        }


def attempt_all(
    attempts: Iterable[Attempt],
    error: type[TwcError] = TwcError,
    report: Callable[[int], None] = lambda done: None,
    is_watched: bool = True,
) -> Attempts:
    """Make all attempts; `error` is the class that may be raised. What compiles or loads at first use must have been
    used before the first attempt is taken from the iterable. With is_watched the time, files and processes of each
    attempt are."""
    result = Attempts()
    before_mb = float("nan")
    for what, work in attempts:
        if result.tried == 0:
            with contextlib.suppress(OSError):  # on Linux, let the peak begin anew at the present memory
                Path("/proc/self/clear_refs").write_text("5")
            before_mb = peak_mb()
        with _touched() as touched:
            took_s, waited_s = _outcome(what, work, error, result)
            if is_watched and is_slow(took_s, waited_s):  # kernels may have compiled, here or in another process
                took_s, waited_s = _outcome(what, work, error, Attempts())
        result.tried += 1
        if is_watched:
            result.wrong += [f"{what}: touched {place}" for place in touched]
            if took_s > result.slowest_s:
                result.slowest_s, result.slowest = took_s, what
            if is_slow(took_s, waited_s):
                limits = f"more than {SECONDS_MAX:g} or {WALL_SECONDS_MAX:g} s"
                result.wrong.append(f"{what}: took {took_s:.1f} s and waited {waited_s:.0f} s, {limits}")
        report(result.tried)
    result.grown_mb = peak_mb() - before_mb
    if result.grown_mb > MEMORY_MAX_MB:
        result.wrong.append(f"memory grew by {result.grown_mb:.0f} MB, more than {MEMORY_MAX_MB:g} MB")
    return result


def is_slow(took_s: float, waited_s: float) -> bool:
    """Whether an attempt took too much processor time, or too long; what hangs does so again."""
    return took_s > SECONDS_MAX or waited_s > WALL_SECONDS_MAX


def _outcome(what: str, work: Callable[[], Any], error: type[TwcError], result: Attempts) -> tuple[float, float]:
    """Make one attempt and count its outcome; processor time and time waited [s]."""
    began_s, began_wall_s = time.process_time(), time.perf_counter()
    try:
        work()
        result.accepted += 1
    except error as refusal:
        result.refused += 1
        if fault := _fault_of(refusal):
            result.wrong.append(f"{what}: {fault}")
    except Exception as other:
        result.wrong.append(f"{what}: {type(other).__name__}: {str(other)[:100]}")
    return time.process_time() - began_s, time.perf_counter() - began_wall_s


def _fault_of(refusal: TwcError) -> str | None:
    """What is wrong with an error's message; None: it is one line that says more than what failed."""
    text = str(refusal)
    if "\n" in text:
        return "an error of several lines"
    if len(text) > LINE_MAX:
        return f"an error of {len(text)} characters: {text[:80]}"
    if not any(mark in text for mark in (";", ":", ",", " must ")):
        return f"an error that says no remedy: {text[:80]}"
    return None


_watchers: list[list[str]] = []


def _notice(event: str, arguments: tuple) -> None:
    if not _watchers:
        return
    is_call = event == "pickle.find_class" and not str(arguments[0]).startswith(_OF_KERNELS)  # numba keeps pickles
    if is_call or event in ("os.system", "subprocess.Popen", "os.exec", "os.posix_spawn", "socket.connect"):
        _watchers[-1].append(f"{event} {arguments!r:.80}")
    elif event in ("open", "sqlite3.connect", "os.remove", "os.rename") and isinstance(arguments[0], (str, bytes)):
        place = os.path.realpath(os.fsdecode(arguments[0]).removeprefix("file:").partition("?")[0])
        if place.startswith(_HIDDEN) and not place.startswith((*_own(), "/proc/self", "/proc/meminfo")):
            _watchers[-1].append(place)


@contextlib.contextmanager
def _touched() -> Iterator[list[str]]:
    """A list of what the block opens in `_HIDDEN` places, and of processes and connections that it starts."""
    if not _notice_is_installed:
        sys.addaudithook(_notice)
        _notice_is_installed.append(True)
    _watchers.append([])
    try:
        yield _watchers[-1]
    finally:
        _watchers.pop()


_notice_is_installed: list[bool] = []


@contextlib.contextmanager
def workplace() -> Iterator[Path]:
    """An empty folder, deleted at the end."""
    with tempfile.TemporaryDirectory() as name:
        yield Path(name)


def load_anew(path: Path) -> Floorplan:
    """The map of a file, as `load_map` reads it; a map that it remembers would take no time when it is tried again."""
    os.utime(path)
    return load_map(path)


def kept_rows(file: Path) -> list[dict[str, Any]]:
    """The rows of a file that a long run goes on with, a line of JSON each; none if there is no file."""
    rows = []
    for line in file.read_text().splitlines() if file.exists() else ():
        with contextlib.suppress(ValueError):  # a line that a kill cut off
            rows.append(json.loads(line))
    return rows


def append_row(file: Path, row: dict[str, Any]) -> None:
    """Add a row for `kept_rows`."""
    file.parent.mkdir(parents=True, exist_ok=True)
    before = file.read_text() if file.exists() else ""
    with file.open("a") as out:
        out.write("\n" * (before[-1:] not in ("", "\n")) + json.dumps(row) + "\n")  # a kill may have cut off a line
