"""How a real OCR misreads signs, as measured: error rates over capital height, incidence and blur, and confusions.

`python -m twc_env ocr measure` makes the table and `ocr_table.json` beside this file is what it made; its `made` entry
holds the command and the versions. The model behind the numbers:

- a line is missed altogether with probability `miss`, short ones more often than long ones;
- only its beginning or end is read with probability `fragment`; `kept` are deciles of the part that is left;
- every line draws one error level from `level_share`; each of its characters goes wrong with that level's rate times
  the character's `proneness`, by substitution, loss or addition (`edit_share`), so errors come in bad lines;
- spaces get lost on their own, with probability `space_loss`, beside digits more often than between letters;
- what a character turns into is drawn from its own confusions; these and `proneness` differ between lines that are
  mostly right and garbled ones;
- a sign keeps part of all that (`line_share`, `letter_share`): read again, it is misread in much the same way.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.errors import DataError

FORMAT = "twc_env/ocr-table-1"
SHIPPED = Path(__file__).with_name("ocr_table.json")
GARBLED_RATE = 0.25
"""Lines whose error level is at least this take the second set of confusions."""
MISS_LENGTH = 10
"""The table's miss rates are those of texts with this many characters."""
_CONFUSIONS_MAX = 12


@dataclass(frozen=True, slots=True, eq=False)
class OcrTable:
    """The measured table, ready for the compiled reader. H heights, A angles, B blurs, Q levels, C characters."""

    height_px: Array
    """(H,) capital heights, rising."""
    incidence_rad: Array
    """(A,)."""
    blur_widths: Array
    """(B,) way of the picture during exposure, in capital heights narrowed by the incidence."""
    miss: Array
    """(H, A, B) share of lines with no reading at all, of `MISS_LENGTH` characters."""
    miss_length_exponent: float
    """The odds of a miss fall with this power of the text's length."""
    fragment: Array
    """(H, A, B) share of the lines read of which only a part is read."""
    space_loss: Array
    """(H, A, B)."""
    space_proneness: Array
    """(2,) how much more often than that a space gets lost: between letters, and beside a digit."""
    level_cdf: Array
    """(H, A, B, Q) cumulative shares of the error levels, worst level first."""
    level_rate: Array
    """(Q,) character error rates, falling."""
    edit_cdf: Array
    """(Q, 2) of the errors: substitutions, then losses; the rest are additions."""
    kept: Array
    """(K,) quantiles of the share of a fragment's text that is left."""
    kept_begin: float
    """Share of the fragments that keep the beginning."""
    characters: Array
    """(C,) uint32, rising; row C of the next arrays stands for any other character."""
    proneness: Array
    """(2, C + 1) how much more often than the average a character goes wrong, in lines mostly right and in others."""
    confusion_code: Array
    """(2, C + 1, K) uint32: what it is read as, in lines mostly right and in garbled ones."""
    confusion_cdf: Array
    """(2, C + 1, K)."""
    added_code: Array
    """(K,) uint32 characters that appear from nowhere."""
    added_cdf: Array
    """(K,)."""
    line_share: float
    """How much of a line's luck (missed, fragment, error level) stays with the sign: share of the variance."""
    letter_share: float
    """The same for which letters go wrong and what they become."""


@lru_cache(maxsize=4)
def load_table(path: Path = SHIPPED) -> OcrTable:
    """Read a table file; DataError when it is none."""
    try:
        values = json.loads(path.read_text())
        if values["format"] != FORMAT:
            raise DataError(f"{path} has format {values['format']!r}, expected {FORMAT!r}; measure it anew")
        return table_of(values)
    except OSError as error:
        raise DataError(f"cannot read the OCR table {path}: {error.strerror}") from error
    except (ValueError, KeyError, TypeError) as error:
        raise DataError(
            f"{path} is not an OCR table ({error!r}); make one with: python -m twc_env ocr measure"
        ) from error


def table_of(values: dict) -> OcrTable:
    """The arrays of a table given as plain values (the content of a table file)."""
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
    """(C + 1, K) codes and cumulative shares; a character without its own row takes the common one, ""."""
    common = shares.get("") or {"?": 1.0}
    rows = [_row(shares.get(c) or common, _CONFUSIONS_MAX) for c in [*characters, ""]]
    return np.array([code for code, _ in rows]), np.array([cdf for _, cdf in rows])


def _row(shares: dict[str, float], width: int) -> tuple[Array, Array]:
    """(width,) codes and cumulative shares of the commonest; the last is repeated where there are fewer."""
    common = sorted(shares.items(), key=lambda item: (-item[1], item[0]))[:width]
    common += common[-1:] * (width - len(common))
    weights = np.array([*dict(common).values()] + [0.0] * (width - len(dict(common))))
    return np.array([ord(c) for c, _ in common], np.uint32), np.cumsum(weights) / weights.sum()
