# PYTHON_ARGCOMPLETE_OK
"""The command `twc-env`; `python -m twc_env` is the same."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from functools import partial
from importlib import import_module

import argcomplete

from twc_env.commands.completion import Completer
from twc_env.running.argument_parser import Parser, add_version
from twc_env.running.command_line import is_without_memory, run_command

COMMANDS = {
    "explore": "run one episode and write a run folder",
    "watch": "watch a team live in a window, and drive one of its robots by the arrow keys",
    "compare": "compare several agents in the same buildings",
    "benchmark": "run one agent on many seeds and maps, and count the episodes that pass",
    "train": "train a policy (needs the extra `train`)",
    "evaluate": "compare a trained policy with random and scripted teams in held-out buildings",
    "maps": "list, draw, generate, import, export and check floor plans",
    "settings": "print every setting with its meaning, range and value, as a TOML file to start from",
    "warm-up": "compile all kernels now instead of at the first episode",
    "record": "record the sensor frames of an episode, and the ground truth in a separate file",
    "replay": "run the SLAM engine on a recorded log, or export a run as a web page or Rerun recording",
    "data": "list and fetch public data sets, and simulate logs as real robots record them",
    "optimise": "optimise a g2o or TORO pose graph robustly, and tell whether the result is lost",
    "bench": "measure steps per second, with and without SLAM",
    "ocr": "measure how a real OCR misreads signs, or show the measured table",
    "reproduce": "reproduce tables of the three papers and our own, beside published values",
}
"""Each has a module of its name in `twc_env.commands`, imported when it is asked for."""

_EXAMPLES = """\
examples:
  twc-env explore --map twin-01 --out runs/mine
  twc-env watch --map twin-01 --drive 0
  twc-env compare --buildings 20 --jobs 2
  twc-env maps show twin-01
  twc-env settings > mine.toml

"""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command; the exit status is 0 when done, 2 after bad input or without memory (one line on stderr), 130
    when interrupted by Ctrl-C and 143 by SIGTERM."""
    try:
        parser = _parser()
        argcomplete.autocomplete(parser, default_completer=Completer())
        return run_command(parser, arguments)
    except (MemoryError, ImportError, OSError) as error:
        if not is_without_memory(error):
            raise
        sys.stderr.write(
            f"error: there is too little memory ({str(error)[:120] or 'none left'}); give the process more\n"
        )
        return 2


def _parser() -> argparse.ArgumentParser:
    from twc_env.commands.team_options import agents_help

    parser = Parser(
        prog="twc-env",
        description="Teams of robots that explore buildings while a cooperative SLAM engine maps them. Each command "
        "has its own --help.",
        epilog=_EXAMPLES + agents_help(),
    )
    add_version(parser)
    commands = parser.add_subparsers(required=True, metavar="COMMAND")
    for name, text in COMMANDS.items():
        commands.add_parser(name, help=text, fill=partial(_fill, name))
    return parser


def _fill(name: str, parser: argparse.ArgumentParser) -> None:
    import_module(f"twc_env.commands.{name.replace('-', '_')}").add_arguments(parser)


if __name__ == "__main__":
    sys.exit(main())
