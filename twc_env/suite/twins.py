"""What a team's awareness of SLAM is worth: its lead over its blind twin, the same code without that part."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.agents.roster import TEAMS
from twc_env.metrics import team_scores


@dataclass(frozen=True, slots=True)
class TwinRow:
    """One team and its twin in the buildings of one task."""

    task: str
    team: str
    twin: str
    buildings: int
    lead: float
    """Area under the curve of correctly mapped floor, team - twin: the mean over pairs of episodes in the same building
    from the same starts, with its 95 % interval ..."""
    low: float
    """(nan with fewer than two buildings)"""
    high: float
    merged_s: float
    """Median time until all robots of the team shared one correct map; inf if in half of the buildings they never did
    ..."""
    twin_merged_s: float
    """... and those of the twin."""


def twin_rows(
    areas: Mapping[tuple[str, str], Array],
    values: Mapping[tuple[str, str], Sequence[dict[str, Any]]],
) -> tuple[TwinRow, ...]:
    """A row for each task and team whose twin has played, too.

    areas: (task, team) -> (buildings,) area under the curve. values: the same -> its episodes.
    """
    rows = []
    for task, team in areas:
        twin = TEAMS[team].twin if team in TEAMS else ""
        if (task, twin) in areas:
            leads = areas[task, team] - areas[task, twin]
            (low,), (high,) = team_scores.mean_interval(leads[:, None])
            merged = _merged_s(values[task, team]), _merged_s(values[task, twin])
            rows.append(TwinRow(task, team, twin, len(leads), float(leads.mean()), float(low), float(high), *merged))
    return tuple(rows)


def _merged_s(values: Sequence[dict[str, Any]]) -> float:
    return float(np.median([math.inf if each["merged_s"] is None else each["merged_s"] for each in values]))
