"""`python -m twc_env settings`."""

from __future__ import annotations

import argparse
from pathlib import Path

from twc_env.command_line import add_set, assignments


def add_settings_parser(commands: argparse._SubParsersAction) -> None:
    """Arguments of the command."""
    parser = commands.add_parser(
        "settings",
        help="print every setting with its meaning, range and value, as a TOML file to start from",
        description="Print settings as commented TOML; values that differ from the default are marked. The output is "
        "a config file: save it, edit it, and pass it to --config or twc_env.config.load.",
        epilog="examples:\n  python -m twc_env settings lidar slam.keyframe\n"
        "  python -m twc_env settings --task twc/ExploreHard-v0 > hard.toml",
    )
    parser.add_argument("sections", nargs="*", metavar="SECTION", help="print only these, e.g. radio or slam.merging")
    parser.add_argument("--task", metavar="ID", help="start from a standard task")
    parser.add_argument("--config", type=Path, metavar="FILE", help="start from a TOML or JSON file")
    add_set(parser)
    parser.set_defaults(run=_print)


def _print(options: argparse.Namespace) -> None:
    from twc_env.config import EnvConfig, load, override
    from twc_env.config.manual import as_toml
    from twc_env.errors import ConfigError
    from twc_env.tasks import task_config

    if options.task is not None and options.config is not None:
        raise ConfigError("settings begin with a task or with a file, not with both: leave out --task or --config")
    config = EnvConfig()
    if options.task is not None:
        config = task_config(options.task)
    if options.config is not None:
        config = load(options.config)
    print(as_toml(override(config, assignments(options.set)), options.sections), end="")
