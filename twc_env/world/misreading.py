"""What OCR makes of a text: drawn from the measured table, or by the two plain numbers of papers.md T3."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.config import SignsConfig
from twc_env.kernels import Lent, borrowing_kernel, bound, parts_of
from twc_env.world.ocr_table import GARBLED_RATE, MISS_LENGTH, OcrTable

CODES = "utf-32"
"""Code points as this machine keeps them; Python knows this name at once and looks up "utf-32-le" every time."""
LINE_DRAWS = 3
"""Numbers drawn per line; two more for each of its characters."""


def draw_count(text: str) -> int:
    """How many standard normal numbers one reading of a text takes."""
    return LINE_DRAWS + 2 * len(text)


def shares(table: OcrTable, text: str) -> Array:
    """(draws,) which part of each drawn number's variance stays with the sign."""
    return np.repeat([table.line_share, table.letter_share], [LINE_DRAWS, 2 * len(text)])


def codes_of(text: str) -> Array:
    """(characters,) uint32 code points."""
    return np.frombuffer(text.encode("utf-32-le"), np.uint32)


class TableReader:
    """Draws readings from the measured table."""

    def __init__(self, table: OcrTable):
        t = table
        # The angle tells by how much it narrows the letters: between two angles, the share lost counts.
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
        """For `misread_signs`."""
        self._levels = np.empty(len(t.level_rate))
        self._run: Callable[..., None] | None = None
        """`misread_signs` with the table."""

    def read(
        self, codes: Array, is_hidden: Array, height_px: float, incidence_rad: float, blur_px: float, draws: Array
    ) -> str:
        """One reading of a text (n,) of which the characters `is_hidden` (n,) cannot be seen; "" when missed.

        `draws` (3 + 2 n) are standard normal: whoever repeats some of them repeats the same mistakes.
        """
        out, width = np.empty(2 * len(codes) + 1, np.uint32), math.cos(incidence_rad)
        count = _misread(
            self.table, codes, is_hidden, height_px, 1.0 - width, blur_px / (height_px * width), draws, self._levels,
            out,
        )  # fmt: skip
        return out[:count].tobytes().decode(CODES).strip()

    def read_signs(self, sights: Array, hidden: Array, texts: SignTexts, fresh: Array) -> list[str]:
        """One reading of each sign in view; sights and hidden as `look` fills them, one row for each.

        fresh: standard normal, as many as `draw_count` says of each text, one after the other.
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
    """The texts of a building's signs, and what of a reading's luck stays with each sign; L: the longest text."""

    def __init__(self, table: OcrTable, texts: Sequence[str], plates: np.random.Generator):
        longest = max(map(len, texts), default=0)
        self.lengths = np.array([len(text) for text in texts], np.int64)
        self.codes = np.zeros((len(texts), longest), np.uint32)
        """(signs, L) code points."""
        self.kept, self.weights = np.zeros((2, len(texts), LINE_DRAWS + 2 * longest))
        """(signs, 3 + 2 L) of each drawn number: what stays with the sign, and the weight of what is drawn anew."""
        for k, text in enumerate(texts):
            share = shares(table, text)
            self.codes[k, : len(text)] = codes_of(text)
            self.kept[k, : len(share)] = np.sqrt(share) * plates.standard_normal(len(share))
            self.weights[k, : len(share)] = np.sqrt(1.0 - share)
        self.out, self.counts = np.empty((len(texts), 2 * longest + 1), np.uint32), np.empty(len(texts), np.int64)
        """What `misread_signs` writes: code points read of each sign in view, and how many."""
        self.arguments = (
            self.codes, self.lengths, self.kept, self.weights, np.empty(LINE_DRAWS + 2 * longest),
            np.empty(len(table.level_rate)), self.out, self.counts,
        )  # fmt: skip


@borrowing_kernel
def _place(axis, value):
    """Index of the grid line below a value and the weight of the next, held at the ends."""
    last = axis.shape[0] - 2
    k = 0
    while k < last and value >= axis[k + 1]:
        k += 1
    weight = (value - axis[k]) / (axis[k + 1] - axis[k])
    return k, min(max(weight, 0.0), 1.0)


@borrowing_kernel
def _uniform(z):
    return 0.5 * math.erfc(-z / math.sqrt(2.0))


@borrowing_kernel
def _pick(cdf, u):
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
    i, wi = _place(heights, height)
    j, wj = _place(angles, narrowed)
    k, wk = _place(blurs, blur)
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
    # One number says how good the line is: the worst are missed, the next have the highest error level.
    quality = _uniform(draws[0])
    if quality < miss:
        return 0
    level = _pick(cdf, (quality - miss) / (1.0 - miss))
    rate = level_rate[level]
    garbled = 1 if rate >= garbled_rate else 0

    begin, end = 0, visible
    if visible > 1 and _uniform(draws[1]) < fragment:
        u = _uniform(draws[2])
        keeps_begin = u < kept_begin
        u = u / kept_begin if keeps_begin else (u - kept_begin) / (1.0 - kept_begin)
        at = min(max(u, 0.0), 1.0) * (kept_quantiles.shape[0] - 1)
        low = min(int(at), kept_quantiles.shape[0] - 2)
        share = kept_quantiles[low] + (at - low) * (kept_quantiles[low + 1] - kept_quantiles[low])
        kept = min(max(int(round(share * visible)), 1), visible)
        begin, end = (0, kept) if keeps_begin else (visible - kept, visible)

    count = 0
    at_visible = -1
    for m in range(n):
        if is_hidden[m]:
            continue
        at_visible += 1
        if at_visible < begin or at_visible >= end:
            continue
        code = codes[m]
        u_error = _uniform(draws[3 + m])
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
        u_what = _uniform(draws[3 + n + m])
        if u_what < edit_cdf[level, 0]:
            out[count] = confusion_code[garbled, row, _pick(confusion_cdf[garbled, row], u_what / edit_cdf[level, 0])]
            count += 1
        elif u_what >= edit_cdf[level, 1]:
            u = (u_what - edit_cdf[level, 1]) / max(1.0 - edit_cdf[level, 1], 1e-12)
            out[count] = code
            out[count + 1] = added_code[_pick(added_cdf, u)]
            count += 2
    return count


@borrowing_kernel
def misread_signs(
    table, sight_count, sights, hidden, fresh, first, codes, lengths, kept, weights, draws, cdf, out, counts
):  # fmt: skip
    """`_misread` of the first sights (k, 6), with draws of which part is kept and part fresh -> the next fresh one."""
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


# --- two plain numbers ---

_CONFUSABLE = dict(zip("OISBAEZ" + "0158432", "0158432" + "OISBAEZ", strict=True))
_CONFUSABLE_SHARE = 0.7
"""Share of the substitutions that take the look-alike, where there is one."""
_SUBSTITUTION_SHARE, _DELETION_SHARE = 0.70, 0.15
"""Of all character errors; the rest are insertions."""
_FRAGMENT_MIN, _FRAGMENT_MAX = 0.10, 0.45
_ALPHABET = "ABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789"


def misread(text: str, config: SignsConfig, random: np.random.Generator) -> str:
    """One OCR reading of a text: sometimes a fragment, else single characters changed, lost or added (papers.md T3)."""
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
    """A different character, more often than not the one that looks alike."""
    alike = _CONFUSABLE.get(character.upper())
    if alike and random.random() < _CONFUSABLE_SHARE:
        return alike
    other = _any_character(random)
    while other == character.upper():
        other = _any_character(random)
    return other


def _any_character(random: np.random.Generator) -> str:
    return _ALPHABET[int(random.integers(len(_ALPHABET)))]
