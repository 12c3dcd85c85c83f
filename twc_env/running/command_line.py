"""Shared parts of all commands: exit status, argument types, help, progress and tables."""

from __future__ import annotations

import argparse
import errno
import io
import logging
import math
import os
import sys
import textwrap
import time
import traceback
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

from twc_env._version import __version__
from twc_env.errors import ConfigError, DataError, TwcError, did_you_mean
from twc_env.records.json_values import check_folder, check_writable
from twc_env.records.text_tables import aligned_text
from twc_env.running.command_start import (
    begin_work,
    end_when_interrupted,
    end_work,
    interrupted_status,
    is_loading,
)
from twc_env.running.file_lock import FileLock
from twc_env.running.user_code import told_of_user_code

if TYPE_CHECKING:
    from twc_env.config import EnvConfig

_NO_ROOM = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EROFS, errno.EIO)
"""Errors when writing to a path that was writable before: no room, or a broken device."""

SEEDS_MAX = 100_000
"""Largest range of seeds on a command line."""
SEED_DIGITS_MAX = 20
"""Longer numbers are no seeds of any library."""
INTERRUPTED = 130
"""Status of a command that was interrupted and has saved what it had."""
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


def exit_status(command: Callable[[], int | None], remark: str = "interrupted", is_verbose: bool = False) -> int:
    """Run a command. Returns 0 or its own status when done, 130 when interrupted by Ctrl-C, 143 by SIGTERM.

    2 after bad input, or when output cannot be written (one line on stderr). 1 after an exception in a user's own class
    (FILE.py:CLASS): their line comes first, the whole traceback only if `is_verbose`. A reader such as `head` may close
    the output early, and characters that a terminal cannot show are escaped. `remark` is printed on interruption.
    """
    for name in ("stdout", "stderr"):
        if getattr(sys, name) is None:  # closed by the parent process
            setattr(sys, name, open(os.devnull, "w"))  # noqa: SIM115
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="backslashreplace" if sys.stdout.errors == "strict" else sys.stdout.errors)
    try:
        begin_work()
        try:
            status = command()
        finally:
            end_line()
        sys.stdout.flush()
        return interrupted_status() if status == INTERRUPTED else status or 0
    except TwcError as error:
        sys.stderr.write(f"error: {error}\n")
        return 2
    except BrokenPipeError:
        _silence()
        return 0
    except OSError as error:
        if error.errno not in _NO_ROOM:
            raise
        sys.stderr.write(f"error: cannot write: {error.strerror}; make room, or choose another place\n")
        try:
            sys.stdout.flush()
        except OSError:
            _silence()
        return 2
    except KeyboardInterrupt:
        sys.stderr.write(f"{remark}\n")
        return interrupted_status()
    except Exception as error:
        told = told_of_user_code(error)
        if told is None:
            raise
        if is_verbose:
            sys.stderr.write("".join(traceback.format_exception(error)))
        sys.stderr.write(told + ("" if is_verbose else "--verbose shows the whole traceback\n"))
        return 1
    finally:
        end_work()
        if is_loading():
            end_when_interrupted()


def run_command(parser: argparse.ArgumentParser, arguments: Sequence[str] | None) -> int:
    """Run the command that the arguments name, after checking the path of --json; returns as `exit_status`.

    A command's `run` gets its options; `when_interrupted`, if set, is its remark.
    """
    options = parser.parse_args(arguments)

    def command() -> int | None:
        check_writable(getattr(options, "json", None))
        return options.run(options)

    is_verbose = getattr(options, "verbose", False)
    with logging_to_terminal(getattr(options, "quiet", False), is_verbose):
        return exit_status(command, getattr(options, "when_interrupted", "interrupted"), is_verbose)


def _silence() -> None:
    """Discard further output, because its reader has closed it."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


class Paragraphs(argparse.HelpFormatter):
    """Help in which each paragraph and each point of a list is filled; lines that begin with two spaces, such as
    examples, are kept.

    The help of an option ends with its default value, unless its text states a default.
    """

    def _get_help_string(self, action: argparse.Action) -> str:
        text = action.help or ""
        is_number_or_text = isinstance(action.default, (int, float, str, Path)) and action.default is not False
        if not action.option_strings or not is_number_or_text or action.default == "" or "default: " in text:
            return text
        return text if action.default == argparse.SUPPRESS else f"{text} (default: %(default)s)"

    def _fill_text(self, text: str, width: int, indent: str) -> str:
        return "\n\n".join(self._filled(part, width) for part in text.strip().split("\n\n"))

    @staticmethod
    def _filled(part: str, width: int) -> str:
        if part.startswith("- "):
            points = [" ".join(point.split()) for point in f"\n{part}".split("\n- ")[1:]]
            return "\n".join(textwrap.fill(f"- {point}", width, subsequent_indent="  ") for point in points)
        prose: list[str] = []
        lines: list[str] = []
        for line in [*part.splitlines(), None]:
            if line is not None and not line.startswith("  "):
                prose.append(line)
                continue
            lines += textwrap.wrap(" ".join(prose), width) + ([] if line is None else [line])
            prose = []
        return "\n".join(lines)


Fill = Callable[[argparse.ArgumentParser], None]
"""Adds description and arguments to a parser."""


class Parser(argparse.ArgumentParser):
    """Parser of a program and of all its commands, with help as in `Paragraphs`."""

    def __init__(self, *, fill: Fill | None = None, **settings: Any):
        """fill: called when the arguments are first needed, so that a program imports only what its command needs."""
        self._fill: Fill | None = None
        super().__init__(**{"formatter_class": Paragraphs, **settings})
        self._fill = fill

    @property
    def _actions(self) -> list[argparse.Action]:
        """The arguments: argparse and argcomplete read them before anything else that `fill` adds."""
        fill, self._fill = self._fill, None
        if fill is not None:
            fill(self)
            if self._subparsers is None:
                add_verbosity(self)
        return self._filled_actions

    @_actions.setter
    def _actions(self, actions: list[argparse.Action]) -> None:
        self._filled_actions = actions

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> tuple[Any, list[str]]:
        """Unknown arguments are rejected by the command itself, which shows its own usage."""
        namespace, unknown = super().parse_known_args(args, namespace)
        if unknown:
            options = [word.partition("=")[0] for word in unknown if word.startswith("-")]
            hint = did_you_mean(options[0], self._option_string_actions) if options else ""
            self.error(f"unrecognized arguments: {' '.join(unknown)}{hint}")
        return namespace, unknown

    def _check_value(self, action: argparse.Action, value: Any) -> None:
        try:
            super()._check_value(action, value)
        except argparse.ArgumentError as error:
            error.message += did_you_mean(value, map(str, action.choices or ()))
            raise

    def error(self, message: str) -> NoReturn:
        """Reject arguments, and refer to the help."""
        super().error(f"{message}; {self.prog} --help says more")


def add_version(parser: argparse.ArgumentParser) -> None:
    """The option `--version`."""
    parser.add_argument(
        "--version", action="version", version=f"twc_env {__version__}", help="print the version and exit"
    )


def add_verbosity(parser: argparse.ArgumentParser) -> None:
    """The options `--quiet` and `--verbose`, which every command has."""
    either = parser.add_mutually_exclusive_group()
    either.add_argument(
        "-q", "--quiet", action="store_true", help="show results and errors only: no progress, no remarks"
    )
    either.add_argument(
        "-v", "--verbose", action="store_true", help="show also what happens inside, and whole tracebacks"
    )


def add_pictures(parser: argparse.ArgumentParser) -> None:
    """The options `--format` and `--dpi` of commands that write pictures, which `picture_options` reads."""
    parser.add_argument("--format", choices=("png", "pdf", "svg"), default="png", help="of pictures")
    parser.add_argument("--dpi", type=number(20, 1200), help="of pictures: dots per inch (default: 130)")


def picture_options(options: argparse.Namespace) -> tuple[str, float | None] | None:
    """Format and dpi of pictures; None with --no-pictures or without matplotlib."""
    if getattr(options, "no_pictures", False) or find_spec("matplotlib") is None:
        return None
    return getattr(options, "format", "png"), getattr(options, "dpi", None)


def add_set(parser: argparse.ArgumentParser) -> None:
    """The option `--set`, which `assignments` reads."""
    parser.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="KEY=VALUE",
        help="override a setting, e.g. lidar.beam_count=90; repeatable (list: twc-env settings)",
    )


def assignments(texts: Sequence[str]) -> dict[str, object]:
    """`KEY=VALUE` texts of the command line as a dictionary."""
    pairs = [text.partition("=") for text in texts]
    for text, (key, separator, _) in zip(texts, pairs, strict=True):
        if not separator or not key:
            raise ConfigError(f"--set takes KEY=VALUE, for example lidar.beam_count=360; got {text!r}")
    return {key: value for key, _, value in pairs}


def add_config(parser: argparse.ArgumentParser) -> None:
    """The option `--config`, which `config_of` reads."""
    parser.add_argument(
        "--config", metavar="FILE", help="settings: TOML, JSON, a run folder or a task such as twc/ExploreHard-v0"
    )


def add_allow_code(parser: argparse.ArgumentParser) -> None:
    """The option `--allow-code`, see `refuse_code`."""
    parser.add_argument(
        "--allow-code",
        action="store_true",
        help="execute the Python files that settings of a file, log or run folder name (FILE.py:CLASS), as those of "
        "--set always are",
    )


def refuse_code(config: EnvConfig, source: str | Path, asked: Iterable[str] = ()) -> None:
    """Raise ConfigError if settings read from `source` name Python files to execute, apart from the settings `asked`,
    which the user's own command line replaces. A file that somebody else wrote must not choose what is executed."""
    from twc_env.config import code_named_in

    named = [f"{key}={name}" for key, name in code_named_in(config).items() if key not in set(asked)]
    if named:
        raise ConfigError(
            f"{source} names code to execute ({', '.join(named)}): if you trust it, add --allow-code or the same by "
            "--set; if not, choose another by --set"
        )


def config_of(name: str | None) -> EnvConfig:
    """The settings that `--config` names: a standard task, a TOML or JSON file, or a run folder; without it the
    defaults. Raises ConfigError."""
    from twc_env.config import EnvConfig, load
    from twc_env.tasks import task_config

    if name is None:
        return EnvConfig()
    return task_config(name) if name.startswith("twc/") else load(name)


def add_json(parser: argparse.ArgumentParser, more: str = "") -> None:
    """The option `--json`, for `write_json`; more: what else is written then."""
    parser.add_argument(
        "--json", type=Path, metavar="FILE", help=f"also write the results as JSON{more}; - for the terminal"
    )


def add_lasting(parser: argparse.ArgumentParser) -> None:
    """The options `--prior` and `--save`: maps that last from session to session."""
    parser.add_argument(
        "--prior", type=Path, metavar="FILE", help="begin with a map saved earlier; robots start anywhere in it"
    )
    parser.add_argument(
        "--save",
        type=Path,
        metavar="FILE",
        help="write the map (.npz: keyframes, pose graph, grid) for later sessions; with --prior old and new as one",
    )


def prior_setting(options: argparse.Namespace) -> dict[str, str]:
    """The setting that `--prior` stands for; none without it. Raises DataError if `--save` cannot be written."""
    if options.save is not None:
        check_folder(options.save.parent)
        if options.save.is_dir():
            raise DataError(f"cannot write the map to {options.save}: it is a folder; name a file")
    return {} if options.prior is None else {"slam.prior": str(options.prior)}


def add_folder(parser: argparse.ArgumentParser, option: str, default: str, what: str) -> None:
    """An option that names a folder."""
    parser.add_argument(option, type=Path, default=Path(default), metavar="FOLDER", help=what)


def count(text: str) -> int:
    """A number of things, from 1 on, as an argument's type."""
    return _whole_number(text, 1)


def natural(text: str) -> int:
    """A whole number from 0 on, as an argument's type."""
    return _whole_number(text, 0)


def _whole_number(text: str, least: int) -> int:
    if not (text.isascii() and text.isdigit()) or int(text) < least:
        raise argparse.ArgumentTypeError(f"must be a whole number of at least {least}; got {text!r}")
    return int(text)


def number(least: float, most: float) -> Callable[[str], float]:
    """A number from `least` to `most`, as an argument's type."""

    def read(text: str) -> float:
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        if not least <= value <= most:
            raise argparse.ArgumentTypeError(f"must be a number from {least:g} to {most:g}; got {text!r}")
        return value

    return read


def show_count(done: int, total: int, what: str = "", every: int = 1) -> None:
    """Show how much of a command is done, whenever the count is a multiple of `every`; see `show_line`."""
    if done % every == 0 or done == total:
        show_line(f"{done}/{total}{what}", done == total)


class Bar:
    """Progress as a bar with the time left; it fits terminals of any width."""

    def __init__(self, total: int, what: str, every: int = 1):
        self._total, self._what, self._every = total, what, every
        self._latest: deque[tuple[int, float]] = deque([(0, time.monotonic())], maxlen=RATE_COUNT)
        """The last counts with their times [s], which give the rate: a slow beginning does not count for long."""

    def show(self, done: int, more: str = "") -> None:
        """Show the progress, whenever `done` is a multiple of `every`. more: what has been reached so far."""
        if done % self._every == 0 or done == self._total:
            (first, since_s), now_s = self._latest[0], time.monotonic()
            self._latest.append((done, now_s))
            left_s = (now_s - since_s) * (self._total - done) / max(done - first, 1)
            text = f"{done}/{self._total} {self._what}{', ' * bool(more)}{more}"
            if first == 0 and len(self._latest) == 2 and done <= COMPILING_SHARE * self._total:
                self._latest.popleft()
            else:
                text += f", {_clock(left_s)} left at most"
            width = _width_of(sys.stderr)
            show_line(text if width is None else bar_line(done / self._total, text, width), done == self._total)


def bar_line(share: float, text: str, width: int) -> str:
    """A bar and a text in at most `width` characters; without room for both, the text alone, cut at its last comma."""
    room = width - len(text) - 4
    if room >= BAR_LEAST:
        full = round(min(room, BAR_MOST) * share)
        return f"[{'#' * full}{'-' * (min(room, BAR_MOST) - full)}] {text}"
    while len(text) > width - 1 and ", " in text:
        text = text.rpartition(", ")[0]
    return text[: max(width - 1, 0)]


def _clock(seconds: float) -> str:
    minutes, seconds = divmod(math.ceil(seconds), 60)
    hours, minutes = divmod(int(minutes), 60)
    return f"{hours}:{minutes:02d}:{int(seconds):02d}" if hours else f"{minutes}:{int(seconds):02d}"


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


def parse_seeds(text: str) -> tuple[int, ...]:
    """Seeds of a list such as 0-3,7 -> (0, 1, 2, 3, 7). Raises ConfigError for other texts and huge ranges."""
    seeds: list[int] = []
    for part in text.split(","):
        first, dash, last = part.strip().partition("-")
        if not first.isdecimal() or (dash and not last.isdecimal()):
            raise ConfigError(f"seeds must be numbers and ranges such as 0-9 or 1,4,7-9; got {text!r}")
        if max(len(first), len(last)) > SEED_DIGITS_MAX:
            raise ConfigError(f"a seed has at most {SEED_DIGITS_MAX} digits; got one of {max(len(first), len(last))}")
        begin, end = int(first), int(last if dash else first) + 1
        if end <= begin:
            raise ConfigError(f"seeds must be numbers and ranges such as 0-9 or 1,4,7-9; got {text!r}")
        if end - begin > SEEDS_MAX:
            raise ConfigError(f"a range holds at most {SEEDS_MAX} seeds; got {part.strip()}")
        seeds += range(begin, end)
    return tuple(dict.fromkeys(seeds))


def make_folder(folder: Path) -> None:
    """Create the folder that `--out` names. Raises DataError if that fails."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise DataError(f"cannot make the folder {folder}: {error.strerror}; choose another with --out") from error


@contextmanager
def alone_in(folder: Path, patience_s: float = 60.0) -> Iterator[None]:
    """Lock a folder, which is created, so that two commands do not mix their files in it.

    Raises DataError if another command holds it for longer than `patience_s`, or if the folder cannot be created.
    """
    make_folder(folder)
    with FileLock(folder / ".lock").held(patience_s) as is_ours:
        if is_ours is False:
            raise DataError(f"another command writes to {folder}: wait for its end, or choose another with --out")
        yield
