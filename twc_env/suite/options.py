"""Options of `twc-env benchmark --suite`: all teams on all tasks of a suite, and their leaderboard."""

from __future__ import annotations

import argparse

from twc_env.errors import ConfigError
from twc_env.records.json_values import TERMINAL, check_folder, write_json
from twc_env.running.options import add_ray, count, picture_options, refuse_jobs_with_ray
from twc_env.running.terminal import tell, terminal_width
from twc_env.tasks import SUITES

SUITE_HELP = """\
With --suite: play every team on every task of a suite, in buildings that no team was trained in, and write a
leaderboard: leaderboard.json, .csv, .md, .tex and .html, curves.png and profiles.png. The score of a team is 0 for the
random team and 1 for the informed one, which both always play. Finished episodes are kept in the output folder, so the
same command continues where it stopped, also with other teams or more buildings.
"""
SUITE_EXAMPLES = """\
  twc-env benchmark --suite v1 --buildings 10 --jobs 4 --out runs/v1
  twc-env benchmark --suite v1 --tasks ExploreOffice-v1 --agents nearest-frontier mine.py:Mine runs/ppo
  twc-env benchmark --suite v1 --buildings 100 --ray auto
"""
_SPLITS = ("train", "validation", "test", "fresh")
_ONLY_WITH_SUITE = {"tasks": None, "agents": None, "split": "test", "buildings": 10, "ray": None}
_ONLY_WITHOUT = {
    "maps": ["twin-01", "twin-02"], "seeds": "0-9", "agent": "nearest-frontier", "robots": None, "steps": None,
    "config": None, "set": [],
}  # fmt: skip


def add_suite_options(parser: argparse.ArgumentParser) -> None:
    """The options of `benchmark` that belong to --suite."""
    group = parser.add_argument_group("suites")
    group.add_argument("--suite", choices=SUITES, help="play the tasks of this suite")
    group.add_argument("--tasks", nargs="+", metavar="TASK", help="only these, such as ExploreOffice-v1 (default: all)")
    group.add_argument(
        "--agents",
        nargs="+",
        metavar="AGENT",
        help="teams: names, FILE.py:CLASS, run folders or files of trained models, learned (default: all scripted)",
    )
    group.add_argument(
        "--split",
        choices=_SPLITS,
        default="test",
        help="buildings; use validation for tuning, fresh for claims about what nobody has looked at",
    )
    group.add_argument("--buildings", type=count, default=10, help="buildings per task, from the start of the split")
    add_ray(group)


def check_options(options: argparse.Namespace) -> None:
    """Raise ConfigError for options of `benchmark` that exclude each other."""
    for name, default in _ONLY_WITHOUT.items() if options.suite else _ONLY_WITH_SUITE.items():
        if getattr(options, name) != default:
            remedy = "a suite has fixed settings: leave it out" if options.suite else "it needs --suite v1"
            if name == "agents" and not options.suite:
                remedy += "; without a suite, --agent names one team and twc-env compare plays several"
            raise ConfigError(f"--{name} {_shown(getattr(options, name))}: {remedy}")
    refuse_jobs_with_ray(options)


def _shown(value: object) -> str:
    return " ".join(map(str, value)) if isinstance(value, list) else str(value)


def run_suite(options: argparse.Namespace) -> int:
    """Play the suite and write its leaderboard."""
    from twc_env.agents import picture, policy_names
    from twc_env.suite.entries import SPECIAL, entries, suite_tasks, with_references
    from twc_env.suite.leaderboard import Origin, raw_remark, rows_as_json, write_leaderboard
    from twc_env.suite.runs import play_all
    from twc_env.suite.standings import standings_of
    from twc_env.suite.tables import text_of

    if not options.no_pictures:
        picture.require_libraries(gif=False)
    check_folder(options.out)
    known = policy_names()
    teams = with_references(options.agents or [name for name in known if name not in SPECIAL], known)
    tasks = suite_tasks(options.suite, options.tasks)
    planned = entries(tasks, teams, options.split, options.buildings)
    values = play_all(planned, options.out / "episodes", options.jobs, options.ray, tell)
    standings = standings_of(planned, values)
    origin = Origin(options.suite, options.split, options.buildings)
    for path in write_leaderboard(standings, origin, planned, options.out, picture_options(options)):
        tell(f"written: {path}")
    write_json(options.json, rows_as_json(standings))
    if options.json != TERMINAL:
        print(text_of(standings, terminal_width()))
    if not standings.is_normalised:
        tell(raw_remark(standings))
    return 0
