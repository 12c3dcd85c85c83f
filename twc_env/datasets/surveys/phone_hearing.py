"""Fingerprints over time from the WiFi scan lists of a phone.

A list holds rows of the last sweep and older ones from the memory of the phone; each row has the time when it was
heard. One radio has several addresses, which differ in their first byte or last digit: they count as one.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.records.messages import Fingerprint

SWEEP_S = 2.0
"""Duration of one sweep over all channels; the list is reported at its end."""
AVERAGING_STD_S, AVERAGING_REACH = 1.25, 2.5
"""Readings are averaged over time with a Gaussian of this width, truncated at this many widths. Set on indoor20."""
HIGH_BAND_MHZ = 4000
RADIO_BITS = 0x00FFFFFFFFF0
"""Bits of an address that are equal for all addresses of one radio."""


def fingerprints(rows: list[list[str]]) -> tuple[Array, list[Fingerprint]]:
    """Times (n,) [s] of the middle of each sweep, and its fingerprint, from the words of TYPE_WIFI lines.

    Raises ValueError or IndexError for missing words and invalid numbers.
    """
    readings = np.array(
        sorted({(_radio(w[3], float(w[5])), float(w[6]) / 1000, float(w[4]), w[3]) for w in rows}), object
    )
    at_s = np.array(sorted({float(w[0]) / 1000 for w in rows})) - SWEEP_S / 2
    if not len(readings):
        return at_s, []
    radios, radio = np.unique(readings[:, 0].astype(np.int64), return_inverse=True)
    heard_s, rssi_dbm = readings[:, 1].astype(float), readings[:, 2].astype(float)
    away = np.abs(at_s[:, None] - heard_s[None]) / AVERAGING_STD_S
    weight = np.where(away <= AVERAGING_REACH, np.exp(-0.5 * away**2), 0.0)
    prints = []
    for row in weight:
        total = np.bincount(radio, row, len(radios))
        is_heard = total > 0.0
        level = np.bincount(radio, row * rssi_dbm, len(radios))[is_heard] / total[is_heard]
        prints.append(Fingerprint(radios[is_heard], level))
    return at_s, prints


def _radio(name: str, mhz: float) -> int:
    """One number for all addresses of a radio in a band."""
    address = int(name.replace(":", ""), 16)
    if ":" not in name:
        address &= (1 << 48) - 1
    elif address >> 48:
        raise ValueError(f"{name} is no address of six bytes")
    return (address & RADIO_BITS) | (mhz > HIGH_BAND_MHZ)
