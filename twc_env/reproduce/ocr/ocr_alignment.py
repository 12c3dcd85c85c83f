"""Alignment of a reading with its true text: the reading of each character, and whether it is a fragment."""

from __future__ import annotations

from rapidfuzz.distance import Levenshtein

from twc_env.slam.places.text_similarity import normalise

FRAGMENT_SHARE_MIN, FRAGMENT_CHARACTERS_MIN = 0.2, 2
"""Minimum share and number of characters missing at the ends of a fragment."""


class Aligned:
    """One reading aligned with its true text."""

    def __init__(self, truth: str, reading: str):
        self.truth, self.reading = truth.upper(), normalise(reading)
        n = len(self.truth)
        self.became: list[str | None] = list(self.truth)
        """The reading of each character, None if it was lost."""
        self.added: list[str] = [""] * n
        for edit in Levenshtein.editops(self.truth, self.reading):
            if edit.tag == "replace":
                self.became[edit.src_pos] = self.reading[edit.dest_pos]
            elif edit.tag == "delete":
                self.became[edit.src_pos] = None
            else:
                self.added[max(edit.src_pos - 1, 0)] += self.reading[edit.dest_pos]
        kept = [k for k in range(n) if self.became[k] is not None]
        self.is_missed = not kept
        begin, end = (kept[0], kept[-1] + 1) if kept else (0, 0)
        lost = n - (end - begin)
        self.is_fragment = not self.is_missed and lost >= max(FRAGMENT_CHARACTERS_MIN, FRAGMENT_SHARE_MIN * n)
        self.keeps_begin = begin <= n - end
        if not self.is_fragment:
            begin, end = 0, 0 if self.is_missed else n
        self.span = range(begin, end)
        """Indices of the characters of the fragment that was read."""
        self.kept_share = len(self.span) / n
        self.letters = [k for k in self.span if self.truth[k] != " "]
        self.wrong = [k for k in self.letters if self.became[k] != self.truth[k] or self.added[k]]
        self.spaces = [k for k in self.span if self.truth[k] == " "]
        self.spaces_lost = [k for k in self.spaces if self.became[k] != " "]
