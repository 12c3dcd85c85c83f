"""`twc-env settings`."""

from __future__ import annotations

import argparse
from pathlib import Path

from twc_env.records.json_values import check_writable
from twc_env.records.whole_file import write_text
from twc_env.running.options import add_config, add_set, assignments, config_of
from twc_env.running.terminal import tell


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Fill the command's parser."""
    parser.description = (
        "Print settings as TOML with comments: those that have their default are commented out, the others are "
        "marked. The output is a config file: save it, take the # away from what you change, and pass it to --config "
        "or twc_env.config.load."
    )
    parser.epilog = (
        "examples:\n  twc-env settings lidar slam.keyframe\n"
        "  twc-env settings world     what worlds there are, and what each sets\n"
        "  twc-env settings --config twc/ExploreHard-v0 --out hard.toml"
    )
    parser.add_argument(
        "sections",
        nargs="*",
        metavar="SECTION",
        help="print only these, e.g. radio or slam.merging; world, team and robot explain presets",
    )
    add_config(parser)
    add_set(parser)
    parser.add_argument("--out", type=Path, metavar="FILE.toml", help="write them to a file instead")
    parser.set_defaults(run=_print)


def _print(options: argparse.Namespace) -> None:
    from twc_env.config import override
    from twc_env.config.manual import as_toml

    text = as_toml(override(config_of(options.config), assignments(options.set)), options.sections)
    if options.out is None:
        print(text, end="")
        return
    check_writable(options.out)
    tell(f"written: {write_text(options.out, text)}")
