"""Correctness of loop closures, and their precision and recall."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twc_env.errors import DataError
from twc_env.records.array_validation import real_array
from twc_env.records.geometry import between

DISTANCE_MAX_M = 0.5
ANGLE_MAX_RAD = math.radians(10.0)


@dataclass(frozen=True, slots=True)
class ClosureScore:
    """Counts of an episode's loop closures."""

    proposed: int
    accepted: int
    correct: int
    """Accepted closures that are correct."""
    precision: float
    """Correct share of the accepted; NaN if none was accepted."""
    recall: float
    """Accepted share of the correct ones; NaN if none was correct."""


def closures_are_correct(measured: ArrayLike, true: ArrayLike) -> NDArray[np.bool_]:
    """(...) bool: whether measured relative poses (..., 3) are within 0.5 m and 10 degrees of the true ones.

    Raises DataError for other shapes.
    """
    pose, true_pose = real_array(measured, "measured"), real_array(true, "true")
    shapes = pose.shape, true_pose.shape
    if shapes[0] != shapes[1] or shapes[0][-1:] != (3,):
        raise DataError(f"need as many measured as true poses (n, 3); got {shapes[0]} and {shapes[1]}")
    error = between(true_pose, pose)
    return (np.hypot(error[..., 0], error[..., 1]) <= DISTANCE_MAX_M) & (np.abs(error[..., 2]) <= ANGLE_MAX_RAD)


def score_closures(is_correct: ArrayLike, is_accepted: ArrayLike) -> ClosureScore:
    """Precision and recall over all closures that were proposed and measured; both arguments (k,) bool.

    Raises DataError for other shapes.
    """
    correct = real_array(is_correct, "is_correct") != 0.0
    taken = real_array(is_accepted, "is_accepted") != 0.0
    if correct.ndim != 1 or correct.shape != taken.shape:
        raise DataError(f"need as many true answers as decisions (k,); got {correct.shape} and {taken.shape}")
    right = int(np.count_nonzero(correct & taken))
    accepted = int(np.count_nonzero(taken))
    possible = int(np.count_nonzero(correct))
    return ClosureScore(
        proposed=len(correct),
        accepted=accepted,
        correct=right,
        precision=right / accepted if accepted else math.nan,
        recall=right / possible if possible else math.nan,
    )
