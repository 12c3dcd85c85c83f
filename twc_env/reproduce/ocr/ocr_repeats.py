"""Correlation of repeated readings of a sign, fitted to signs that were read three times."""

from __future__ import annotations

import numpy as np

from twc_env.records.random_streams import random_stream
from twc_env.slam.places.text_similarity import normalise
from twc_env.world.sensors.misreading import TableReader, codes_of, shares
from twc_env.world.sensors.ocr_table import table_of

_DRAWN_PAIRS = 6
"""Number of pairs of readings sampled from the table per measured one."""


def fit_correlation(table: dict, triples: list, seed: int) -> dict:
    """Correlated shares of errors, for lines and for letters, chosen so that sampled pairs agree like measured ones.

    `triples` are (truth, height, angle, reading, reading nearby, reading from elsewhere). Lines are evaluated by the
    correlation of exact readings, letters by how often two wrong readings are equal.
    """
    near, far = ([(t[0], t[3], t[k]) for t in triples] for k in (4, 5))
    measured = _agreement(near + far)
    line = _raised(table, triples, seed, "line_share", measured["exact_correlation"])
    letter = _raised(table | {"line_share": line}, triples, seed, "letter_share", measured["same_when_wrong"])
    line = _raised(table | {"letter_share": letter}, triples, seed, "line_share", measured["exact_correlation"])
    fitted = {"line_share": line, "letter_share": letter}
    drawn = {"drawn": fitted, "drawn_independently": {"line_share": 0.0, "letter_share": 0.0}}
    agreement = {"near": _agreement(near), "elsewhere": _agreement(far)} | {
        name: _agreement(_drawn_pairs(table | shares, triples, seed)) for name, shares in drawn.items()
    }
    return fitted | {"read_again": agreement}


def _raised(table: dict, triples: list, seed: int, key: str, target: float) -> float:
    """The share at which sampled pairs agree as much as measured ones, by linear interpolation on a grid."""
    figure = "exact_correlation" if key == "line_share" else "same_when_wrong"
    grid = np.linspace(0.0, 0.98, 8)
    found = [
        _agreement(_drawn_pairs({"line_share": 0.0, "letter_share": 0.0} | table | {key: share}, triples, seed))[figure]
        for share in grid
    ]
    return round(float(np.interp(target, np.maximum.accumulate(found), grid)), 3)


def _agreement(pairs: list[tuple[str, str, str]]) -> dict[str, float]:
    """Statistics of (truth, first, second), ignoring spaces: correlation of exact readings, share of equal wrong
    ones."""
    solid = [tuple(normalise(text).replace(" ", "") for text in pair) for pair in pairs]
    exact = np.array([(a == truth, b == truth) for truth, a, b in solid], float)
    wrong = [a == b for truth, a, b in solid if a and b and truth not in (a, b)]
    correlation = float(np.corrcoef(exact.T)[0, 1]) if (exact.std(axis=0) > 0).all() else 0.0
    return {
        "exact_correlation": round(correlation, 3),
        "same_when_wrong": round(float(np.mean(wrong)), 3) if wrong else 0.0,
        "both_wrong": len(wrong),
    }


def _drawn_pairs(table: dict, triples: list, seed: int) -> list[tuple[str, str, str]]:
    """Pairs of readings sampled from the table, of the same signs at the same height and angle."""
    ready, random = table_of(table), random_stream(seed, "ocr correlation")
    reader, drawn = TableReader(ready), []
    for text, height_px, angle, *_ in triples:
        codes, hidden, share = codes_of(text), np.zeros(len(text), np.bool_), shares(ready, text)
        for _ in range(_DRAWN_PAIRS):
            kept, *own = random.standard_normal((3, len(share)))
            two = (np.sqrt(share) * kept + np.sqrt(1.0 - share) * z for z in own)
            drawn.append((text, *(reader.read(codes, hidden, height_px, angle, 0.0, z) for z in two)))
    return drawn
