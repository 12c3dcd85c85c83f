"""Named reward terms of one transition. Here, in metrics and in drawing, truth may be read."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from numpy.typing import NDArray

from twc_env.config import RewardConfig

Array = NDArray


@dataclass(frozen=True, slots=True, eq=False)
class Transition:
    """One step, seen from both sides: the only record that holds truth and estimate together."""

    true_poses: Array
    """(robots, 3) in the building frame."""
    estimated_poses: Sequence[Array]
    """One (3,) per robot, in the map frame of its group."""
    contacts: Array
    """(robots,) bool: touched a wall or a mate."""
    correct_area_m2: float
    """Correctly mapped area of the largest rightly merged group, as last judged."""
    correct_area_before_m2: float
    """The same at the step before."""


def terms(transition: Transition, robot: int) -> dict[str, float]:
    """The terms of one robot, by name; the names are those of the weights in RewardConfig.

    correct_area: gain of the team since the last step [m2]; summed over an episode, the area at its end.
    collision: 1 while the robot touches something.
    """
    return {
        "correct_area": transition.correct_area_m2 - transition.correct_area_before_m2,
        "collision": float(transition.contacts[robot]),
    }


def weigh(values: dict[str, float], weights: RewardConfig) -> float:
    """The reward: each term times the weight of its name."""
    reward = 0.0
    for name, value in values.items():
        if value:  # most terms are 0 in most steps
            reward += getattr(weights, name) * value
    return reward
