"""Probability of reading one text where another stands: a noisy-channel model of OCR."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray as Array
from rapidfuzz.distance import Levenshtein
from rapidfuzz.process import cdist

FRAGMENT_PROBABILITY, CHARACTER_ERROR_PROBABILITY = 0.07, 0.03
"""Probability that OCR returns a fragment, and that it misreads a character (papers.md T3)."""
INDEPENDENT_READINGS_MAX = 2
"""Agreeing readings beyond this number add nothing: errors of one reader on one sign are correlated."""
WRONG_CHARACTERS = 6.0
"""Number of likely substitutes of a misread character (mostly look-alikes)."""
LANGUAGE_CHARACTERS = 12.0
"""Effective alphabet size of an unknown text."""


def log_text_likelihood(reading: str, others: Sequence[str], reading_count: int, other_counts: Array) -> Array:
    """(others,) log probability of a reading if its sign is the one that gave each of the others.

    Both texts pass a noisy channel: single characters are misread, or only a fragment is left (papers.md T3). The
    counts are the numbers of readings that agree on a text: more of them reduce its error probability. An empty text,
    on either side, is no evidence for or against a sign: the reading is then as likely as of an unknown sign.
    """
    if not others:
        return np.zeros(0)
    count = np.minimum(np.minimum(np.asarray(other_counts, float), reading_count), INDEPENDENT_READINGS_MAX)
    wrong = 2 * CHARACTER_ERROR_PROBABILITY / count
    fragment = 2 * FRAGMENT_PROBABILITY / count**2
    length = np.array([len(other) for other in others], float)
    longest = np.maximum(length, len(reading))
    edits = cdist([reading], list(others), scorer=Levenshtein.distance)[0].astype(float)
    whole = np.log1p(-fragment) + (longest - edits) * np.log1p(-wrong) + edits * np.log(wrong / WRONG_CHARACTERS)
    shortest = np.minimum(length, len(reading))
    is_part = np.array([reading in other or other in reading for other in others]) & (shortest <= 0.5 * longest)
    cuts = (longest - shortest + 1) * np.maximum(0.35 * longest, 1)
    part = np.where(is_part, np.log(fragment / cuts), -np.inf)
    noise = np.log(fragment) + log_unknown_text(reading) - 2.0
    likelihood = np.logaddexp(np.logaddexp(whole, part), noise)
    return np.where(shortest > 0, likelihood, log_unknown_text(reading))


def log_unknown_text(reading: str) -> float:
    """Log probability of a reading of an unknown sign."""
    return -len(reading) * math.log(LANGUAGE_CHARACTERS)
