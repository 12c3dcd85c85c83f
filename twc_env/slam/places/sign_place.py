"""A sign on one robot's own map: its position and the consensus of all its readings."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray as Array
from rapidfuzz.distance import Levenshtein
from rapidfuzz.process import cdist

from twc_env.records.geometry import wrap_angle
from twc_env.records.messages import Keyframe, SignObservation

SAME_SIGN_SIMILARITY = 0.6
"""Minimum similarity of a reading to one of the earlier readings of the same sign."""
READINGS_MAX, VIEWS_MAX = 15, 6
"""Maximum number of texts and keyframes kept per sign."""
SignView = tuple[Keyframe, SignObservation]
"""A keyframe and one of its sign readings."""


@dataclass(slots=True, eq=False)
class SignPlace:
    """A sign on one robot's own map."""

    robot: int
    position_odom: Array
    """(2,) position of the latest reading."""
    travel_m: float
    facing_odom: float = math.nan
    """Medoid of the facings of all readings; NaN if none is known."""
    texts: list[str] = field(default_factory=list)
    views: list[SignView] = field(default_factory=list)
    """Keyframes that read it, spread over its passes, with their readings."""
    consensus: str = ""
    support: int = 1
    """Number of readings equal to the consensus."""
    _facings: list[float] = field(default_factory=list)

    def add(self, text: str, keyframe: Keyframe, sign: SignObservation, position: Array, facing: float) -> None:
        """Add a reading at a position and facing in the odom frame; an empty one tells where the sign is, not its
        text."""
        is_settled = text == self.consensus and self.support == len(self.texts) < READINGS_MAX
        is_told = bool(text) or not self.consensus
        if is_told:
            self.texts = [*[told for told in self.texts if told][1 - READINGS_MAX :], text]
        if not self.views or self.views[-1][0].index != keyframe.index:
            if len(self.views) == VIEWS_MAX:
                self.views.pop(1)
            self.views.append((keyframe, sign))
        self.position_odom, self.travel_m = position, keyframe.travel_m
        if not math.isnan(facing):
            self._facings = [*self._facings[1 - READINGS_MAX :], facing]
            gaps = np.abs(wrap_angle(np.subtract.outer(self._facings, self._facings)))
            self.facing_odom = self._facings[int(np.argmin(gaps.sum(axis=1)))]
        if is_settled:
            self.support += 1
        elif is_told:
            self._vote()

    def reads_like(self, text: str, is_near: bool, similarity_min: float = SAME_SIGN_SIMILARITY) -> bool:
        """Whether a reading is similar to any kept one; if near, a fragment of the consensus suffices."""
        if is_near and (text in self.consensus or self.consensus in text):
            return True
        return bool(cdist([text], self.texts, scorer=Levenshtein.normalized_similarity).max() >= similarity_min)

    def agrees_on(self, text: str, similarity_min: float) -> bool:
        """Whether a reading is this similar to the consensus."""
        return Levenshtein.normalized_similarity(text, self.consensus) >= similarity_min

    def _vote(self) -> None:
        """Set the consensus: the reading with the least cost of explaining all others as fragments or misspellings."""
        cost = np.minimum(3.0 * cdist(self.texts, self.texts, scorer=Levenshtein.distance), 12.0)
        is_part = np.array([[part in whole for part in self.texts] for whole in self.texts])
        total = np.where(is_part, np.minimum(cost, 5.0), cost).sum(axis=1)
        best = np.flatnonzero(total == total.min())
        self.consensus = max((self.texts[k] for k in best), key=lambda text: (len(text), text))
        self.support = max(1, sum(text == self.consensus for text in self.texts))
