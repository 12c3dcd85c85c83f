# PYTHON_ARGCOMPLETE_OK
"""The command `twc-env`; `twc-env` is the same."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence

import argcomplete

from twc_env.commands.bench import add_bench_parser
from twc_env.commands.benchmark import add_benchmark_parser
from twc_env.commands.compare import add_compare_parser
from twc_env.commands.evaluate import add_evaluate_parser
from twc_env.commands.explore import add_explore_parser
from twc_env.commands.logs import add_log_parsers
from twc_env.commands.maps import add_maps_parser
from twc_env.commands.ocr import add_ocr_parser
from twc_env.commands.radio_survey import add_radio_survey_parser
from twc_env.commands.settings import add_settings_parser
from twc_env.commands.team_options import agents_help
from twc_env.commands.train import add_train_parser
from twc_env.reproduce.runner import add_parser
from twc_env.running.command_line import Parser, add_version, run_command


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command; the exit status is 0 when done, 2 after bad input (one line on stderr), 130 when interrupted."""
    parser = _parser()
    argcomplete.autocomplete(parser)
    return run_command(parser, arguments)


def _parser() -> argparse.ArgumentParser:
    parser = Parser(
        prog="twc-env",
        description="Teams of robots that explore buildings while a cooperative SLAM engine maps them. Each command "
        "has its own --help.",
        epilog="examples:\n  twc-env explore --map twin-01 --out runs/mine\n  twc-env compare --buildings 20 --jobs 2\n"
        "  twc-env maps show twin-01\n  twc-env settings > mine.toml\n\n" + agents_help(),
    )
    add_version(parser)
    commands = parser.add_subparsers(required=True, metavar="COMMAND")
    for add in (
        add_explore_parser,
        add_compare_parser,
        add_benchmark_parser,
        add_train_parser,
        add_evaluate_parser,
        add_radio_survey_parser,
        add_maps_parser,
        add_settings_parser,
        add_log_parsers,
        add_bench_parser,
        add_ocr_parser,
        add_parser,
    ):
        add(commands)
    return parser


if __name__ == "__main__":
    sys.exit(main())
