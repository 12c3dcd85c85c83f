"""Generalisation of a trained policy: other numbers of robots, and buildings of other kinds than in its training.

Each kind is played by the policy (`--model`, by default the shipped one of ExploreQuick-v1) and by scripted teams, in
the same buildings with the same seeds and the settings of the task. `mean_coverage` is the floor that is mapped
correctly, averaged over the time of an episode; `lead` that of the policy over the team, with its 95 % interval over
buildings.

- 2, 3, 5, 8 robots: test buildings of ExploreQuick-v1; the shipped policy was trained with 3
- flats: of HouseExpo, the largest 20 first, 3 robots, 2,000 time steps
- floors: ROS maps of real floors, 3 robots, 2,000 time steps
- ipa floors: the maps of real floors of ipa's collection, 3 robots, 2,000 time steps
"""

from __future__ import annotations

import argparse
import csv

from twc_env.config import EnvConfig, override
from twc_env.metrics.team_scores import mean_interval
from twc_env.reproduce.runner import Runner, add_some, data_folder
from twc_env.running.options import count
from twc_env.suite.entries import Entry
from twc_env.suite.player import play
from twc_env.suite.standings import budget_areas
from twc_env.tasks import task_config
from twc_env.world.building.splits import family_of, split_names

PACKAGES = ("twc_env.agents", "twc_env.training")
CHOOSES = ("buildings", "kinds", "agents")
TASK = "twc/ExploreQuick-v1"
FLATS, FLOORS, IPA_FLOORS = "flats", "floors", "ipa floors"
TEAM_SIZES = {f"{robots} robots": robots for robots in (2, 3, 5, 8)}
KINDS = (*TEAM_SIZES, FLATS, FLOORS, IPA_FLOORS)
STEPS = 2000
"""In buildings of other kinds than the task's."""
FLOOR_MAPS = "intel.yaml", "lse_arena.yaml", "willow-2010-02-18-0.10.yaml"
IPA_MAPS = (
    *(f"Freiburg{building}_scan" for building in (52, 79, 101)), "lab_d_scan", "lab_f_scan", "lab_intel", "lab_ipa",
    "NLB", "office_a", "office_b", "office_d",
)  # fmt: skip
FLATS_MAX = 20


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of this table."""
    parser.add_argument("--buildings", type=count, default=20, help="of each kind, as far as there are as many")
    parser.add_argument("--model", default="learned", help="a run folder, or learned for the shipped policy")
    parser.add_argument(
        "--agents",
        nargs="+",
        default=["nearest-frontier", "information-gain"],
        help="scripted teams (default: nearest-frontier information-gain)",
    )
    parser.add_argument("--jobs", type=count, default=2, help="number of worker processes")
    add_some(parser, "--kinds", KINDS, "kinds")


def rows(options: argparse.Namespace, runner: Runner) -> list[dict]:
    """One row per kind and scripted team."""
    teams = tuple(dict.fromkeys((options.model, *options.agents)))
    parts = [
        (kind, team, number)
        for kind in options.kinds
        for number in range(min(options.buildings, len(maps_of(kind))))
        for team in teams
    ]
    name = "{0[0]}, {0[1]}, building {0[2]}".format
    found = runner.each(parts, episode, name, options.jobs)
    table = []
    for kind in options.kinds:
        own = [(entry_of(*part), value) for part, value in zip(parts, found, strict=True) if part[0] == kind]
        areas, wrong = budget_areas(own), dict.fromkeys(teams, 0)
        for entry, value in own:
            wrong[entry.team] += int(value["wrong_merges"])
        mine = areas[options.model]
        for team in options.agents:
            leads = mine - areas[team]
            (low,), (high,) = mean_interval(leads[:, None])
            table.append(
                {
                    "kind": kind, "buildings": len(mine), "mean_coverage": float(mine.mean()), "team": team,
                    "mean_coverage_of_team": float(areas[team].mean()), "lead": float(leads.mean()),
                    "lead_low": float(low), "lead_high": float(high), "wrong_merges": wrong[options.model],
                    "wrong_merges_of_team": wrong[team],
                }
            )  # fmt: skip
    return table


def maps_of(kind: str) -> list[str]:
    """Names or files of the buildings of a kind. Raises DataError without the real data that some need."""
    if kind in TEAM_SIZES:
        return list(split_names("test", family_of(task_config(TASK).map)))
    if kind == FLOORS:
        return [str(data_folder() / "maps" / "ros" / name) for name in FLOOR_MAPS]
    if kind == IPA_FLOORS:
        return [str(data_folder() / "maps" / "ipa" / f"{name}.png") for name in IPA_MAPS]
    folder = data_folder() / "houseexpo"
    with (folder / "INDEX.csv").open() as file:
        areas_m2 = {row["id"]: float(row["free_area_m2"]) for row in csv.DictReader(file)}
    known = sorted((path.stem for path in folder.glob("*.json")), key=lambda name: (-areas_m2.get(name, 0.0), name))
    return [str(folder / f"{name}.json") for name in known[:FLATS_MAX]]


def entry_of(kind: str, team: str, number: int) -> Entry:
    """One episode of a team."""
    given: dict[str, object] = {"map": maps_of(kind)[number], "robots": TEAM_SIZES.get(kind, 3)}
    if kind not in TEAM_SIZES:
        given["max_cycles"] = STEPS
    config: EnvConfig = override(task_config(TASK), given)
    return Entry(TASK, config, team, number)


def episode(part: tuple[str, str, int]) -> dict:
    """Play one episode."""
    return play(entry_of(*part))
