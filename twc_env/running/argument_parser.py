"""The parser of all commands: help in paragraphs, hints after typing errors, arguments added when they are needed."""

from __future__ import annotations

import argparse
import re
import sys
import textwrap
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NoReturn

from twc_env._version import __version__
from twc_env.errors import did_you_mean, one_of


class Paragraphs(argparse.HelpFormatter):
    """Help in which each paragraph and each point of a list is filled; lines that begin with two spaces, such as
    examples, are kept where they fit and else folded: a command so that it can still be copied.

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
            lines += textwrap.wrap(" ".join(prose), width) + ([] if line is None else folded(line, width))
            prose = []
        return "\n".join(lines)

    def _format_usage(self, *args: Any) -> str:
        lines = super()._format_usage(*args).split("\n")
        return "\n".join(line if len(line) <= self._width else self._broken(line) for line in lines)

    def _broken(self, line: str) -> str:
        """A long line of choices, broken behind a bar or comma."""
        parts, indent = re.findall(r".+?(?:[|,] ?|$)", line), " " * (len(line) - len(line.lstrip()) + 1)
        lines = [parts[0]]
        for part in parts[1:]:
            if len(lines[-1]) + len(part.rstrip()) <= self._width:
                lines[-1] += part
            else:
                lines.append(indent + part)
        return "\n".join(part.rstrip() for part in lines)


def folded(line: str, width: int) -> list[str]:
    """A line of an epilog in parts of at most `width` characters: the remark of a command comes before it, a command
    goes on behind a backslash, and the text beside a name stays in its column."""
    if len(line) <= width:
        return [line]
    command, _, remark = line.partition("  # ")
    if not remark and not line.startswith("  twc-env "):
        column = re.match(r" *\S+(?: \S+)* {2,}", line)
        hanging = " " * (column.end() if column and column.end() <= 0.6 * width else 6)
        return textwrap.wrap(line, width, subsequent_indent=hanging, break_long_words=False, break_on_hyphens=False)
    above = textwrap.wrap(remark, width, initial_indent="  # ", subsequent_indent="  # ") if remark else []
    if len(command.rstrip()) <= width:
        return [*above, command.rstrip()]
    parts = textwrap.wrap(command, width - 2, subsequent_indent=" " * 6, break_long_words=False, break_on_hyphens=False)
    return [*above, *(f"{part} \\" for part in parts[:-1]), parts[-1]]


USAGE_LINES_MAX = 4
RENAMED = {"--no-gif": "--no-film", "--max-cycles": "--steps"}
"""Options that have another name now, or in another command, which the error tells."""
WITHOUT_VALUE = {
    "--films": "they are written to films in --out FOLDER",
    "--html": "the page is replay.html in --out FOLDER",
    "--rerun": "the recording is replay.rrd in --out FOLDER",
}
"""Options that once named a file or folder."""

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
            self.error(f"unrecognized arguments: {' '.join(unknown)}{self._hint(unknown, args)}")
        return namespace, unknown

    def _hint(self, unknown: Sequence[str], args: Sequence[str] | None) -> str:
        """What the user may have meant: the new name of an option, what became of its value, or a similar option."""
        options = [word.partition("=")[0] for word in unknown if word.startswith("-")]
        if options:
            new = RENAMED.get(options[0])
            is_known = new in self._option_string_actions
            return f": it is {new}" if is_known else did_you_mean(options[0], self._option_string_actions)
        words = list(sys.argv[1:] if args is None else args)
        before = [words[k - 1] for k in range(1, len(words)) if words[k] == unknown[0]]
        lost = [option for option in before if option in WITHOUT_VALUE]
        return f": {lost[0]} takes no value now, {WITHOUT_VALUE[lost[0]]}" if lost else ""

    def _check_value(self, action: argparse.Action, value: Any) -> None:
        choices = action.choices
        if choices is not None and value not in choices:
            raise argparse.ArgumentError(
                action, f"{value!r} is unknown{one_of(value, map(str, choices), 'choose from')}"
            )

    def error(self, message: str) -> NoReturn:
        """Reject arguments in a line, and refer to the help; a short usage is shown where something lacks."""
        usage = self.format_usage()
        shown = usage if "required" in message and usage.count("\n") <= USAGE_LINES_MAX else ""
        self.exit(2, f"{shown}{self.prog}: error: {message}; {self.prog} --help says more\n")


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
