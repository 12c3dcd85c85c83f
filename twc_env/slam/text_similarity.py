"""How alike two readings of a sign are (TWC-SLAM Eq. 5, SPEC T4)."""

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
