"""`make soak`: long runs with memory monitoring, malformed actions, maps and logs, observation checks."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence

from twc_env.errors import TwcError
from twc_env.records.json_values import write_json
from twc_env.running.command_line import (
    Parser,
    add_json,
    add_set,
    assignments,
    count,
    natural,
    run_command,
    show_count,
    show_line,
)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run what the options say; the exit status is 2 if there are faults."""
    return run_command(_parser(), arguments)


def _parser() -> argparse.ArgumentParser:
    long = Parser(
        prog="python -m tests.soak",
        description="Run episodes of 500 steps, each in another building of the training split, with robots driven by "
        "a reactive policy, and print the memory growth after a warm-up. An exception ends the run and names the "
        "seed of its episode. With --actions, --observations, --maps, --logs or --graphs, run these tests instead.",
        epilog="examples:\n  python -m tests.soak --steps 100000 --set observation.kind=flat\n"
        "  python -m tests.soak --actions 100000 --observations 10000 --maps 10000",
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
    long.add_argument(
        "--maps",
        type=count,
        metavar="COUNT",
        help="number of mutated map files; each must load or be rejected in one line",
    )
    long.add_argument(
        "--logs",
        type=count,
        metavar="COUNT",
        help="number of damaged bags, tables and laser logs; each must be replayed or be rejected in one line",
    )
    long.add_argument(
        "--graphs",
        type=count,
        metavar="COUNT",
        help="number of mutated pose graphs; each must be optimised or rejected in one line",
    )
    long.add_argument("--seed", type=natural, default=0, help="seed of the first episode")
    add_set(long)
    add_json(long)
    long.set_defaults(run=_soak)
    return long


def _soak(options: argparse.Namespace) -> None:
    long_tests = (options.actions, options.observations, options.maps, options.logs, options.graphs)
    if any(each is not None for each in long_tests):
        _misuse(options)
        return
    from tests.soak.long_runs import soak
    from twc_env.config import EnvConfig, override

    config = override(EnvConfig(), assignments(options.set))
    figures = soak(options.steps, options.seed, config, show_line)
    for key, value in figures.items():
        print(f"{key:<28} {value:,.1f}" if isinstance(value, float) else f"{key:<28} {value}")
    write_json(options.json, figures)


def _misuse(options: argparse.Namespace) -> None:
    """Run the tests of malformed actions and of observations. Raises TwcError with the faults found."""
    from tests.soak.action_fuzz import fuzz_actions
    from tests.soak.observation_check import check_observations

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
    if options.maps is not None:
        faults += _mutated_maps(options.maps, options.seed, figures)
    if options.logs is not None:
        faults += _damaged_logs(options.logs, options.seed, figures)
    if options.graphs is not None:
        faults += _mutated_graphs(options.graphs, options.seed, figures)
    write_json(options.json, figures)
    if faults:
        raise TwcError("; ".join(faults))


def _mutated_maps(files: int, seed: int, figures: dict[str, object]) -> list[str]:
    from tests.soak.map_fuzz import MEMORY_MAX_MB, SECONDS_MAX, fuzz_maps

    report = fuzz_maps(files, seed)
    print(
        f"{report.count} mutated files: {report.refused} refused, {report.loaded} still sound, "
        f"{len(report.escaped)} raised something else; slowest {report.slowest_s:.3f} s ({report.slowest}); "
        f"peak memory grew by {report.grown_mb:.0f} MB"
    )
    figures["maps"] = {name: getattr(report, name) for name in report.__slots__}
    faults = list(report.escaped)
    if report.slowest_s > SECONDS_MAX:
        faults.append(f"{report.slowest} took {report.slowest_s:.1f} s, more than {SECONDS_MAX:g} s")
    if report.grown_mb > MEMORY_MAX_MB:
        faults.append(f"memory grew by {report.grown_mb:.0f} MB, more than {MEMORY_MAX_MB:g} MB")
    return faults


def _damaged_logs(files: int, seed: int, figures: dict[str, object]) -> list[str]:
    from tests.soak.log_fuzz import SECONDS_MAX, fuzz_logs

    report = fuzz_logs(files, seed)
    print(
        f"{report.count} damaged logs: {report.refused} refused, {report.loaded} replayed, {len(report.escaped)} "
        f"raised something else; slowest {report.slowest_s:.1f} s ({report.slowest})"
    )
    figures["logs"] = {name: getattr(report, name) for name in report.__slots__}
    slow = report.slowest_s > SECONDS_MAX
    return report.escaped + ([f"{report.slowest} took {report.slowest_s:.0f} s"] if slow else [])


def _mutated_graphs(files: int, seed: int, figures: dict[str, object]) -> list[str]:
    from tests.soak.graph_fuzz import SECONDS_MAX, fuzz_graphs

    report = fuzz_graphs(files, seed, show_count)
    print(
        f"{report.count} mutated pose graphs: {report.refused} refused, {report.optimised} optimised, of which "
        f"{report.lost} are reported as lost, {len(report.escaped)} raised something else; slowest "
        f"{report.slowest_s:.2f} s ({report.slowest})"
    )
    figures["graphs"] = {name: getattr(report, name) for name in report.__slots__}
    slow = [f"{report.slowest} took more than {SECONDS_MAX:g} s"] if report.slowest_s > SECONDS_MAX else []
    return list(report.escaped) + slow


if __name__ == "__main__":
    sys.exit(main())
