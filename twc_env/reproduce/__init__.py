"""One file per published table: `twc-env reproduce NAME --json FILE` runs it and prints it beside the print.

A table is a line in `runner.TABLES` and a module with `add_arguments(parser)` and `rows(options, runner)`, which gives
the rows as flat dictionaries; `remarks(rows)`, where there is one, gives lines that are printed below the table.
`CHOOSES` names the options that only say which parts are run: with more seeds, the parts that are there are taken
again. `Runner` shows progress and resumes after an interruption.
"""

from twc_env.reproduce.runner import TABLES, Runner, main

__all__ = ["TABLES", "Runner", "main"]
