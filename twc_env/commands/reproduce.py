"""`twc-env reproduce`: the tables of the papers and our own."""

from __future__ import annotations

import argparse
from functools import partial

from twc_env.running.options import add_folder, add_json, add_pictures

_EPILOG = """\
example:
  twc-env reproduce {name} --json runs/{name}.json

An interrupted command continues where it stopped; with more seeds, places or buildings it reuses finished parts.
Tables of real data read the folder in the environment variable TWC_DATA (docs/real_data.md).
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Fill the parser of the command, which has one command per table."""
    from twc_env.reproduce.runner import TABLES

    parser.description = (
        "Reproduce a table and print it beside the published values. docs/papers.md goes through the papers item by "
        "item. Each table has its own --help."
    )
    parser.epilog = _EPILOG.format(name="sfw-routers")
    tables = parser.add_subparsers(required=True, metavar="TABLE")
    for name, table in TABLES.items():
        needs = " (needs TWC_DATA)" if table.needs_data else ""
        tables.add_parser(name, help=table.summary + needs, fill=partial(_add_table, name))


def _add_table(name: str, parser: argparse.ArgumentParser) -> None:
    from twc_env.reproduce.runner import main, table_module

    module = table_module(name)
    parser.description, parser.epilog = module.__doc__, _EPILOG.format(name=name)
    module.add_arguments(parser)
    add_json(parser, ", and pictures beside it" if hasattr(module, "draw") else "")
    if hasattr(module, "draw"):
        add_pictures(parser)
    add_folder(parser, "--cache", "runs/reproduce", "folder of finished parts")
    parser.set_defaults(run=partial(main, name, module))
