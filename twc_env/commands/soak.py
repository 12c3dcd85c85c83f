"""`twc-env soak`."""

from __future__ import annotations

import argparse

from twc_env.errors import TwcError
from twc_env.records.json_values import write_json
from twc_env.running.command_line import add_json, add_set, assignments, count, natural, show_count, show_line


def add_soak_parser(commands: argparse._SubParsersAction) -> None:
    """Arguments of the command."""
    long = commands.add_parser(
        "soak",
        help="stress tests: long runs with memory monitoring, malformed actions, observation checks",
        description="Run episodes of 500 steps, each in another building of the training split, with robots driven by "
        "a reactive policy, and print the memory growth after a warm-up. An exception ends the run and names the "
        "seed of its episode. With --actions or --observations, run these tests instead.",
        epilog="examples:\n  twc-env soak --steps 100000 --set observation.kind=flat\n"
        "  twc-env soak --actions 100000 --observations 10000",
    )
    long.add_argument("--steps", type=count, default=1_000_000, help="total time steps, in whole episodes")
    long.add_argument(
        "--actions",
        type=count,
        metavar="COUNT",
        help="number of malformed actions; each must be rejected without side effects",
    )
    long.add_argument(
        "--observations",
        type=count,
        metavar="STEPS",
        help="number of random steps, with all kinds of action and all blocks, in which observations are checked: "
        "inside their spaces, no shared memory, not constant over a whole episode",
    )
    long.add_argument("--seed", type=natural, default=0, help="seed of the first episode")
    add_set(long)
    add_json(long)
    long.set_defaults(run=_soak)


def _soak(options: argparse.Namespace) -> None:
    if options.actions is not None or options.observations is not None:
        _misuse(options)
        return
    from twc_env.config import EnvConfig, override
    from twc_env.soak.long_runs import soak

    config = override(EnvConfig(), assignments(options.set))
    figures = soak(options.steps, options.seed, config, show_line)
    for key, value in figures.items():
        print(f"{key:<28} {value:,.1f}" if isinstance(value, float) else f"{key:<28} {value}")
    write_json(options.json, figures)


def _misuse(options: argparse.Namespace) -> None:
    """Run the tests of malformed actions and of observations. Raises TwcError with the faults found."""
    from twc_env.soak.action_fuzz import fuzz_actions
    from twc_env.soak.observation_check import check_observations

    figures: dict[str, object] = {}
    faults: list[str] = []
    if options.actions is not None:
        thrown = fuzz_actions(options.actions, options.seed, show_count)
        print(
            f"{thrown.count} malformed actions: {thrown.refused} rejected, {thrown.accepted} valid after all, "
            f"{len(thrown.escaped)} raised something else; {thrown.steps_compared} steps equal to those of a team "
            "without them" + (f", but for {thrown.changed}" if thrown.changed else "")
        )
        faults += thrown.escaped[:5] + [f"rejected {kind} actions changed the episode" for kind in thrown.changed]
        figures["actions"] = {name: getattr(thrown, name) for name in thrown.__slots__}
    if options.observations is not None:
        seen = check_observations(options.observations, options.seed, show_count)
        print(f"{seen.steps} random steps, {seen.blocks} blocks checked, {len(seen.faults)} faults")
        if seen.too_short:
            print(f"less than an episode, so constant blocks were not searched for: {'; '.join(seen.too_short)}")
        faults += seen.faults
        figures["observations"] = {name: getattr(seen, name) for name in seen.__slots__}
    write_json(options.json, figures)
    if faults:
        raise TwcError("; ".join(faults))
