"""Shared parts of all tables: progress, resuming after an interruption, printing and writing rows."""

from __future__ import annotations

import argparse
import itertools
import os
import time
from collections.abc import Callable, Iterable, Sequence
from functools import partial
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple

from twc_env.errors import ConfigError, DataError, one_of
from twc_env.pictures.style import style
from twc_env.processes.worker_processes import in_processes
from twc_env.records.json_values import TERMINAL, check_folder, plain, write_json
from twc_env.running.command_start import is_interruption
from twc_env.running.finished_parts import FinishedParts
from twc_env.running.options import parse_seeds
from twc_env.running.terminal import aligned, end_line, show_line, tell, terminal_width


class Table(NamedTuple):
    """A table in the list of tables."""

    summary: str
    needs_data: bool = False
    """Whether it reads TWC_DATA."""


TABLES = {
    "generalisation": Table(
        "every claim on a set that no setting was chosen on, beside its trivial answer: {claim, set, shown, elsewhere,"
        " trivial}",
        needs_data=True,
    ),
    "matching": Table("time and success rate of verifying one loop candidate, with an initial guess and without"),
    "ble-lidar": Table("radio and LiDAR on real drives through a flat: trajectory and map", needs_data=True),
    "intel": Table(
        "the Intel Lab log from raw odometry to a map: one robot, and split into three that merge by geometry",
        needs_data=True,
    ),
    "merging": Table("map merging from unknown start frames in 100 unseen generated buildings"),
    "sessions": Table(
        "a second session in the map of the first, furniture moved and doors shut; ten sessions in one building"
    ),
    "localisation": Table(
        "five laser logs: the first half maps, the second half is localised in that map", needs_data=True
    ),
    "lidar-model": Table(
        "the scanner model against five real laser logs: noise, lost returns, points off the map, change",
        needs_data=True,
    ),
    "lidar-effects": Table("cost of each limit and error of laser scanners, and of the presets, one at a time"),
    "odometry": Table(
        "raw odometry of the Intel Lab log against the simulated platform, at the same relations", needs_data=True
    ),
    "ocr": Table("misread signs: the fast model against a real OCR on held-out signs"),
    "radio-model": Table(
        "path loss, walls, detection, noise and similarity of the radio model against real surveys", needs_data=True
    ),
    "twc-table1": Table("TWC-SLAM Table I: precision and recall of text, WiFi, both, laser and all cues fused"),
    "twc-table2": Table(
        "TWC-SLAM Table II: errors of the maps by text, WiFi, both, laser and all cues fused, by back end"
    ),
    "real-places": Table(
        "same place within 5 m on two real floors: text, WiFi, both, and all cues fused", needs_data=True
    ),
    "saved-maps": Table(
        "saved maps merged without initial guess: 100 pairs that overlap, and 50 that must not merge", needs_data=True
    ),
    "robustness": Table("back ends against false closures on public pose graphs", needs_data=True),
    "solver": Table("our pose-graph solver against gtsam's, on public graphs from odometry", needs_data=True),
    "stress": Table(
        "the engine without signs, WiFi, link or a robot; odd receiver, repeated sign texts, worse or no laser"
    ),
    "bare-places": Table(
        "merging in scenes with little geometry: bare corridors, and a hall larger than the laser range"
    ),
    "ambiguity": Table(
        "merging where places look alike: teams merged rightly, wrongly and not at all, in buildings of eight kinds"
    ),
    "ablation": Table(
        "learners without teammates, signs, map, attention or a privileged critic, and ppo beside mappo, in one task"
    ),
    "transfer": Table(
        "a trained policy with other numbers of robots, in flats of HouseExpo and on ROS maps, beside scripted teams",
        needs_data=True,
    ),
    "reality": Table(
        "what each effect of reality costs: people, carried robots, poor scanners, drifting odometry, weak links"
    ),
    "mixed": Table("mixed teams, the paper's own (handheld, wheeled, legged) or others, in twins of its two scenes"),
    "odometry-noise": Table(
        "laser logs with odometry errors of several sizes, while the engine assumes the same noise", needs_data=True
    ),
    "sfw-table1": Table(
        "inverse k-visibility Table I: number of walls crossed, and maps of six plans, from signal strength"
    ),
    "sfw-routers": Table("router positions estimated from signal strength alone, in the k-visibility twins"),
    "sfw-active": Table("wall maps from WiFi alone over path length: active path planning and wall following"),
    "sfw-authors": Table("inverse k-visibility on the authors' own logs, with the registration fit", needs_data=True),
    "sfw-ble": Table("number of walls crossed in a real flat with six BLE transmitters", needs_data=True),
    "sfw-houseexpo": Table(
        "structure from WiFi on HouseExpo plans, route along all walls, with a reliability diagram", needs_data=True
    ),
    "radio-table1": Table("radio SLAM in twins of its three environments: WiFi, LTE, WiFi with laser"),
    "radio-scale": Table("radio SLAM over ten kilometres: memory and time per scan; search among 100,000 fingerprints"),
    "real-radio": Table("real phone walks joined by WiFi alone, and a robot's floor with added drift", needs_data=True),
}
"""By the name on the command line; with _ instead of - a module in one of the rooms of this package, imported only if
it is asked for."""


class Runner:
    """Runs the parts of a table, keeps finished parts on disk, and reports the progress."""

    def __init__(self, name: str, folder: Path, settings: dict, packages: tuple[str, ...] = ()):
        """packages: whose code finished parts depend on, besides that of twc_env."""
        self._parts = FinishedParts(folder, name, settings, packages)
        self._started = time.monotonic()
        if self._parts.remark:
            tell(self._parts.remark)
        self.notes: list[str] = []
        """Sentences to print below the rows."""

    @property
    def folder(self) -> Path:
        """Where finished parts are kept, of these settings and this code; parts may keep more in folders of it."""
        return self._parts.folder

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

    def grid(
        self, kinds: Iterable, seeds: Iterable, work: Callable[..., object], processes: int = 1, what: str = "seed"
    ) -> dict:
        """`work(kind, seed)` for each kind and seed, as `each`: kind -> results of its seeds; `what` names a seed."""
        parts = list(itertools.product(dict.fromkeys(kinds), seeds))
        found = self.each(parts, partial(_unpacked, work), lambda part: f"{part[0]} {what} {part[1]}", processes)
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
    """Type of a seeds argument, as of all commands: numbers and ranges such as "0-9" or "0-3,7"."""
    try:
        return list(parse_seeds(text))
    except ConfigError as error:
        raise argparse.ArgumentTypeError(str(error)) from None


def add_seeds(parser: argparse.ArgumentParser, default: str, what: str) -> None:
    """The option `--seeds` of a table."""
    help = f"{what}: numbers and ranges such as 0-9 or 0-3,7"
    parser.add_argument("--seeds", type=seeds_argument, default=default, help=help)


class _Some(argparse.Action):
    """Known names, as words or in lists like "intel,MIT"; a leading #, which begins a comment in a shell, may lack."""

    def __call__(self, parser: argparse.ArgumentParser, namespace: argparse.Namespace, values: Any, *_: Any) -> None:
        """Store the names. Raises ArgumentError for an unknown one."""
        known = {name.removeprefix("#"): name for name in self.default} | {name: name for name in self.default}
        words = [word.strip() for value in values for word in ([value] if value in known else value.split(","))]
        for word in filter(None, words):
            if word not in known:
                among = one_of(word, self.default, "choose from")
                raise argparse.ArgumentError(self, f"unknown choice {word!r}{among}")
        names = list(dict.fromkeys(known[word] for word in words if word)) or self.default
        setattr(namespace, self.dest, names)


def add_some(parser: argparse.ArgumentParser, option: str, known: Iterable[str], what: str) -> None:
    """An option that takes some of the known names; all if it is not given."""
    names = list(known)
    shown = f"{what}: any of {'; '.join(names)}; one with spaces in quotes (default: all)"
    if not any(" " in name for name in names):
        shown = f"{what}: any of {', '.join(names)} (default: all)"
    text = shown.replace("%", "%%")
    parser.add_argument(option, nargs="+", action=_Some, default=names, metavar="NAME", help=text)


def table_module(name: str) -> ModuleType:
    """The module of one of TABLES, in whichever room it stands."""
    (path,) = Path(__file__).parent.glob(f"*/{name.replace('-', '_')}.py")
    return import_module(f"twc_env.reproduce.{path.parent.name}.{path.stem}")


def main(name: str, module, options: argparse.Namespace) -> None:
    """Run one table, print it, write it."""
    changes_no_part = ["run", "json", "cache", "out", "jobs", "quiet", "verbose", *getattr(module, "CHOOSES", ())]
    if hasattr(module, "draw"):  # afterwards, not within the parts
        changes_no_part += ["format", "dpi"]
    settings = {k: v for k, v in vars(options).items() if k not in changes_no_part}
    check_folder(getattr(options, "out", None))
    runner = Runner(name, options.cache, settings, getattr(module, "PACKAGES", ()))
    try:
        rows = plain(module.rows(options, runner))
    except BaseException as error:
        if is_interruption(error):
            tell("finished parts are kept: the same command continues from there")
        raise
    finally:
        end_line()
    print(aligned(rows, terminal_width()))
    print("".join(note + "\n" for note in runner.notes), end="")
    for remark in getattr(module, "remarks", lambda _: ())(rows):
        print(remark)
    write_json(options.json, rows)
    if options.json not in (None, TERMINAL):
        paths: list[Path] = []
        if hasattr(module, "draw"):
            with style():
                paths = module.draw(options, runner, options.json.parent)
        end_line()
        print("".join(f"written: {path}\n" for path in paths), end="")
