"""Running a command: its exit status, and what happens on errors and interruption."""

from __future__ import annotations

import argparse
import errno
import io
import os
import sys
import traceback
from collections.abc import Callable, Sequence

from twc_env.errors import TwcError
from twc_env.records.json_values import check_writable
from twc_env.running.command_start import (
    begin_work,
    end_when_interrupted,
    end_work,
    interrupted_status,
    is_interruption,
    is_loading,
    no_more_signals,
)
from twc_env.running.terminal import end_line, logging_to_terminal
from twc_env.running.unbuffered_output import whole_output
from twc_env.running.user_code import told_of_user_code

_NO_ROOM = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EROFS, errno.EIO)
"""Errors when writing to a path that was writable before: no room, or a broken device."""
INTERRUPTED = 130
"""Status of a command that was interrupted and has saved what it had."""


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
    except (KeyboardInterrupt, Exception) as error:
        if is_interruption(error):
            no_more_signals()
            sys.stderr.write(f"{remark}\n")
            return interrupted_status()
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


def is_without_memory(error: BaseException) -> bool:
    """Whether there was no memory for an array or, while libraries are loaded, for their code."""
    told = str(error).lower()
    return (
        isinstance(error, MemoryError)
        or getattr(error, "errno", None) == errno.ENOMEM
        or any(words in told for words in ("cannot allocate memory", "failed to map segment", "load shared object"))
    )


def run_command(parser: argparse.ArgumentParser, arguments: Sequence[str] | None) -> int:
    """Run the command that the arguments name, after checking the path of --json; returns as `exit_status`.

    A command's `run` gets its options; `when_interrupted`, if set, is its remark.
    """
    options = parser.parse_args(arguments)

    def command() -> int | None:
        check_writable(getattr(options, "json", None))
        return options.run(options)

    is_verbose = getattr(options, "verbose", False)
    with whole_output(), logging_to_terminal(getattr(options, "quiet", False), is_verbose):
        return exit_status(command, getattr(options, "when_interrupted", "interrupted"), is_verbose)


def _silence() -> None:
    """Discard further output, because its reader has closed it."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
