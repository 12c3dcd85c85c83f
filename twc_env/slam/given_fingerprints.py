"""Fingerprints that callers outside bring: looked at before they are compared, which trusts their order and length."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from twc_env.errors import DataError
from twc_env.messages import Fingerprint


def given_fingerprints(fingerprints: Sequence[Fingerprint], name: str = "fingerprint") -> tuple[Fingerprint, ...]:
    """The same, of arrays. Raises DataError for what is none, or holds what no receiver hears."""
    return tuple(given_fingerprint(each, f"{name} {k}") for k, each in enumerate(fingerprints))


def given_fingerprint(fingerprint: Fingerprint, name: str = "the fingerprint") -> Fingerprint:
    """The same, of arrays. Raises DataError as `given_fingerprints`."""
    if not isinstance(fingerprint, Fingerprint):
        raise DataError(f"{name} is {fingerprint!r}: give an empty Fingerprint where nothing was heard")
    try:
        macs, rssi_dbm = np.asarray(fingerprint.macs), np.asarray(fingerprint.rssi_dbm, float)
    except (TypeError, ValueError) as error:
        raise DataError(f"{name} must hold numbers: {error}") from None
    if macs.ndim != 1 or macs.shape != rssi_dbm.shape:
        raise DataError(f"{name} has addresses of shape {macs.shape} and strengths of {rssi_dbm.shape}: one for each")
    if len(macs) and macs.dtype.kind not in "iu":
        raise DataError(f"{name} has addresses of type {macs.dtype}: they are whole numbers")
    if not (macs[1:] > macs[:-1]).all():
        raise DataError(f"{name} has addresses that do not ascend: sort them, each but once")
    if not np.isfinite(rssi_dbm).all():
        raise DataError(f"{name} has a strength that is not finite: leave out what was not heard")
    if macs is fingerprint.macs and rssi_dbm is fingerprint.rssi_dbm:
        return fingerprint
    return Fingerprint(macs.astype(np.int64), rssi_dbm)
