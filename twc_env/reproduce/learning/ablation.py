"""Ablation: learners trained in ExploreQuick-v1 without some of what they know, and what that costs in test buildings.

Every variant is trained with the same seed, and plays the same test buildings; nothing is chosen on them.
`mean_coverage` is the floor that is mapped correctly, averaged over the time of an episode; `lead` that of the variant
over the one named in `over`, with its 95 % interval over buildings. Training has chance, too: mappo-other-seed says how
much.

- rule: what training starts from, untrained; nothing: the same without the rule, where all choices are alike
- mappo-from-rule: trained from the rule, which it hardly moves; all other mappo, and ppo: trained from nothing
- mappo-feed-forward: each choice encoded by itself, and the mean of the rest, instead of attention
- mappo-plain-critic: a critic that sees what the robot sees, not the truth
- no-teammates, no-signs, no-map: the policy does not know of them (training/blindness.py); candidates are still places
  on the map, which robots in contact share
- ppo: as much driving as mappo, which it is compared with
- es: trained from the rule, which reads no signs

With the defaults it takes more than an hour of a core; `--steps 500 --buildings 2` some minutes, and tells nothing.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

from twc_env.metrics.team_scores import mean_interval
from twc_env.reproduce.runner import Runner, add_some
from twc_env.running.learning_libraries import learning_libraries
from twc_env.running.options import count, natural
from twc_env.suite.entries import entries
from twc_env.suite.player import play
from twc_env.suite.standings import budget_areas

CHOOSES = ("buildings", "variants")
PACKAGES = ("twc_env.agents", "twc_env.training")
TASK = "twc/ExploreQuick-v1"
TIMES = {"mappo": 1, "es": 3, "ppo": 3}
"""Decisions in a training, in `--steps`: `ppo` counts those of busy robots to go on, of three robots as many steps;
`es` needs an episode of each team for each of its steps."""


class Variant(NamedTuple):
    """A learner, and what is changed."""

    learner: str
    over: str | None = None
    """The variant that it is compared with."""
    settings: Mapping[str, Any] = MappingProxyType({})
    is_trained: bool = True
    seed: int = 0
    """Added to that of all."""


NOTHING: dict[str, Any] = {"from_rule": False}
VARIANTS = {
    "rule": Variant("mappo", is_trained=False),
    "nothing": Variant("mappo", "rule", NOTHING, is_trained=False),
    "mappo-from-rule": Variant("mappo", "rule"),
    "mappo": Variant("mappo", "rule", NOTHING),
    "mappo-other-seed": Variant("mappo", "mappo", NOTHING, seed=1),
    "mappo-feed-forward": Variant("mappo", "mappo", NOTHING | {"attention": False}),
    "mappo-plain-critic": Variant("mappo", "mappo", NOTHING | {"privileged_critic": False}),
    "mappo-no-teammates": Variant("mappo", "mappo", NOTHING | {"blind": ("teammates",)}),
    "mappo-no-signs": Variant("mappo", "mappo", NOTHING | {"blind": ("signs",)}),
    "mappo-no-map": Variant("mappo", "mappo", NOTHING | {"blind": ("map",)}),
    "ppo": Variant("ppo", "mappo", NOTHING),
    "es": Variant("es", "rule"),
    "es-no-teammates": Variant("es", "es", {"blind": ("teammates",)}),
    "es-no-map": Variant("es", "es", {"blind": ("map",)}),
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of this table."""
    parser.add_argument(
        "--steps",
        type=count,
        default=20_000,
        help="decisions in each training; thrice as many of ppo, which counts busy robots too, and es "
        "(default: %(default)s)",
    )
    parser.add_argument("--seed", type=natural, default=0, help="of each training (default: %(default)s)")
    parser.add_argument("--buildings", type=count, default=50, help="test buildings (default: %(default)s)")
    parser.add_argument("--jobs", type=count, default=2, help="number of worker processes (default: %(default)s)")
    add_some(parser, "--variants", VARIANTS, "variants")


def rows(options: argparse.Namespace, runner: Runner) -> list[dict]:
    """One row per variant."""
    names = [name for name in VARIANTS if name in options.variants]
    shows = options.jobs == 1 and not getattr(options, "quiet", False)
    work = partial(train, folder=runner.folder, steps=options.steps, seed=options.seed, show_progress=shows)
    runner.each(names, work, "{}, training".format, options.jobs)
    teams = {str(runner.folder / name): name for name in names}
    parts = entries([TASK], list(teams), "test", options.buildings)
    found = runner.each(parts, play, lambda part: f"{teams[part.team]}, building {part.number}", options.jobs)
    areas = budget_areas(list(zip(parts, found, strict=True)))
    wrong = dict.fromkeys(names, 0)
    for part, value in zip(parts, found, strict=True):
        wrong[teams[part.team]] += int(value["wrong_merges"])
    own = {name: areas[str(runner.folder / name)] for name in names}
    table = []
    for name in names:
        variant, lead = VARIANTS[name], dict.fromkeys(("lead", "lead_low", "lead_high"))
        steps = options.steps * TIMES[variant.learner]
        if variant.over in own:
            leads = own[name] - own[variant.over]
            (low,), (high,) = mean_interval(leads[:, None])
            lead = {"lead": leads.mean(), "lead_low": low, "lead_high": high}
        table.append(
            {
                "variant": name, "learner": variant.learner if variant.is_trained else None,
                "steps": steps if variant.is_trained else 0, "buildings": options.buildings,
                "mean_coverage": own[name].mean(), "over": variant.over, **lead, "wrong_merges": wrong[name],
            }
        )  # fmt: skip
    return table


def train(name: str, folder: Path, steps: int, seed: int, show_progress: bool) -> None:
    """Train a variant in a folder of its name, or go on there."""
    with learning_libraries():
        from twc_env.training import evolution, mappo, ppo
        from twc_env.training.checkpoint import FILE_NAME
        from twc_env.training.run_folder import Task
    variant, own = VARIANTS[name], folder / name
    learner: Any = {"mappo": mappo, "es": evolution, "ppo": ppo}[variant.learner]
    total = steps * TIMES[variant.learner]
    given = {"seed": seed + variant.seed, "steps": total, "workers": 0, **variant.settings}
    if not variant.is_trained:
        given |= {"steps": 1, "learning_rate": 0.0}
    learner.train(Task(TASK), learner.Settings(**given), own, (own / FILE_NAME).exists(), show_progress)
