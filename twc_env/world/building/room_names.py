"""Unique room names of generated buildings."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

_NOUNS = (
    "ARCHIVE", "BINDERY", "CERAMICS", "DARKROOM", "ELECTRONICS", "FOUNDRY", "GEOLOGY", "HERBARIUM", "IMAGING",
    "JOINERY", "KITCHEN", "LIBRARY", "MAILROOM", "NETWORKS", "OPTICS", "PRINTING", "QUALITY", "ROBOTICS", "SEMINAR",
    "TEXTILES", "UTILITY", "VACUUM LAB", "WORKSHOP", "X-RAY", "YEAST LAB", "ZOOLOGY",
)  # fmt: skip
_WARD_NOUNS = (
    "BURNS", "CARDIOLOGY", "DIALYSIS", "ENDOSCOPY", "FRACTURES", "GENETICS", "HAND CLINIC", "INFUSION", "LINEN",
    "MATERNITY", "NEUROLOGY", "ONCOLOGY", "PHARMACY", "RECOVERY", "SURGERY", "TRAUMA", "UROLOGY", "VISITORS",
)  # fmt: skip
_SYLLABLES = (
    "BA", "CO", "DE", "FI", "GU", "HO", "JA", "KE", "LU", "MI", "NO", "PA", "RE", "SO", "TI", "VE", "WI", "ZA",
)  # fmt: skip


def letters(number: int) -> str:
    """A, B, ..., Z, AA, AB, ..."""
    return chr(65 + number % 26) if number < 26 else letters(number // 26 - 1) + chr(65 + number % 26)


def room_label(number: int) -> str:
    """ "A101 ARCHIVE", "A102 HERBARIUM", ..."""
    wing, place = divmod(number, 40)
    noun = _NOUNS[(number * 7 + wing) % len(_NOUNS)]
    return f"{letters(wing)}{101 + place} {noun}"


def ward_label(number: int) -> str:
    """ "A11 BURNS", "A12 HAND CLINIC", ..."""
    wing, place = divmod(number, 30)
    return f"{letters(wing)}{11 + place} {_WARD_NOUNS[(number * 5 + wing) % len(_WARD_NOUNS)]}"


def shop_label(random: np.random.Generator) -> Callable[[int], str]:
    """Unique invented shop names of two to four syllables."""
    names: list[str] = []

    def label(number: int) -> str:
        while len(names) <= number:
            syllables = random.integers(0, len(_SYLLABLES), int(random.integers(2, 5)))
            name = "".join(_SYLLABLES[i] for i in syllables)
            if name not in names:
                names.append(name)
        return names[number]

    return label
