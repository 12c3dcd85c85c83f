"""Detection curve of a real receiver from its own readings: detection floor, slope, and missed strong signals.

Positions of transmitters are not needed, so these can be set for a simulated receiver before both are compared.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray as Array
from scipy.optimize import minimize

from twc_env.datasets.surveys.fingerprints import RadioSurvey
from twc_env.errors import DataError

_FAINT_SHARE = 0.3
"""Share of the readings, the weakest, that the detection curve is fitted to."""
_BELOW_DB = 30.0
_STRONG_DB = 25.0
"""A signal this far above the detection floor is above it at neighbouring points too, where it differs by a few dB."""
_BESIDE_M = 1.6


def hearing(rssi_dbm: Array) -> tuple[float, float]:
    """Floor [dBm] and slope [dB] of the detection curve of a receiver, from its readings in whole dBm.

    Weak levels are assumed to be equally frequent, so that the counts of weak readings follow the detection curve.
    Maximum likelihood fit to the readings up to a level.
    """
    readings = rssi_dbm[np.isfinite(rssi_dbm)].astype(float)
    last = np.floor(np.quantile(readings, _FAINT_SHARE))
    levels = np.arange(readings.min() - _BELOW_DB, last + 1.0)
    counts = np.bincount(np.searchsorted(levels, np.round(readings[readings <= last])), minlength=len(levels))

    def unlikeliness(curve: Array) -> float:
        log_share = -np.logaddexp(0.0, (curve[0] - levels) / np.exp(curve[1]))
        return -float(counts @ (log_share - np.logaddexp.reduce(log_share))) / len(readings)

    start = [readings.min() + 5.0, 0.7]
    bounds = [(levels[0], last), (np.log(0.1), np.log(20.0))]
    floor_dbm, log_slope = minimize(unlikeliness, start, method="Nelder-Mead", bounds=bounds).x
    return float(floor_dbm), float(np.exp(log_slope))


def missed_share(survey: RadioSurvey, is_high: bool) -> float:
    """Share of the strong signals of a band that one receiver did not hear at neighbouring points."""
    rssi = survey.rssi_dbm[:, survey.transmitters[2] == is_high]
    is_beside = np.linalg.norm(survey.position_m[:, None] - survey.position_m[None], axis=2) < _BESIDE_M
    is_beside &= survey.floor[:, None] == survey.floor[None]
    here, beside = np.nonzero(is_beside & ~np.eye(len(is_beside), dtype=bool))
    is_strong = rssi[here] > hearing(rssi)[0] + _STRONG_DB
    return float(1.0 - np.isfinite(rssi[beside][is_strong]).mean()) if is_strong.any() else 0.0


def missed_by_sweeps(survey: RadioSurvey, is_high: bool) -> float:
    """Share of the strong signals of a band that a moving phone heard in one sweep and two sweeps later, but not in the
    sweep in between."""
    ages_s, high = survey.age_s, survey.is_high_band
    if ages_s is None or high is None:
        raise DataError(f"survey {survey.name} has no ages and bands of readings; use one that does")
    order = np.lexsort((survey.time_s, survey.walk))
    walk, time_s = survey.walk[order], survey.time_s[order]
    since_s = np.diff(time_s, prepend=np.nan)
    newest = np.where(ages_s[order] < since_s[:, None], survey.rssi_dbm[order], np.nan)[:, high == is_high]
    strong_dbm = hearing(newest)[0] + _STRONG_DB
    goes_on = walk[1:] == walk[:-1]
    between = np.flatnonzero(goes_on[:-2] & goes_on[1:-1] & goes_on[2:]) + 2
    is_strong = (newest[between - 1] > strong_dbm) & (newest[between + 1] > strong_dbm)
    return float(np.isnan(newest[between][is_strong]).mean()) if is_strong.any() else 0.0


def device_hearing(survey: RadioSurvey) -> dict:
    """Settings of the detection curves of the receiver of a survey, by band; without readings at 5 GHz those of 2.4
    alone. Raises DataError without any at 2.4 GHz."""
    low, high = (survey.rssi_dbm[:, survey.transmitters[2] == is_high] for is_high in (False, True))
    if not np.isfinite(low).any():
        raise DataError(f"survey {survey.name} has no readings at 2.4 GHz; use one that does")
    floor_dbm, slope_db = hearing(low)
    missed = missed_share(survey, False)
    found = {"detection_floor_dbm": floor_dbm, "detection_slope_db": slope_db, "miss_probability": missed}
    if not np.isfinite(high).any():
        return found
    high_dbm, high_db = hearing(high)
    band = {
        "detection_offset_db": high_dbm - floor_dbm,
        "detection_slope_factor": high_db / slope_db,
        "miss_probability_offset": missed_share(survey, True) - missed,
    }
    return {**found, "high_band": band}
