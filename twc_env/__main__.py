"""Command line: python -m twc_env maps | settings | record | replay | bench | soak | ocr | reproduce."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence

from twc_env.commands.bench import add_bench_parser
from twc_env.commands.logs import add_log_parsers
from twc_env.commands.maps import add_maps_parser
from twc_env.commands.ocr import add_ocr_parser
from twc_env.commands.settings import add_settings_parser
from twc_env.commands.soak import add_soak_parser
from twc_env.reproduce.runner import add_parser
from twc_env.running.command_line import Parser, add_version, run_command


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command; the exit status is 0 when done, 2 after bad input (one line on stderr), 130 when interrupted."""
    return run_command(_parser(), arguments)


def _parser() -> argparse.ArgumentParser:
    parser = Parser(
        prog="python -m twc_env",
        description="Inspect maps and settings, record and replay sensor logs, measure speed, reproduce published "
        "tables.",
        epilog="examples:\n  python -m twc_env maps show twin-01\n  python -m twc_env settings > mine.toml\n"
        "  python -m twc_env reproduce merging\n\nEach command has its own --help. See also "
        "`python -m agents` (scripted teams) and `python -m training` (learning).",
    )
    add_version(parser)
    commands = parser.add_subparsers(required=True, metavar="COMMAND")
    for add in (
        add_maps_parser,
        add_settings_parser,
        add_log_parsers,
        add_bench_parser,
        add_soak_parser,
        add_ocr_parser,
        add_parser,
    ):
        add(commands)
    return parser


if __name__ == "__main__":
    sys.exit(main())
