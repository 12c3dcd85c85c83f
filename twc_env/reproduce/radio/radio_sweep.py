"""Error of radio SLAM in the semi-indoor twin by number of access points, drift and path length."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from functools import partial

import numpy as np

from twc_env.reproduce.radio import radio_methods, radio_walks
from twc_env.reproduce.radio.radio_twins import PLACES, Place, record
from twc_env.reproduce.runner import Runner

AP_SHARES = (0.1, 0.25, 0.5, 1.0)
ODOMETRY_ERRORS_M = (5.0, 15.0, 52.0)
LENGTHS_M = (300.0, 600.0, 1200.0, 2400.0)
METHODS = {"odometry": radio_methods.odometry, "wifi": radio_methods.radio("ours")}

Cases = dict[str, tuple[Place, float]]
"""Varied quantity -> the place, and the share of its access points that is heard."""


def rows(seeds: Sequence[int], runner: Runner, share: float, processes: int) -> list[dict]:
    """One row per case and method; means over seeds."""
    cases = _cases(PLACES["semi-indoor"], share)
    found = runner.grid(cases, seeds, partial(_measured, cases), processes)
    table = []
    for case, mine in found.items():
        heard = np.mean([result["heard"] for result in mine])
        for method in METHODS:
            errors = radio_methods.means([result[method] for result in mine])
            name = f"semi-indoor, {case} ({heard:.0f} heard per scan)"
            nothing_printed = {"paper_mean_m": None, "paper_std_m": None}
            table.append({"environment": name, "method": method, **errors, **nothing_printed, "seeds": len(mine)})
    return table


def _cases(whole: Place, share: float) -> Cases:
    """Cases named by their values at full length; this share of the length is walked, with drift scaled likewise."""
    cases = {f"{s:.0%} of the access points": (whole, s) for s in AP_SHARES}
    for error_m in ODOMETRY_ERRORS_M:
        place = dataclasses.replace(whole, odometry_m=error_m, drift=whole.drift * error_m / whole.odometry_m)
        cases[f"odometry off by {error_m:g} m"] = place, 1.0
    for length_m in LENGTHS_M:
        cases[f"{length_m:.0f} m walked"] = whole.shortened(length_m / whole.length_m), 1.0
    return {name: (place.shortened(share), heard) for name, (place, heard) in cases.items()}


def _measured(cases: Cases, case: str, seed: int) -> dict:
    place, ap_share = cases[case]
    walk = record(place, "wifi", seed)
    if ap_share < 1.0:
        walk = dataclasses.replace(walk, fingerprints=radio_walks.subsampled(walk.fingerprints, ap_share, seed))
    heard = float(np.mean([len(f.macs) for f in walk.fingerprints]))
    return {"heard": heard, **{name: run(place, walk, seed).errors() for name, run in METHODS.items()}}
