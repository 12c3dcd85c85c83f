"""`twc-env compare`: several teams in the same buildings."""

from __future__ import annotations

import argparse

from twc_env.commands.team_options import TEAMS, add_team, agent_names, paragraphs, team_config
from twc_env.errors import DataError
from twc_env.records.json_values import TERMINAL, write_json
from twc_env.running.options import add_folder, add_pictures, assignments, count, parse_seeds, picture_options
from twc_env.running.terminal import tell, terminal_width

_COMPARE_HELP = """\
Compare teams in the same buildings from the same start poses: how much sooner than the first team each of the others
has 90 % of the floor in a correctly merged map, with a 95 % confidence interval. Each building has its place in
the list, from 0 on, as its seed; with --seeds every building is played with all of them. Episodes finished by the same
code are reused.
The folder gets compare.json, compare.csv, compare.tex, episodes.csv and coverage.png (coverage over time).

examples:
  twc-env compare --buildings 20 --jobs 2
  twc-env compare --agents nearest-frontier mine.py:Mine --buildings 10 --jobs 2
  twc-env compare --maps twin-02 --seeds 0-4 --agents nearest-frontier minpos
  twc-env compare --agents nearest-frontier radio-frontier --robots 1 --set slam.k_visibility.enabled=true
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Fill the command's parser."""
    parser.description, parser.epilog = paragraphs(_COMPARE_HELP)
    parser.add_argument(
        "--agents",
        nargs="+",
        default=list(TEAMS),
        metavar="AGENT",
        help=f"any of {agent_names()}; the first is the baseline (default: {', '.join(TEAMS)})",
    )
    parser.add_argument(
        "--buildings", type=count, default=10, help="number of buildings, from the start of the test split"
    )
    parser.add_argument("--maps", nargs="+", metavar="MAP", help="names or files, instead of --buildings")
    parser.add_argument(
        "--seeds",
        help="play every building with each of these: numbers and ranges such as 0-4 or 1,4,7-9 (default: the first "
        "building with seed 0, the second with 1, ...)",
    )
    add_folder(parser, "--out", "runs/compare", "folder of finished episodes")
    parser.add_argument("--jobs", type=count, default=1, help="parallel processes")
    parser.add_argument("--no-pictures", action="store_true", help="do not draw coverage over time")
    add_pictures(parser)
    parser.set_defaults(run=_compare)
    add_team(parser)


def _compare(options: argparse.Namespace) -> int:
    from twc_env import load_map
    from twc_env.agents import compare
    from twc_env.world.building.splits import family_of, is_set, split_names

    config = team_config(options, None, options.steps)
    asked = assignments(options.set).get("map")
    if asked is not None and (options.maps or not is_set(str(asked))):
        raise DataError(f"--set map={asked}: compare plays the buildings named by --maps; use that")
    tested = split_names("test", family_of(config.map))
    if not options.maps and options.buildings > len(tested):
        raise DataError(f"the split test has {len(tested)} buildings; got --buildings {options.buildings}")
    maps = options.maps or tested[: options.buildings]
    seeds = None if options.seeds is None else parse_seeds(options.seeds)
    if seeds is not None and len(set(maps)) < len(maps):
        raise DataError(f"--maps names {max(maps, key=maps.count)} twice; with --seeds name it once")
    for name in maps:
        load_map(name)
    found = compare.compare(config, maps, options.agents, options.out, options.jobs, tell, seeds)
    write_json(options.json, compare.as_json(found))
    if options.json != TERMINAL:
        print(compare.table_of(found, terminal_width()))
    for path in compare.write_tables(found, maps, config, options.out, picture_options(options), seeds):
        tell(f"written: {path}")
    return 0
