"""Similarity of two sign readings (TWC-SLAM Eq. 5, papers.md T4)."""

from __future__ import annotations

from collections.abc import Collection
from functools import lru_cache
from unicodedata import normalize

import numpy as np
from numpy.typing import NDArray as Array
from rapidfuzz.distance import Levenshtein
from rapidfuzz.process import extract

ROUNDING, SLACK = 1e-9, 0.01
"""Tolerance at the threshold; `extract` excludes equality, so it gets a lower cutoff."""


@lru_cache(maxsize=4096)
def normalise(text: str) -> str:
    """Upper case, without leading and trailing spaces, single spaces between words; accents as one character with their
    letter (NFC), since readers differ in that."""
    return " ".join(normalize("NFC", text.upper()).split())


def text_similarity(a: str, b: str) -> float:
    """(m - d) / m with m the longer length and d the edit distance; 0 for an empty text."""
    return Levenshtein.normalized_similarity(a, b) if a and b else 0.0


class SimilarTexts:
    """Distinct texts and their similar pairs; each pair is compared once, however often the texts are read."""

    def __init__(self, similarity_min: float):
        self._similarity_min = similarity_min
        self._number_of: dict[str, int] = {}
        self._texts: list[str] = []
        self._alike: list[list[tuple[int, float]]] = []
        """Per text, numbers and similarities of similar texts, itself included."""
        self._compared: tuple[str, int, list[tuple[int, float]]] = ("", 0, [])
        """Cache of the last comparison: the text, number of texts at that time, and the result."""

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

    def keep(self, texts: Collection[str]) -> Array:
        """Keep only some texts, in their order; returns the new number of each old one, -1 if removed."""
        kept = [number for number, text in enumerate(self._texts) if text in texts]
        number_of = np.full(len(self._texts), -1)
        number_of[kept] = np.arange(len(kept))
        now = number_of.tolist()
        self._alike = [
            [(now[other], similarity) for other, similarity in self._alike[number] if now[other] >= 0]
            for number in kept
        ]
        self._texts = [self._texts[number] for number in kept]
        self._number_of = {text: number for number, text in enumerate(self._texts)}
        self._compared = "", 0, []
        return number_of

    def has(self, text: str) -> bool:
        """Whether the text has a number."""
        return text in self._number_of

    def alike(self, text: str) -> list[tuple[int, float]]:
        """(number, similarity) of the numbered texts that reach the minimum similarity."""
        held = self._number_of.get(text)
        return self._compare(text) if held is None else self._alike[held]

    def _compare(self, text: str) -> list[tuple[int, float]]:
        compared, count, found = self._compared
        if compared != text or count != len(self._texts):
            found = self._found(text)
            self._compared = text, len(self._texts), found
        return found

    def _found(self, text: str) -> list[tuple[int, float]]:
        if not text:
            return [(number, 0.0) for number in range(len(self._texts))] if self._similarity_min <= 0.0 else []
        scorer, least = Levenshtein.normalized_similarity, max(self._similarity_min - ROUNDING, 0.0)
        found = extract(text, self._texts, scorer=scorer, score_cutoff=max(least - SLACK, 0.0), limit=None)
        return sorted((number, similarity) for _, similarity, number in found if similarity >= least)
