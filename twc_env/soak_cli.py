"""`python -m twc_env soak`."""

from __future__ import annotations

import argparse
from pathlib import Path

from twc_env.command_line import add_set, assignments, count, natural, show_count, show_line
from twc_env.errors import TwcError
from twc_env.json_values import write_json


def add_soak_parser(commands: argparse._SubParsersAction) -> None:
    """Arguments of the command."""
    long = commands.add_parser(
        "soak",
        help="play for very long in changing buildings and watch memory; misuse it; check what it shows",
        description="Robots wander by reflex through episodes of 500 steps, each in another building of the training "
        "split. Prints what memory did after a warm-up; an exception ends it with the seed of its episode. With "
        "--actions or --observations, that is done instead.",
        epilog="examples:\n  python -m twc_env soak --steps 100000 --set observation.kind=flat\n"
        "  python -m twc_env soak --actions 100000 --observations 10000",
    )
    long.add_argument(
        "--steps", type=count, default=1_000_000, help="time steps in all, in whole episodes (default: %(default)s)"
    )
    long.add_argument(
        "--actions",
        type=count,
        metavar="COUNT",
        help="throw so many broken actions; each must be refused and leave no mark",
    )
    long.add_argument(
        "--observations",
        type=count,
        metavar="STEPS",
        help="random steps of all kinds of action, all blocks on: in their spaces, never constant, no shared memory",
    )
    long.add_argument("--seed", type=natural, default=0, help="of the first episode (default: %(default)s)")
    add_set(long)
    long.add_argument("--json", type=Path, metavar="FILE", help="write the figures as one flat object")
    long.set_defaults(run=_soak)


def _soak(options: argparse.Namespace) -> None:
    if options.actions is not None or options.observations is not None:
        _misuse(options)
        return
    from twc_env.config import EnvConfig, override
    from twc_env.soak import soak

    config = override(EnvConfig(), assignments(options.set))
    figures = soak(options.steps, options.seed, config, show_line)
    for key, value in figures.items():
        print(f"{key:<28} {value:,.1f}" if isinstance(value, float) else f"{key:<28} {value}")
    write_json(options.json, figures)


def _misuse(options: argparse.Namespace) -> None:
    """Broken actions and a long look at observations. Raises TwcError with what was found."""
    from twc_env.action_fuzz import fuzz_actions
    from twc_env.observation_check import check_observations

    figures: dict[str, object] = {}
    faults: list[str] = []
    if options.actions is not None:
        thrown = fuzz_actions(options.actions, options.seed, show_count)
        print(
            f"{thrown.count} broken actions: {thrown.refused} refused, {thrown.accepted} sound after all, "
            f"{len(thrown.escaped)} raised something else; {thrown.steps_compared} steps equal to those of a team "
            "that was spared them" + (f", but for {thrown.changed}" if thrown.changed else "")
        )
        faults += thrown.escaped[:5] + [f"refused actions of kind {kind} left a mark" for kind in thrown.changed]
        figures["actions"] = {name: getattr(thrown, name) for name in thrown.__slots__}
    if options.observations is not None:
        seen = check_observations(options.observations, options.seed, show_count)
        print(f"{seen.steps} random steps, {seen.blocks} blocks looked at, {len(seen.faults)} faults")
        faults += seen.faults
        figures["observations"] = {name: getattr(seen, name) for name in seen.__slots__}
    write_json(options.json, figures)
    if faults:
        raise TwcError("; ".join(faults))
