"""Validation of fingerprints from callers; comparisons rely on ascending addresses and equal lengths."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike
from numpy.typing import NDArray as Array

from twc_env.errors import UNFIT, DataError
from twc_env.records.messages import Fingerprint

_RSSI_MIN_DBM, _RSSI_MAX_DBM = -200.0, 30.0
"""No receiver hears so little, far below thermal noise, or more: the first and less are marks, such as -999."""
_ADDRESS_MAX = np.iinfo(np.int64).max


def validated_fingerprints(fingerprints: Sequence[Fingerprint]) -> tuple[Fingerprint, ...]:
    """The fingerprints, with arrays as fields. Raises DataError for invalid ones."""
    return tuple(validated_fingerprint(each, f"fingerprint {k}") for k, each in enumerate(fingerprints))


def validated_fingerprint(fingerprint: Fingerprint, name: str = "the fingerprint") -> Fingerprint:
    """The fingerprint, with arrays as fields. Raises DataError if it is invalid."""
    if not isinstance(fingerprint, Fingerprint):
        raise DataError(f"{name} is {fingerprint!r}: give an empty Fingerprint where nothing was heard")
    try:
        macs, rssi_dbm = np.asarray(fingerprint.macs), np.asarray(fingerprint.rssi_dbm, float)
    except UNFIT as error:
        raise DataError(f"{name} must hold numbers: {error}") from None
    if fault := fault_of_readings(macs, rssi_dbm):
        raise DataError(f"{name} has {fault}")
    if macs is fingerprint.macs and macs.dtype.kind == "i" and rssi_dbm is fingerprint.rssi_dbm:
        return fingerprint
    return Fingerprint(macs.astype(np.int64), rssi_dbm)


def fault_of_readings(macs: ArrayLike, rssi_dbm: ArrayLike) -> str | None:
    """What is invalid about addresses and RSSI of one scan; None if nothing is."""
    macs = np.asarray(macs)
    if macs.ndim != 1 or macs.shape != np.shape(rssi_dbm):
        return f"addresses of shape {macs.shape} and strengths of {np.shape(rssi_dbm)}: one for each"
    if len(macs) and macs.dtype.kind not in "iu":
        example = f"such as {macs[0]!r}: int(mac.replace(':', ''), 16) makes one of text"
        return f"addresses that are not whole numbers, {example}"
    if not (macs[1:] > macs[:-1]).all():  # differences of unsigned numbers are never negative
        return "addresses that do not ascend: sort them, each but once"
    if len(macs) and macs[-1] > _ADDRESS_MAX:
        return f"address {macs[-1]}, which has more than 63 bits"
    if not np.isfinite(rssi_dbm).all():
        return "a strength that is not finite: leave out what was not heard"
    return fault_of_strengths(np.asarray(rssi_dbm))


def fault_of_strengths(rssi_dbm: Array) -> str | None:
    """What is wrong with strengths: a mark of fingerprint sets for "not heard" among others, 100, 0 or -999; or another
    unit, where none is below 0 and some exceed 30 (per cent, or no sign). None if they are dBm; only finite ones count.
    """
    is_odd = (rssi_dbm > _RSSI_MAX_DBM) | (rssi_dbm == 0.0) | ((rssi_dbm <= _RSSI_MIN_DBM) & (rssi_dbm > -np.inf))
    if (rssi_dbm < 0.0).any():
        return f"a strength of {rssi_dbm[is_odd][0]:g} dBm: leave out what was not heard" if is_odd.any() else None
    told = rssi_dbm[np.isfinite(rssi_dbm)]
    is_other = told.size and (told.max() > _RSSI_MAX_DBM or not told.any())
    return f"strengths from {told.min():g} to {told.max():g}: give dBm, such as -67" if is_other else None
