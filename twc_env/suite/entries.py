"""What a benchmark plays: every team in every building of every task, each with the same seeds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from twc_env.agents.roster import TEAMS
from twc_env.config import EnvConfig, override
from twc_env.errors import ConfigError, did_you_mean, one_of
from twc_env.tasks import SUITES, task_config
from twc_env.world.building.splits import FAMILY_SPLITS, family_of, split_names

RANDOM, INFORMED = "random", "informed"
"""The teams that have the scores 0 and 1."""
REFERENCES = (RANDOM, INFORMED)
PARTLY_INFORMED = tuple(name for name, team in TEAMS.items() if team.is_oracle and name != INFORMED)
SPECIAL = ("radio-frontier", "radio-walk", *PARTLY_INFORMED)
"""Scripted teams that are only played if they are named: no task has the radio map that the first two follow, and
oracles that lack a piece of what the informed team knows show what it is worth."""
NO_RIVALS = (*REFERENCES, *PARTLY_INFORMED)
"""No other team is measured by its lead over them."""


@dataclass(frozen=True, slots=True)
class Entry:
    """One episode: a team in one building. Its number is that of the building in its split, and the seed."""

    task: str
    config: EnvConfig
    """Settings of the task, whose map is this building."""
    team: str
    number: int

    @property
    def weight(self) -> float:
        """How long the episode takes, relative to others, at most."""
        return float(self.config.robots * self.config.max_cycles)


def suite_tasks(suite: str, chosen: Sequence[str] | None) -> tuple[str, ...]:
    """The ids of a suite, or those chosen of them, by their whole id or the part behind the slash.

    Raises ConfigError for an unknown suite or task.
    """
    if suite not in SUITES:
        raise ConfigError(f"no suite {suite!r}; suites are {', '.join(SUITES)}")
    known = {name: task for task in SUITES[suite] for name in (task, task.partition("/")[2])}
    for name in chosen or ():
        if name not in known:
            short = [task.partition("/")[2] for task in SUITES[suite]]
            raise ConfigError(
                f"{suite} has no task {name!r}{did_you_mean(name, known) or one_of(name, short, 'it has')}"
            )
    return tuple(dict.fromkeys(known[name] for name in chosen)) if chosen else SUITES[suite]


def with_references(teams: Sequence[str], known: Sequence[str]) -> tuple[str, ...]:
    """The teams without repetitions, and the references that are known, which every score needs."""
    return tuple(dict.fromkeys((*teams, *(name for name in REFERENCES if name in known))))


def entries(tasks: Sequence[str], teams: Sequence[str], split: str, buildings: int) -> list[Entry]:
    """All episodes, building by building, so that an interrupted benchmark has whole comparisons.

    Raises ConfigError if a task has fewer buildings in this split.
    """
    found = []
    configs = {task: task_config(task) for task in tasks}
    if buildings > FAMILY_SPLITS[split]:
        raise ConfigError(f"the split {split} has {FAMILY_SPLITS[split]} buildings; got {buildings}")
    for number in range(buildings):
        for task, config in configs.items():
            building = split_names(split, family_of(config.map))[number]
            placed = override(config, {"map": building})
            found += [Entry(task, placed, team, number) for team in teams]
    return found
