"""OCR errors of sign readings: sampled from the measured table, or by the two probabilities of papers.md T3."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.config import SignsConfig
from twc_env.kernels.compiled import Lent, borrowing_kernel, bound, parts_of
from twc_env.world.sensors.ocr_table import GARBLED_RATE, MISS_LENGTH, OcrTable

CODES = "utf-32"
"""Codec of uint32 code points in native byte order; faster than "utf-32-le", which Python looks up in each call."""
LINE_DRAWS = 3
"""Random numbers per line, besides two per character."""


def draw_count(text: str) -> int:
    """Count of standard normal numbers for one reading of a text."""
    return LINE_DRAWS + 2 * len(text)


def shares(table: OcrTable, text: str) -> Array:
    """(draws,) share of the variance of each random number that all readings of a sign have in common."""
    return np.repeat([table.line_share, table.letter_share], [LINE_DRAWS, 2 * len(text)])


def codes_of(text: str) -> Array:
    """(characters,) uint32 code points."""
    return np.frombuffer(text.encode("utf-32-le"), np.uint32)


class TableReader:
    """Samples readings from the measured table."""

    def __init__(self, table: OcrTable):
        t = table
        # Interpolation is linear in the share of the letters' width that is lost to the viewing angle.
        narrowed = 1.0 - np.cos(t.incidence_rad)
        grid = (t.height_px, narrowed, t.blur_widths, t.miss, t.fragment, t.space_loss, t.level_cdf)
        lines = (
            t.level_rate, t.edit_cdf, t.kept, t.kept_begin, t.miss_length_exponent, t.space_proneness,
            float(MISS_LENGTH), float(GARBLED_RATE),
        )  # fmt: skip
        letters = (
            t.characters, t.proneness, t.confusion_code, t.confusion_cdf, t.added_code, t.added_cdf,
        )  # fmt: skip
        self.table = Lent((grid, lines, letters))
        """Argument of `misread_signs`."""
        self._levels = np.empty(len(t.level_rate))
        self._run: Callable[..., None] | None = None
        """`misread_signs` with the table."""

    def read(
        self, codes: Array, is_hidden: Array, height_px: float, incidence_rad: float, blur_px: float, draws: Array
    ) -> str:
        """One reading of the text `codes` (n,); "" if missed.

        is_hidden (n,) bool: characters out of sight; draws (3 + 2 n,): standard normal, equal ones give equal errors.
        """
        out, width = np.empty(2 * len(codes) + 1, np.uint32), math.cos(incidence_rad)
        count = _misread(
            self.table, codes, is_hidden, height_px, 1.0 - width, blur_px / (height_px * width), draws, self._levels,
            out,
        )  # fmt: skip
        return out[:count].tobytes().decode(CODES).strip()

    def read_signs(self, sights: Array, hidden: Array, texts: SignTexts, fresh: Array) -> list[str]:
        """One reading of each sign in view; sights (k, 6) and hidden (k, L) as filled by `look`.

        fresh: standard normal, `draw_count` numbers per text, concatenated.
        """
        given = len(sights), sights, hidden, fresh, 0, *texts.arguments
        if self._run is None:
            self._run = bound(misread_signs, self.table, *given)
        self._run(*given)
        out, width, readings = texts.out[: len(sights)].tobytes(), texts.out.itemsize * texts.out.shape[1], []
        for k, count in enumerate(texts.counts[: len(sights)].tolist()):
            readings.append(out[k * width : k * width + 4 * count].decode(CODES).strip())
        return readings


class SignTexts:
    """Texts of a building's signs, and the random numbers that all readings of a sign share; L: longest text."""

    def __init__(self, table: OcrTable, texts: Sequence[str], plates: np.random.Generator):
        longest = max(map(len, texts), default=0)
        self.lengths = np.array([len(text) for text in texts], np.int64)
        self.codes = np.zeros((len(texts), longest), np.uint32)
        """(signs, L) code points."""
        self.kept, self.weights = np.zeros((2, len(texts), LINE_DRAWS + 2 * longest))
        """(signs, 3 + 2 L) for each random number: the sign's constant part, and the weight of the part drawn anew."""
        for k, text in enumerate(texts):
            share = shares(table, text)
            self.codes[k, : len(text)] = codes_of(text)
            self.kept[k, : len(share)] = np.sqrt(share) * plates.standard_normal(len(share))
            self.weights[k, : len(share)] = np.sqrt(1.0 - share)
        self.out, self.counts = np.empty((len(texts), 2 * longest + 1), np.uint32), np.empty(len(texts), np.int64)
        """Outputs of `misread_signs`: code points read of each sign in view, and their counts."""
        self.arguments = (
            self.codes, self.lengths, self.kept, self.weights, np.empty(LINE_DRAWS + 2 * longest),
            np.empty(len(table.level_rate)), self.out, self.counts,
        )  # fmt: skip


@borrowing_kernel
def _grid_weight(axis, value):
    """Linear interpolation: index of the grid value below, and weight in [0, 1] of the next one; constant outside."""
    last = axis.shape[0] - 2
    k = 0
    while k < last and value >= axis[k + 1]:
        k += 1
    weight = (value - axis[k]) / (axis[k + 1] - axis[k])
    return k, min(max(weight, 0.0), 1.0)


@borrowing_kernel
def _normal_cdf(z):
    return 0.5 * math.erfc(-z / math.sqrt(2.0))


@borrowing_kernel
def _sample_cdf(cdf, u):
    k = 0
    while k < cdf.shape[0] - 1 and u >= cdf[k]:
        k += 1
    return k


@borrowing_kernel
def _misread(table, codes, is_hidden, height, narrowed, blur, draws, cdf, out):
    grid, lines, letters = parts_of(table)
    heights, angles, blurs, miss_grid, fragment_grid, space_grid, level_grid = grid
    level_rate, edit_cdf, kept_quantiles, kept_begin, length_exponent, space_proneness, miss_length, garbled_rate = (
        lines
    )
    characters, proneness, confusion_code, confusion_cdf, added_code, added_cdf = letters
    i, wi = _grid_weight(heights, height)
    j, wj = _grid_weight(angles, narrowed)
    k, wk = _grid_weight(blurs, blur)
    levels = level_rate.shape[0]
    miss = fragment = space_loss = 0.0
    cdf[:] = 0.0
    for a in range(2):
        for b in range(2):
            for c in range(2):
                w = (wi if a else 1.0 - wi) * (wj if b else 1.0 - wj) * (wk if c else 1.0 - wk)
                if w == 0.0:
                    continue
                miss += w * miss_grid[i + a, j + b, k + c]
                fragment += w * fragment_grid[i + a, j + b, k + c]
                space_loss += w * space_grid[i + a, j + b, k + c]
                for q in range(levels):
                    cdf[q] += w * level_grid[i + a, j + b, k + c, q]
    n = codes.shape[0]
    visible = 0
    for m in range(n):
        if not is_hidden[m]:
            visible += 1
    if visible == 0:
        return 0
    odds = (miss_length / visible) ** length_exponent
    miss *= odds / (1.0 - miss + miss * odds)
    # The quality of a line is one number: the worst lines are missed, the next have the highest error level.
    quality = _normal_cdf(draws[0])
    if quality < miss:
        return 0
    level = _sample_cdf(cdf, (quality - miss) / (1.0 - miss))
    rate = level_rate[level]
    garbled = 1 if rate >= garbled_rate else 0

    begin, end = 0, visible
    if visible > 1 and _normal_cdf(draws[1]) < fragment:
        u = _normal_cdf(draws[2])
        keeps_begin = u < kept_begin
        u = u / kept_begin if keeps_begin else (u - kept_begin) / (1.0 - kept_begin)
        at = min(max(u, 0.0), 1.0) * (kept_quantiles.shape[0] - 1)
        low = min(int(at), kept_quantiles.shape[0] - 2)
        share = kept_quantiles[low] + (at - low) * (kept_quantiles[low + 1] - kept_quantiles[low])
        kept = min(max(int(round(share * visible)), 1), visible)
        begin, end = (0, kept) if keeps_begin else (visible - kept, visible)

    count = 0
    visible_index = -1
    for m in range(n):
        if is_hidden[m]:
            continue
        visible_index += 1
        if visible_index < begin or visible_index >= end:
            continue
        code = codes[m]
        u_error = _normal_cdf(draws[3 + m])
        if code == 32:
            by_digit = (m > 0 and 48 <= codes[m - 1] <= 57) or (m < n - 1 and 48 <= codes[m + 1] <= 57)
            if u_error >= space_loss * space_proneness[1 if by_digit else 0]:
                out[count] = code
                count += 1
            continue
        folded = code - 32 if 97 <= code <= 122 else code
        row = np.searchsorted(characters, folded)
        if row >= characters.shape[0] or characters[row] != folded:
            row = characters.shape[0]
        if u_error >= rate * proneness[garbled, row]:
            out[count] = code
            count += 1
            continue
        u_what = _normal_cdf(draws[3 + n + m])
        if u_what < edit_cdf[level, 0]:
            out[count] = confusion_code[
                garbled, row, _sample_cdf(confusion_cdf[garbled, row], u_what / edit_cdf[level, 0])
            ]
            count += 1
        elif u_what >= edit_cdf[level, 1]:
            u = (u_what - edit_cdf[level, 1]) / max(1.0 - edit_cdf[level, 1], 1e-12)
            out[count] = code
            out[count + 1] = added_code[_sample_cdf(added_cdf, u)]
            count += 2
    return count


@borrowing_kernel
def misread_signs(
    table, sight_count, sights, hidden, fresh, first, codes, lengths, kept, weights, draws, cdf, out, counts
):  # fmt: skip
    """Fill out and counts with one reading per sight (k, 6); the random numbers are partly the signs' own, partly
    `fresh` from `first` on. Returns the index of the next fresh one."""
    for k in range(sight_count):
        sign = int(sights[k, 0])
        count = lengths[sign]
        for m in range(LINE_DRAWS + 2 * count):
            draws[m] = kept[sign, m] + weights[sign, m] * fresh[first + m]
        first += LINE_DRAWS + 2 * count
        height, width, blur = sights[k, 3], math.cos(sights[k, 4]), sights[k, 5]
        counts[k] = _misread(
            table, codes[sign, :count], hidden[k, :count], height, 1.0 - width, blur / (height * width), draws, cdf,
            out[k],
        )  # fmt: skip
    return first


# --- two probabilities (papers.md T3) ---

_CONFUSABLE = dict(zip("OISBAEZ" + "0158432", "0158432" + "OISBAEZ", strict=True))
_CONFUSABLE_SHARE = 0.7
"""Share of the substitutions by the similar character, if there is one."""
_SUBSTITUTION_SHARE, _DELETION_SHARE = 0.70, 0.15
"""Shares of all character errors; the rest are insertions."""
_FRAGMENT_MIN, _FRAGMENT_MAX = 0.10, 0.45
_ALPHABET = "ABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789"


def misread(text: str, config: SignsConfig, random: np.random.Generator) -> str:
    """One reading of a text: a fragment, or the text with substitutions, deletions and insertions (papers.md T3)."""
    if random.random() < config.fragment_probability:
        length = max(1, round(len(text) * random.uniform(_FRAGMENT_MIN, _FRAGMENT_MAX)))
        begin = int(random.integers(0, len(text) - length + 1))
        return text[begin : begin + length]
    wrong = random.random(len(text)) < config.character_error_probability
    if not wrong.any():
        return text
    return "".join(
        _wrong_character(character, random) if is_wrong else character
        for character, is_wrong in zip(text, wrong, strict=True)
    )


def _wrong_character(character: str, random: np.random.Generator) -> str:
    kind = random.random()
    if kind < _SUBSTITUTION_SHARE:
        return _substitute(character, random)
    if kind < _SUBSTITUTION_SHARE + _DELETION_SHARE:
        return ""
    return character + _any_character(random)


def _substitute(character: str, random: np.random.Generator) -> str:
    """A different character: mostly the similar one, if there is one."""
    alike = _CONFUSABLE.get(character.upper())
    if alike and random.random() < _CONFUSABLE_SHARE:
        return alike
    other = _any_character(random)
    while other == character.upper():
        other = _any_character(random)
    return other


def _any_character(random: np.random.Generator) -> str:
    return _ALPHABET[int(random.integers(len(_ALPHABET)))]
