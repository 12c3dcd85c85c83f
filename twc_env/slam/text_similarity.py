"""How alike two readings of a sign are (TWC-SLAM Eq. 5, papers.md T4)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from rapidfuzz.distance import Levenshtein
from rapidfuzz.process import cdist

Array = NDArray


def normalise(text: str) -> str:
    """Upper case, no spaces at the ends, single spaces between words."""
    return " ".join(text.upper().split())


def text_similarity(a: str, b: str) -> float:
    """(m - d) / m with m the longer length and d the edit distance; an empty text is like nothing."""
    return Levenshtein.normalized_similarity(a, b) if a and b else 0.0


def text_similarities(text: str, others: Sequence[str]) -> Array:
    """(others,) similarity of one text to each of the others."""
    if not others:
        return np.zeros(0)
    scores = cdist([text], others, scorer=Levenshtein.normalized_similarity, dtype=np.float64)[0]
    empty = np.array([not other for other in others])
    return np.where(empty | (not text), 0.0, scores)


class AlikeTexts:
    """Distinct texts, and which of them are alike: each pair is compared once, however often the texts are read."""

    def __init__(self, similarity_min: float):
        self._similarity_min = similarity_min
        self._number_of: dict[str, int] = {}
        self._texts: list[str] = []
        self._alike: list[list[tuple[int, float]]] = []
        """Of each text the numbers of those that are alike, itself included, with their similarity."""

    def number_of(self, text: str) -> int:
        """The text's number; a new text gets the next one."""
        held = self._number_of.get(text)
        if held is not None:
            return held
        found = self._compare(text)
        number = self._number_of[text] = len(self._texts)
        self._texts.append(text)
        for other, similarity in found:
            self._alike[other].append((number, similarity))
        own = 1.0 if text else 0.0
        self._alike.append([*found, (number, own)] if own >= self._similarity_min else found)
        return number

    def alike(self, text: str) -> list[tuple[int, float]]:
        """(number, similarity) of the numbered texts that are at least as similar as the minimum."""
        held = self._number_of.get(text)
        return self._compare(text) if held is None else self._alike[held]

    def _compare(self, text: str) -> list[tuple[int, float]]:
        similarity = text_similarities(text, self._texts)
        near = np.flatnonzero(similarity >= self._similarity_min)
        return list(zip(near.tolist(), similarity[near].tolist(), strict=True))
