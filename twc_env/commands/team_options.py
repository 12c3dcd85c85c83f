"""Options, folder names and a remark that the commands of teams share."""

from __future__ import annotations

import argparse
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from twc_env.config import ROBOT_PRESETS, TEAM_PRESETS, EnvConfig, override
from twc_env.errors import ConfigError, DataError
from twc_env.running.options import (
    add_allow_code,
    add_config,
    add_json,
    add_set,
    assignments,
    config_of,
    count,
    refuse_code,
)
from twc_env.running.terminal import tell

if TYPE_CHECKING:
    from twc_env.world.building.floorplan import Floorplan

SETTINGS_OF_OPTIONS = {
    "--map": ("map",),
    "--robots": ("robots", "team"),
    "--steps": ("max_cycles",),
    "--beams": ("lidar.beam_count",),
}
"""Option -> the settings that say the same."""
CUT_OFF_MIN_M2 = 1.0
"""Less floor that robots cannot reach is not worth a remark."""
TEAMS = ("nearest-frontier", "cost-utility", "assignment", "voronoi", "random")


def agents_help() -> str:
    """What an AGENT may be, one line each."""
    from twc_env.agents.roster import TEAMS as teams
    from twc_env.agents.roster import display_name

    lines = [(display_name(name), team.summary) for name, team in teams.items()]
    lines.append(("learned", "the shipped policy that suits task and map best (docs/learning.md, extra train)"))
    lines.append(("FILE.py:CLASS", "your own class, derived from agents.Policy (docs/library.md)"))
    width = max(len(name) for name, _ in lines) + 2
    return "An AGENT is\n" + "".join(f"  {name:<{width}}{summary}\n" for name, summary in lines)


def agent_names() -> str:
    """What may be named as an agent, for help texts."""
    from twc_env.agents.roster import TEAMS as teams

    return ", ".join((*teams, "learned", "FILE.py:CLASS", "or the folder of a run of train"))


def team_config(options: argparse.Namespace, map_name: str | None, steps: int | None) -> EnvConfig:
    """The settings: defaults, then the file or standard task, then the options, then --set."""
    team = "robots" if isinstance(options.robots, int) else "team"
    named = {"map": map_name, team: options.robots, "max_cycles": steps}
    chosen = {key: value for key, value in named.items() if value is not None}
    base, asked = config_of(options.config), assignments(options.set)
    refuse_said_twice(chosen, asked)
    if not options.allow_code:
        refuse_code(base, options.config, asked)
    return override(override(base, chosen), asked)


def refuse_said_twice(chosen: Mapping[str, object], asked: Mapping[str, object]) -> None:
    """Raise DataError where an option and --set name the same thing: one of them would be ignored."""
    for option, keys in SETTINGS_OF_OPTIONS.items():
        given = [f"{option} {chosen[key]}" for key in keys if key in chosen]
        given += [f"--set {key}={asked[key]}" for key in keys if key in asked]
        if len(given) > 1 and not given[0].startswith("--set"):
            raise DataError(f"{' and '.join(given)} name the same setting; leave one of them out")


def tell_unused_starts(map_name: str, plan: Floorplan) -> None:
    """A remark on start poses of a user's own plan, which are not used unless a setting says so."""
    from twc_env.maps import map_names

    if len(plan.starts) and map_name not in map_names():
        tell(f"{map_name}: robots start at random, not at its starts, unless --set episode.starts=map says so")


def tell_cut_off(map_name: str, plan: Floorplan, radius_m: float) -> None:
    """A remark on floor that is scored although robots of this radius cannot drive there from the rest."""
    from twc_env.world.building.generate import cut_off_m2

    if (area_m2 := cut_off_m2(plan, radius_m)) >= CUT_OFF_MIN_M2:
        tell(
            f"{map_name}: {area_m2:.0f} m2 of the floor or more are cut off for robots of {radius_m:g} m radius, by "
            "gaps hardly wider than they are; they are scored all the same"
        )


def folder_name(map_name: str) -> str:
    """A map name as part of a path: the stem of a file, or a generated name without separators."""
    path = Path(map_name)
    return path.stem if path.suffix else map_name.replace("/", "-").replace(":", "-")


def folder_names(maps: Sequence[str]) -> dict[str, str]:
    """A folder name for each map; files of the same name are distinguished by their folders."""
    shared = Counter(folder_name(name) for name in dict.fromkeys(maps))
    return {
        name: folder_name(name) if shared[folder_name(name)] == 1 else re.sub(r"[^\w.-]+", "-", name).strip("-")
        for name in maps
    }


def paragraphs(text: str) -> tuple[str, str]:
    """The first paragraph, as a description, and the rest (examples), as an epilog."""
    description, _, examples = text.partition("\n\n")
    return description, examples


def _robots(text: str) -> int | str:
    """A number of robots, or a mixed team by name or as "handheld,wheeled,legged"."""
    if not any(letter.isalpha() for letter in text):
        return count(text)
    try:
        override(EnvConfig(), {"team": text})
    except ConfigError as error:
        raise argparse.ArgumentTypeError(str(error)) from None
    return text


def add_agent(parser: argparse.ArgumentParser) -> None:
    """Options of commands that run one team."""
    names = f"one of {agent_names()}"
    parser.add_argument("--agent", default="nearest-frontier", help=names)
    parser.add_argument("--no-pictures", action="store_true", help="write neither the map picture nor the film")


def add_team(parser: argparse.ArgumentParser) -> None:
    """Options of all commands of teams: robots, steps, settings, output."""
    teams, kinds = ", ".join(TEAM_PRESETS), ", ".join(ROBOT_PRESETS)
    what = f"number of robots (default: 3), or a mixed team: {teams}, or a list of {kinds}"
    parser.add_argument("--robots", type=_robots, metavar="TEAM", help=what)
    parser.add_argument("--steps", type=count, help="maximum number of steps (default: 2000)")
    add_config(parser)
    add_allow_code(parser)
    add_set(parser)
    add_json(parser)
