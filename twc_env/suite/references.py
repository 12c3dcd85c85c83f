"""Scripted teams on validation buildings, beside which a learning curve is drawn."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

import twc_env
from twc_env.config import digest
from twc_env.records.json_values import write_json
from twc_env.running.ray_cluster import spread_out
from twc_env.suite.evaluation import scripted
from twc_env.training.progress import progress_bar
from twc_env.training.run_folder import Task

TEAMS = {"random": "random", "information-gain": "information-gain", "informed": "informed (oracle)"}
"""Teams and their names in the picture: the lower reference, the best scripted team of most tasks (docs/leaderboard.md)
and the upper reference."""


def references(
    task: Task, folder: Path, buildings: int, show_progress: bool = True, ray: str | None = None
) -> dict[str, float]:
    """Mean over time of the mapped floor of each of `TEAMS`, averaged over validation buildings.

    ray: address of a Ray cluster that plays. Kept in references.json of the run folder: measured again only for another
    task, version or number of buildings.
    """
    path = folder / "references.json"
    origin = {"config_digest": digest(task.config), "version": twc_env.__version__, "buildings": buildings}
    try:
        kept = json.loads(path.read_text())
        if kept.get("of") == origin and set(kept.get("mean_coverage", {})) == set(TEAMS):
            return {team: float(value) for team, value in kept["mean_coverage"].items()}
    except (OSError, AttributeError, ValueError, TypeError, RecursionError):  # there is none, or a damaged one
        pass
    played = [(task, team, number) for team in TEAMS for number in range(buildings)]
    found: dict[tuple[str, int], float] = {}
    with progress_bar(total=len(played), unit=" reference episodes", disable=not show_progress) as bar:
        for k, mean_coverage in spread_out(_mean_coverage, played, 1, ray):
            found[played[k][1:]] = mean_coverage
            bar.update(1)
    means = {team: float(np.mean([found[team, number] for number in range(buildings)])) for team in TEAMS}
    write_json(path, {"of": origin, "mean_coverage": means})
    return means


def _mean_coverage(played: tuple[Task, str, int]) -> float:
    return scripted(*played, "validation").mean_coverage
