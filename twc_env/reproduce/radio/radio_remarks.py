"""Notes on the table of the radio model: shares of good figures, certainty of the real ones, reasons of misses."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

from twc_env.reproduce.radio.radio_study import NEAR, Figures, Study

_SURE = 0.95
"""A real figure is certain if this share of real places is near it."""


def notes(table: Sequence[dict], studies: Sequence[Study], evidence: Mapping[str, Figures]) -> Iterator[str]:
    """Sentences about the rows; `evidence` are figures of each set for the reasons of its study."""
    real = [row for row in table if row["real"]]
    for role in ("calibrated", "reported"):
        mine = [row for row in real if row["role"] == role]
        if mine:
            yield from _shares(role, mine)
    levels = [abs(row["simulated"] - row["real"]) for row in real if "[dBm]" in row["quantity"] and row["simulated"]]
    if levels:
        yield f"levels in dBm count as near by the same rule; in decibels they differ by {max(levels):.1f} at most"
    for study in studies:
        reasons = {key: reason.format(**evidence[study.name]) for key, reason in study.reasons.items()}
        for row in real:
            if row["dataset"] == study.name and not _is_near(row):
                ratio = "no figure" if row["simulated"] is None else f"x {row['simulated'] / row['real']:.2f}"
                reason = _reason(reasons, row["quantity"])
                yield f"missed: {study.name}, {row['quantity']} ({ratio}{_among(row)}): {reason}"


def _shares(role: str, rows: Sequence[dict]) -> Iterator[str]:
    near = sum(_is_near(row) for row in rows)
    yield f"{role}: {near} of {len(rows)} rows within {NEAR:.0%} of the real figure ({near / len(rows):.0%})"
    known = [row for row in rows if row["real_low"] is not None]
    if not known:
        return
    inside = sum(_is_inside(row) for row in known)
    yield f"{role}: {inside} of {len(known)} rows within the spread of real ones, where the data tells it"
    unsure = [row for row in known if row["real_near"] < _SURE]
    missed = sum(not _is_near(row) for row in unsure)
    near_known = sum(_is_near(row) for row in known)
    yield (
        f"{role}: of these {len(known)} rows {near_known} are within {NEAR:.0%}, where other real places of the kind "
        f"would have {sum(row['real_near'] for row in known):.1f}; {len(unsure)} real figures are themselves less sure "
        f"than {NEAR:.0%}, and {missed} of the {len(known) - near_known} misses are among them"
    )


def _is_near(row: dict) -> bool:
    return row["simulated"] is not None and abs(row["simulated"] / row["real"] - 1.0) <= NEAR


def _is_inside(row: dict) -> bool:
    if row["simulated"] is None or row["real_low"] is None:
        return False
    return bool(row["real_low"] <= row["simulated"] <= row["real_high"])


def _among(row: dict) -> str:
    """Comparison of a miss with the spread of real places."""
    if row["real_low"] is None:
        return ""
    inside = ", within the real spread" if _is_inside(row) else ""
    return f"{inside}, {row['real_near']:.0%} of real places come near"


def _reason(reasons: Mapping[str, str], quantity: str) -> str:
    """The reason with the longest key that is a prefix of the quantity."""
    fitting = [key for key in reasons if quantity.startswith(key)]
    return reasons[max(fitting, key=len)] if fitting else "not understood"
