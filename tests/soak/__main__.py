"""`make soak`: long runs with memory monitoring, malformed input of every kind, observation checks."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import NamedTuple

from twc_env.errors import ActionError, MapError, TwcError
from twc_env.records.json_values import write_json
from twc_env.running.argument_parser import Parser
from twc_env.running.command_line import run_command
from twc_env.running.options import add_json, add_set, assignments, count, natural
from twc_env.running.terminal import show_count, show_line


class Kind(NamedTuple):
    """A kind of malformed input."""

    generator: str
    """MODULE.FUNCTION of tests.soak, which yields attempts for a count and a seed."""
    error: type[TwcError]
    """What may be raised."""
    what: str
    is_long: bool = False
    """Whether each attempt is a command of its own: time, files and processes are not watched, and outcomes are kept
    in the file of --resume."""


KINDS = {
    "actions": Kind(
        "malformed.action_fuzz.broken_steps", ActionError, "malformed actions; a rejected one has no side effects"
    ),
    "maps": Kind("malformed.map_fuzz.mutated_maps", MapError, "mutated map files of all formats"),
    "logs": Kind("malformed.log_fuzz.damaged_logs", TwcError, "damaged laser logs, which are replayed"),
    "bags": Kind("malformed.log_fuzz.damaged_bags", TwcError, "damaged bags of ROS 1 and 2, which are replayed"),
    "tables": Kind("malformed.log_fuzz.damaged_tables", TwcError, "damaged CSV tables of readings beside a sound log"),
    "settings": Kind(
        "malformed.settings_fuzz.malformed_settings", TwcError, "malformed settings: TOML, JSON, run folders"
    ),
    "graphs": Kind("malformed.graph_fuzz.mutated_graphs", TwcError, "mutated pose graphs, which are optimised"),
    "arrays": Kind(
        "malformed.array_fuzz.malformed_arrays", TwcError, "malformed maps that last, frame logs and models"
    ),
    "calls": Kind(
        "malformed.call_fuzz.misused_calls", TwcError, "calls of public functions and methods with odd arguments"
    ),
    "bombs": Kind(
        "malformed.bombs.bombs", TwcError, "files that are huge once unpacked, nest deeply or name files elsewhere"
    ),
    "doors": Kind(
        "malformed.door_fuzz.odd_doors",
        TwcError,
        "odd teams in files, tables in other forms, and finished parts to go on from",
    ),
    "instructions": Kind(
        "same_bytes.episodes", TwcError, "pairs of a task and a set of instructions, whose bytes must be equal", True
    ),
    "accidents": Kind("accidents.accidents", TwcError, "commands that meet kills, full disks and the like", True),
}


def main(arguments: Sequence[str] | None = None) -> int:
    """Run what the options say; the exit status is 2 if there are faults."""
    return run_command(_parser(), arguments)


def _parser() -> argparse.ArgumentParser:
    long = Parser(
        prog="python -m tests.soak",
        description="Run episodes of 500 steps over all tasks, effects and kinds of action; count those that raise, "
        "with the memory, open files and step time of the process. With one of the options that say COUNT, test "
        "malformed input instead: each attempt must succeed or be refused in one line that says what to do, within 2 s "
        "and 1 GB, and touch no file elsewhere. JSON: tried, refused, accepted, wrong; the file keeps other kinds.",
        epilog="examples:\n  python -m tests.soak --steps 100000 --resume runs/soak.jsonl --json soak.json\n"
        "  python -m tests.soak --actions 100000 --maps 10000 --json input.json",
    )
    long.add_argument("--steps", type=count, default=1_000_000, help="total time steps, in whole episodes")
    long.add_argument(
        "--resume",
        type=Path,
        metavar="FILE",
        help="a line per episode of steps or instructions and per accident; a run goes on after the last one there",
    )
    long.add_argument("--observations", type=count, metavar="STEPS", help="random steps whose observations are checked")
    for name, kind in KINDS.items():
        long.add_argument(f"--{name}", type=count, metavar="COUNT", help=f"number of {kind.what}")
    long.add_argument("--seed", type=natural, default=0, help="seed of the first episode")
    add_set(long)
    add_json(long)
    long.set_defaults(run=_soak)
    return long


def _soak(options: argparse.Namespace) -> None:
    asked = {name: getattr(options, name) for name in KINDS if getattr(options, name) is not None}
    figures: dict[str, dict] = {}
    before = _kept(options.json)
    for name, tries in asked.items():
        figures[name] = _tried(name, tries, options)
        write_json(options.json, before | figures)
    if options.observations is not None:
        figures["observations"] = _observed(options.observations, options.seed)
    if not figures:
        figures["steps"] = _long_run(options)
    write_json(options.json, before | figures)
    if faults := [f"{name}: {fault}" for name, own in figures.items() for fault in own["faults"]]:
        raise TwcError("; ".join(faults))


def _kept(file: Path | None) -> dict[str, dict]:
    """Counts of earlier runs in a file."""
    if file is None or not file.is_file():
        return {}
    try:
        figures = json.loads(file.read_text())
    except ValueError:
        return {}
    known = (*KINDS, "observations", "steps")
    return {name: own for name, own in figures.items() if name in known} if isinstance(figures, dict) else {}


def _tried(name: str, tries: int, options: argparse.Namespace) -> dict:
    from tests.soak.attempts import attempt_all

    module, _, function = KINDS[name].generator.rpartition(".")
    generator: Callable[[int, int], Iterator] = getattr(import_module(f"tests.soak.{module}"), function)
    if KINDS[name].is_long:
        generator = partial(generator, kept=options.resume)
    done = attempt_all(
        generator(tries, options.seed),
        KINDS[name].error,
        lambda tried: show_count(tried, tries, f" {name}", every=20),
        is_watched=not KINDS[name].is_long,
    )
    print(
        f"{name}: {done.tried} tried, {done.refused} refused, {done.accepted} accepted, {len(done.wrong)} wrong; "
        f"slowest {done.slowest_s:.2f} s ({done.slowest}); memory grew by {done.grown_mb:.0f} MB"
    )
    return done.figures()


def _observed(steps: int, seed: int) -> dict:
    from tests.soak.observation_check import check_observations

    seen = check_observations(steps, seed, show_count)
    print(f"{seen.steps} random steps, {seen.blocks} blocks checked, {len(seen.faults)} faults")
    if seen.too_short:
        print(f"less than an episode, so constant blocks were not searched for: {'; '.join(seen.too_short)}")
    wrong = len(seen.faults)
    return {"tried": seen.blocks, "refused": 0, "accepted": seen.blocks, "wrong": wrong, "faults": seen.faults}


def _long_run(options: argparse.Namespace) -> dict:
    from tests.soak.long_runs import soak

    figures = soak(options.steps, options.seed, assignments(options.set), options.resume, show_line)
    for key, value in figures.items():
        print(f"{key:<32} {value:,.2f}" if isinstance(value, float) else f"{key:<32} {value}")
    return figures


if __name__ == "__main__":
    sys.exit(main())
