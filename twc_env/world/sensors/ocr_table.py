"""Measured OCR errors: rates over capital height, incidence angle and motion blur, and confusions of characters.

`twc-env ocr measure` writes `ocr_table.json`, whose `made` entry contains the command and the versions. The
error model:

- a line is missed with probability `miss`, short lines more often than long ones;
- only its beginning or end is read with probability `fragment`; `kept` are quantiles of the share that is read;
- each line has one error level, sampled from `level_share`. Its characters are wrong with the rate of that level times
  the character's `proneness`: substitutions, deletions or insertions (`edit_share`);
- spaces are deleted independently, with probability `space_loss`, beside digits more often than between letters;
- substitutes are sampled from the confusions of the character; these and `proneness` differ between garbled lines and
  others;
- readings of the same sign are correlated (`line_share`, `letter_share`).
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.errors import UNFIT, DataError

FORMAT = "twc_env/ocr-table-1"
SHIPPED = Path(__file__).with_name("ocr_table.json")
GARBLED_RATE = 0.25
"""Least error rate of garbled lines, which have their own confusions."""
MISS_LENGTH = 10
"""Text length [characters] of the table's miss rates."""
_CONFUSIONS_MAX = 12


@dataclass(frozen=True, slots=True, eq=False)
class OcrTable:
    """The table as arrays. H heights, A angles, B blurs, Q error levels, C characters, K entries per character."""

    height_px: Array
    """(H,) capital heights, ascending."""
    incidence_rad: Array
    """(A,)."""
    blur_widths: Array
    """(B,) image motion during the exposure, in capital heights times the cosine of the incidence."""
    miss: Array
    """(H, A, B) probability of missing a line of `MISS_LENGTH` characters."""
    miss_length_exponent: float
    """The odds of a miss are inversely proportional to this power of the text length."""
    fragment: Array
    """(H, A, B) share of the lines read of which only a part is read."""
    space_loss: Array
    """(H, A, B) probability of a space's deletion."""
    space_proneness: Array
    """(2,) factors on it between letters and beside a digit."""
    level_cdf: Array
    """(H, A, B, Q) cumulative shares of the error levels, worst level first."""
    level_rate: Array
    """(Q,) character error rates, descending."""
    edit_cdf: Array
    """(Q, 2) cumulative shares of substitutions and deletions among the errors; the rest are insertions."""
    kept: Array
    """(quantiles,) of the share of the text in a fragment."""
    kept_begin: float
    """Share of the fragments that are beginnings; the rest are ends."""
    characters: Array
    """(C,) uint32, ascending; row C of the next arrays is for any other character."""
    proneness: Array
    """(2, C + 1) error rate relative to the average character, in lines that are not garbled and in garbled ones."""
    confusion_code: Array
    """(2, C + 1, K) uint32 substitutes, in lines that are not garbled and in garbled ones."""
    confusion_cdf: Array
    """(2, C + 1, K) their cumulative shares."""
    added_code: Array
    """(K,) uint32 inserted characters."""
    added_cdf: Array
    """(K,) their cumulative shares."""
    line_share: float
    """Share of the variance of a line's quality (missed, fragment, error level) common to all readings of a sign."""
    letter_share: float
    """The same for its character errors."""


@lru_cache(maxsize=4)
def load_table(path: Path = SHIPPED) -> OcrTable:
    """Read a table file. Raises DataError if it is unreadable or no table."""
    try:
        values = json.loads(path.read_text())
        if values["format"] != FORMAT:
            raise DataError(f"{path} has format {values['format']!r}, expected {FORMAT!r}; measure it anew")
        return table_of(values)
    except OSError as error:
        raise DataError(f"cannot read the OCR table {path}: {error.strerror}") from error
    except (KeyError, *UNFIT) as error:
        raise DataError(f"{path} is not an OCR table ({error!r}); make one with: twc-env ocr measure") from error


def table_of(values: dict) -> OcrTable:
    """The table of the values of a table file."""
    level_share = np.array(values["level_share"], float)  # (H, A, B, Q)
    edit_share = np.array(values["edit_share"], float)  # (Q, 3)
    kinds = ("", "_garbled")
    proneness = [values[f"proneness{kind}"] for kind in kinds]
    characters = sorted({c for prone in proneness for c in prone} - {""})
    confusion = [_confusions(values[key], characters) for key in (f"confusions{kind}" for kind in kinds)]
    added_code, added_cdf = _row(values["added"] or {".": 1.0}, _CONFUSIONS_MAX)
    return OcrTable(
        height_px=np.array(values["height_px"], float),
        incidence_rad=np.radians(np.array(values["incidence_deg"], float)),
        blur_widths=np.array(values["blur_widths"], float),
        miss=np.array(values["miss"], float),
        fragment=np.array(values["fragment"], float),
        miss_length_exponent=float(values["miss_length_exponent"]),
        space_loss=np.array(values["space_loss"], float),
        space_proneness=np.array(values["space_proneness"], float),
        level_cdf=np.cumsum(level_share, axis=-1) / level_share.sum(axis=-1, keepdims=True),
        level_rate=np.array(values["level_rate"], float),
        edit_cdf=np.cumsum(edit_share, axis=1)[:, :2] / edit_share.sum(axis=1, keepdims=True),
        kept=np.array(values["kept"], float),
        kept_begin=float(values["kept_begin"]),
        characters=np.array([ord(c) for c in characters], np.uint32),
        proneness=np.array([[prone.get(c, 1.0) for c in [*characters, ""]] for prone in proneness]),
        confusion_code=np.array([code for code, _ in confusion]),
        confusion_cdf=np.array([cdf for _, cdf in confusion]),
        added_code=added_code,
        added_cdf=added_cdf,
        line_share=float(values["line_share"]),
        letter_share=float(values["letter_share"]),
    )


def _confusions(shares: dict[str, dict[str, float]], characters: list[str]) -> tuple[Array, Array]:
    """(C + 1, K) codes and cumulative shares; characters without an entry take that of ""."""
    common = shares.get("") or {"?": 1.0}
    rows = [_row(shares.get(c) or common, _CONFUSIONS_MAX) for c in [*characters, ""]]
    return np.array([code for code, _ in rows]), np.array([cdf for _, cdf in rows])


def _row(shares: dict[str, float], width: int) -> tuple[Array, Array]:
    """(width,) most frequent codes and their cumulative shares; the last one is repeated if there are fewer."""
    common = sorted(shares.items(), key=lambda item: (-item[1], item[0]))[:width]
    common += common[-1:] * (width - len(common))
    weights = np.array([*dict(common).values()] + [0.0] * (width - len(dict(common))))
    return np.array([ord(c) for c, _ in common], np.uint32), np.cumsum(weights) / weights.sum()
