"""Evaluation of place recognition: precision and recall of accepted pairs, with both ways of counting, and curves."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray as Array


@dataclass(frozen=True, slots=True, eq=False)
class Pairs:
    """Candidate pairs of places of different robots, and which of them are the same place."""

    first: Array
    """(pairs,) index of the first place."""
    second: Array
    """(pairs,) index of the second place."""
    robots: Array
    """(pairs, 2) the robots of both places."""
    is_same: Array
    """(pairs,) bool."""

    def __len__(self) -> int:
        return len(self.is_same)


@dataclass(frozen=True, slots=True)
class Counts:
    """Counts of accepted, correct and true pairs."""

    accepted: int
    right: int
    true: int
    """Number of pairs that should be accepted."""

    @property
    def precision(self) -> float:
        """NaN if nothing was accepted."""
        return self.right / self.accepted if self.accepted else math.nan

    @property
    def recall(self) -> float:
        """NaN if there is nothing to find."""
        return self.right / self.true if self.true else math.nan


def all_pairs(accepted: Array, pairs: Pairs) -> Counts:
    """Counts over all accepted pairs (papers.md T10, the default)."""
    return Counts(int(accepted.sum()), int((accepted & pairs.is_same).sum()), int(pairs.is_same.sum()))


def best_match(accepted: Array, score: Array, pairs: Pairs) -> Counts:
    """Counts over the best accepted match of each place on each other robot (papers.md T10)."""
    matches = right = true = 0
    for mine, other in ((0, 1), (1, 0)):
        place = pairs.first if mine == 0 else pairs.second
        keys = place * (pairs.robots.max(initial=0) + 1) + pairs.robots[:, other]
        true += len(np.unique(keys[pairs.is_same]))
        kept = np.flatnonzero(accepted)
        order = kept[np.argsort(-score[kept], kind="stable")]
        _, first = np.unique(keys[order], return_index=True)
        matches += len(first)
        right += int(pairs.is_same[order[first]].sum())
    return Counts(matches, right, true)


def average_precision(score: Array, is_same: Array) -> float:
    """Area under the stepwise precision-recall curve; pairs of equal score are added together. NaN with nothing to
    find."""
    precision, recall = precision_recall_curve(score, is_same)
    return float((np.diff(recall, prepend=0.0) * precision).sum()) if is_same.any() else math.nan


def recall_at_full_precision(score: Array, is_same: Array) -> float:
    """The largest recall of any threshold without a wrong pair; 0 if there is none."""
    if not is_same.any():
        return math.nan
    precision, recall = precision_recall_curve(score, is_same)
    return float(recall[precision >= 1.0].max(initial=0.0))


def precision_recall_curve(score: Array, is_same: Array) -> tuple[Array, Array]:
    """Precision and recall at every distinct score, in descending order."""
    order = np.argsort(-score, kind="stable")
    score, right = score[order], np.cumsum(is_same[order])
    is_last = np.append(score[1:] != score[:-1], True)[: len(score)]
    precision = right / np.arange(1, len(right) + 1)
    return precision[is_last], right[is_last] / max(int(is_same.sum()), 1)
