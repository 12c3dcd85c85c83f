"""Command line: twc-env data list | fetch | sample."""

from __future__ import annotations

import argparse
import time
from dataclasses import asdict
from pathlib import Path

from twc_env.records.json_values import check_folder, write_json
from twc_env.running.options import add_json, add_set, assignments, count, natural
from twc_env.running.output_folder import make_folder
from twc_env.running.terminal import aligned, end_line, show_line, terminal_width

KINDS = {"carmen": None, "ros1": ".bag", "mcap": ".mcap", "db3": ".db3"}
"""Kinds of simulated logs, and the suffix of bags."""


def add_arguments(data: argparse.ArgumentParser) -> None:
    """Fill the parser of the command, which has commands of its own."""
    data.description = (
        "Public data sets that tables of `twc-env reproduce` need: list and fetch them; and logs simulated as real "
        "robots record them. Data go below the folder that TWC_DATA names."
    )
    data.epilog = (
        "examples:\n  twc-env data list\n  twc-env data list carmen\n"
        "  TWC_DATA=~/twc-data twc-env data fetch carmen intel\n"
        "  twc-env data sample --kind ros1 --robots 2 --out runs/bag"
    )
    data.set_defaults(run=_list, sets=[], json=None)
    parts = data.add_subparsers(metavar="COMMAND")
    listing = parts.add_parser(
        "list", help="name, licence, size and source of all sets, or the files of given ones",
        description="Name, licence, size and source of all sets, or the files of given ones.", fill=_add_list,
        epilog="examples:\n  twc-env data list\n  twc-env data list houseexpo",
    )  # fmt: skip
    listing.set_defaults(run=_list)
    fetching = parts.add_parser(
        "fetch", help="download sets to their places",
        description="Download sets to their places below TWC_DATA, with a checksum of each file. An interrupted "
        "download goes on where it broke off. Mind the licences: `twc-env data list` tells them.",
        epilog="example:\n  twc-env data fetch carmen intel --out data", fill=_add_fetch,
    )  # fmt: skip
    fetching.set_defaults(run=_fetch)
    sample = parts.add_parser(
        "sample", help="simulate a log as real robots record it",
        description="Simulate robots that wander through a building, and write what real ones would record: a CARMEN "
        "log of each robot or one ROS bag, WiFi and sign readings as tables, and the true paths for evo. The sample of "
        "the package, which `twc-env replay sample` reads, was written by `twc-env data sample --out FOLDER`.",
        epilog="example:\n  twc-env data sample --kind mcap --robots 3 --seed 1 --out runs/bag", fill=_add_sample,
    )  # fmt: skip
    sample.set_defaults(run=_sample)


def _add_list(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("sets", nargs="*", metavar="NAME", help="default: all sets")
    add_json(parser)


def _add_fetch(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("sets", nargs="+", metavar="NAME", help="data sets")
    parser.add_argument("--out", type=Path, metavar="FOLDER", help="folder of the data (default: that in TWC_DATA)")


def _add_sample(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--kind", choices=tuple(KINDS), default="carmen", help="kind of log")
    parser.add_argument("--map", default="twin-01", help="bundled name, generated name or file")
    parser.add_argument("--robots", type=count, default=2, help="number of robots")
    parser.add_argument("--steps", type=count, default=2400, help="time steps of 0.1 s")
    parser.add_argument("--seed", type=natural, default=0, help="of start poses, noise and generated signs")
    add_set(parser)
    parser.add_argument("--out", type=Path, required=True, metavar="FOLDER", help="output folder")


def _list(options: argparse.Namespace) -> None:
    from twc_env.datasets.public.catalogue import catalogue, data_set

    chosen = [data_set(name) for name in options.sets] or list(catalogue().values())
    if not options.sets:
        rows = [
            {"name": each.name, "MB": round(each.bytes / 1e6, 1), "files": len(each.files), "licence": each.licence,
             "tables": ", ".join(each.tables)}
            for each in chosen
        ]  # fmt: skip
        print(aligned(rows, terminal_width()))
        print("\nMB: unpacked. `twc-env data list NAME` tells source and files.")
    for each in chosen if options.sets else ():
        print(f"{each.name}: {each.about}\nlicence: {each.licence}\nsource: {each.source}\n")
        rows = [
            {"file": file.place, "bytes": file.bytes, "sha256": file.sha256[:16], "address": file.url or "by hand"}
            for file in each.files
        ]
        print(aligned(rows, terminal_width()) + "\n")
    write_json(options.json, [{**asdict(each), "bytes": each.bytes} for each in chosen])


def _fetch(options: argparse.Namespace) -> int:
    from twc_env.datasets.public.catalogue import data_set, folder_of_data
    from twc_env.datasets.public.download import fetch

    chosen = [data_set(name) for name in options.sets]
    folder = folder_of_data(options.out)
    check_folder(folder)
    by_hand = []
    for each in chosen:
        print(f"{each.name}: licence: {each.licence}; source: {each.source}")
        for file in each.files:
            if file.url is None and not (folder / file.place).exists():
                by_hand.append(file.place)
                continue
            is_new = fetch(file, folder, _Bar(file.place))
            end_line()
            print(f"  {'fetched' if is_new else 'was there'}: {folder / file.place}")
    if by_hand:
        print("to be got by hand, as no address is known:", *by_hand, sep="\n  ")
    return 1 if by_hand else 0


class _Bar:
    """Progress of one download, with the time left."""

    def __init__(self, name: str):
        self._name, self._begun_s, self._first = name, time.monotonic(), -1

    def __call__(self, done: int, total: int) -> None:
        if self._first < 0:
            self._first = done
        elapsed_s = time.monotonic() - self._begun_s
        rate = max(done - self._first, 1) / max(elapsed_s, 1e-3)
        if total:
            full = 20 * done // total
            left = f", {(total - done) / rate:.0f} s left"
            show_line(f"[{'#' * full}{'-' * (20 - full)}] {done / 1e6:.1f}/{total / 1e6:.1f} MB{left} {self._name}")
        else:
            show_line(f"{done / 1e6:.1f} MB {self._name}")


def _sample(options: argparse.Namespace) -> None:
    from twc_env.config import EnvConfig, override
    from twc_env.replaying.simulated_log import simulate, write_bags, write_carmen

    check_folder(options.out)
    settings = {"map": options.map, "robots": options.robots, "max_cycles": options.steps, "lidar.beam_count": 180}
    asked = assignments(options.set)
    if "lidar.preset" in asked:  # it has beams of its own
        del settings["lidar.beam_count"]
    log = simulate(override(EnvConfig(), {**settings, **asked}), options.seed)
    end_line()
    make_folder(options.out)
    suffix = KINDS[options.kind]
    written = write_carmen(options.out, log) if suffix is None else write_bags(options.out, log, suffix)
    print("written:", *written, sep="\n  ")
