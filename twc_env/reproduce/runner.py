"""Shared parts of all tables: progress, resuming after an interruption, printing and writing rows."""

from __future__ import annotations

import argparse
import itertools
import os
import sys
import time
from collections.abc import Callable, Iterable, Sequence
from functools import partial
from importlib import import_module
from pathlib import Path
from types import ModuleType

from twc_env.errors import ConfigError, DataError
from twc_env.records.json_values import TERMINAL, check_folder, plain, write_json
from twc_env.running.command_line import add_folder, add_json, aligned, count, end_line, parse_seeds, show_line
from twc_env.running.finished_parts import FinishedParts
from twc_env.running.worker_processes import in_processes

TABLES = (
    "matching", "ble-lidar", "intel", "merging", "lidar-effects", "lidar-model", "odometry", "ocr", "radio-model",
    "twc-table1", "twc-table2",
    "real-places", "robustness", "solver", "stress", "bare-places", "sfw-table1", "sfw-routers", "sfw-authors",
    "sfw-ble", "sfw-houseexpo", "radio-table1", "radio-scale", "building-axes", "real-radio",
)  # fmt: skip
"""Names on the command line; with _ instead of - the modules of this package."""

_EPILOG = """\
example:
  twc-env reproduce {name} --json runs/{name}.json

An interrupted command continues where it stopped; with more seeds, places or buildings it reuses finished parts.
Tables of real data read the folder in the environment variable TWC_DATA (docs/real_data.md).
"""


class Runner:
    """Runs the parts of a table, keeps finished parts on disk, and reports the progress."""

    def __init__(self, name: str, folder: Path, settings: dict):
        self._parts = FinishedParts(folder, name, settings)
        self._started = time.monotonic()
        if self._parts.remark:
            print(self._parts.remark, file=sys.stderr)
        self.notes: list[str] = []
        """Sentences to print below the rows."""

    def each(
        self, parts: Sequence, work: Callable[..., object], label: Callable[..., str] = str, processes: int = 1
    ) -> list:
        """`work(part)` for every part, in order; parts that an earlier run finished are read from disk.

        Results of `work` must survive JSON; `label` names a part uniquely. With several processes, `work` and the parts
        must be picklable; each process uses one thread.
        """
        labelled = [(label(part), partial(work, part)) for part in parts]
        under_way = iter([name for name, _ in labelled] if processes <= 1 else ())
        results: dict[int, object] = {}
        self.say(f"0/{len(parts)} {next(under_way, '')}")
        for k, result in in_processes(partial(_once, self._parts), labelled, processes):
            results[k] = result
            self.say(f"{len(results)}/{len(parts)} {next(under_way, '')}")
        self.say(f"{len(parts)}/{len(parts)}", is_last=True)
        return [results[k] for k in range(len(parts))]

    def grid(self, kinds: Iterable, seeds: Iterable, work: Callable[..., object], processes: int = 1) -> dict:
        """`work(kind, seed)` for each kind and seed, as `each`: kind -> results of its seeds."""
        parts = list(itertools.product(dict.fromkeys(kinds), seeds))
        found = self.each(parts, partial(_unpacked, work), lambda part: f"{part[0]} seed {part[1]}", processes)
        results: dict = {kind: [] for kind, _ in parts}
        for (kind, _), result in zip(parts, found, strict=True):
            results[kind].append(result)
        return results

    def say(self, text: str, is_last: bool = False) -> None:
        """Show the progress of the table, after the time since the start; see `show_line`."""
        show_line(f"[{time.monotonic() - self._started:5.0f} s] {text}", is_last)


def _once(finished: FinishedParts, labelled: tuple[str, Callable[[], object]]) -> object:
    return finished.once(*labelled)


def _unpacked(work: Callable[..., object], part: tuple) -> object:
    return work(*part)


def data_folder() -> Path:
    """The folder of real data named by the environment variable TWC_DATA; DataError if it is not set."""
    folder = os.environ.get("TWC_DATA")
    if not folder or not Path(folder).is_dir():
        now = f"{folder} is no folder" if folder else "it is not set"
        raise DataError(
            f"this table needs real data: set the environment variable TWC_DATA to its folder ({now}); "
            "docs/real_data.md lists its contents and their sources"
        )
    return Path(folder)


def seeds_argument(text: str) -> list[int]:
    """Type of a seeds argument: a count ("20": 0 to 19), a range ("0-9") or a list ("0-3,7")."""
    try:
        return list(range(count(text)) if text.isdecimal() else parse_seeds(text))
    except (ConfigError, argparse.ArgumentTypeError):
        raise argparse.ArgumentTypeError(f"takes a count like 20, or seeds like 0-9 or 0-3,7; got {text!r}") from None


def add_seeds(parser: argparse.ArgumentParser, default: str, what: str) -> None:
    """The option `--seeds` of a table."""
    help = f"{what}: a count, or seeds like 0-9 or 0-3,7"
    parser.add_argument("--seeds", type=seeds_argument, default=default, help=help)


def chosen(text: str, known: Iterable[str]) -> list[str]:
    """The names in a list like "intel,MIT". Raises ConfigError for an unknown name or an empty list."""
    known, names = list(known), [name.strip() for name in text.split(",") if name.strip()]
    for name in names or [text]:
        if name not in known:
            raise ConfigError(f"unknown choice {name!r}; choose from {','.join(known)}")
    return names


def table_module(name: str) -> ModuleType:
    """The module of one of TABLES, in whichever room it stands."""
    (path,) = Path(__file__).parent.glob(f"*/{name.replace('-', '_')}.py")
    return import_module(f"twc_env.reproduce.{path.parent.name}.{path.stem}")


def add_parser(commands) -> None:
    """The `reproduce` command of `twc-env`."""
    parser = commands.add_parser(
        "reproduce",
        help="reproduce tables of the three papers and our own, beside published values",
        description="Reproduce a table and print it beside the published values. docs/papers.md goes through the "
        "papers item by item. Each table has its own --help.",
        epilog=_EPILOG.format(name="sfw-routers"),
    )
    tables = parser.add_subparsers(required=True, metavar="TABLE")
    for name in TABLES:
        module = table_module(name)
        needs_data = " (needs TWC_DATA)" if hasattr(module, "data_folder") and name != "ocr" else ""
        table = tables.add_parser(
            name,
            help=module.SUMMARY + needs_data,
            description=module.__doc__,
            epilog=_EPILOG.format(name=name),
        )
        module.add_arguments(table)
        add_json(table, ", and pictures beside it" if hasattr(module, "draw") else "")
        add_folder(table, "--cache", "runs/reproduce", "folder of finished parts")
        table.set_defaults(run=lambda options, name=name, module=module: main(name, module, options))


def main(name: str, module, options: argparse.Namespace) -> None:
    """Run one table, print it, write it."""
    changes_no_part = ("run", "json", "cache", "out", "jobs", *getattr(module, "CHOOSES", ()))
    settings = {k: v for k, v in vars(options).items() if k not in changes_no_part}
    check_folder(getattr(options, "out", None))
    runner = Runner(name, options.cache, settings)
    try:
        rows = plain(module.rows(options, runner))
    except KeyboardInterrupt:
        end_line()
        print("finished parts are kept: the same command continues from there", file=sys.stderr)
        raise
    finally:
        end_line()
    print(aligned(rows))
    print("".join(note + "\n" for note in runner.notes), end="")
    for remark in getattr(module, "remarks", lambda _: ())(rows):
        print(remark)
    write_json(options.json, rows)
    if options.json not in (None, TERMINAL):
        paths = getattr(module, "draw", lambda *_: ())(options, runner, options.json.parent)
        end_line()
        print("".join(f"written: {path}\n" for path in paths), end="")
