"""Merging of saved maps without initial guess: pairs cut from real buildings, and pairs that must not merge.

Pairs that overlap are two parts of a ROS map, a map of ipa's collection or a HouseExpo plan, on both sides of a random
direction; 20 to 80 % of the floor of each are common. Each part is saved as a mapping run of its own would save it
(`map_cuts`): turned, with another origin, half of them with another resolution, walls bent by 4 cm and rough by 2 cm,
with holes, and with things that the other run did not see. Pairs that must not merge are parts of two buildings, parts
of one building that do not overlap, and one of two identical wings against both. A merge is right within 0.2 m and 2
degrees, measured at the middle of the second map's floor.

`ambiguous` counts those of the pairs kept apart that nobody can place: laid on each other without any error of the
runs, and with the truth known, the two parts have a placement elsewhere at which nothing contradicts and at least as
much wall agrees as at the true one. None of them counts as right.

Buildings of at least 100 m2 are taken; of the HouseExpo plans every second one by name, and not two whose outline is
broken or bare. The others, with ipa's Freiburg52, lab_d, lab_f, office_b and office_d, are where the method was
calibrated.
"""

from __future__ import annotations

import argparse
from functools import cache
from pathlib import Path
from typing import NamedTuple

import numpy as np

from twc_env.errors import DataError
from twc_env.offline.map_merge import read_saved_maps
from twc_env.records.geometry import between, compose
from twc_env.reproduce.maps.map_cuts import Cut, overlap_of, overlapping_parts, saved_parts, twice
from twc_env.reproduce.runner import Runner, data_folder
from twc_env.running.options import count, natural
from twc_env.slam.saved_maps.placement import OTHER_M, OTHER_RAD, agreement_at, place, ranked_placements
from twc_env.slam.saved_maps.saved_map import SavedMap, cell_of, compared

CHOOSES = ("pairs", "false_pairs")
ROS = ("ros/intel.yaml", "ros/willow-2010-02-18-0.10.yaml")
IPA = ("Freiburg101_scan", "Freiburg79_scan", "NLB", "lab_ipa", "office_a")
CALIBRATED_ON = ("Freiburg52_scan", "lab_d_scan", "lab_f_scan", "office_b", "office_d")
"""Maps of ipa's collection of which this table shows nothing; lab_intel is the building of ROS's intel."""
BROKEN = ("003ecdd4fe76", "02932495ca2a")
"""HouseExpo plans that touch themselves, or show four bare walls."""
AREA_MIN_M2 = 100.0
RIGHT_M, RIGHT_DEG = 0.2, 2.0
BANDS = ((0.2, 0.35), (0.35, 0.5), (0.5, 0.65), (0.65, 0.8))
PART_MIN_M2 = 30.0
FALSE_KINDS = ("two buildings", "no overlap", "identical wings")
RESOLUTIONS_M = ((0.05, 0.05), (0.05, 0.1), (0.05, 0.05), (0.1, 0.05))


class Case(NamedTuple):
    """One pair: its kind (a band of overlap, or one of FALSE_KINDS), its number and the file of its building."""

    kind: str
    number: int
    building: str

    def __str__(self) -> str:
        return f"{self.kind} {self.number} {Path(self.building).stem}"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of `twc-env reproduce saved-maps`."""
    parser.add_argument("--pairs", type=count, default=100, help="pairs that overlap")
    parser.add_argument("--false-pairs", type=count, default=50, help="pairs that must not merge")
    parser.add_argument("--first", type=natural, default=0, help="number of the first pair; others are other draws")
    parser.add_argument("--calibration", action="store_true", help="of the buildings where the method was calibrated")
    parser.add_argument("--jobs", type=count, default=2, help="parallel processes")


def rows(options: argparse.Namespace, runner: Runner) -> list[dict]:
    """One row per band of overlap and per kind of false pair."""
    files = buildings(data_folder(), options.calibration)
    cases = [
        Case(kinds[k % len(kinds)], k, files[k % len(files)])
        for kinds, number in (([band_name(band) for band in BANDS], options.pairs), (FALSE_KINDS, options.false_pairs))
        for k in range(options.first, options.first + number)
    ]
    results = runner.each(cases, try_case, processes=options.jobs)
    table: dict[str, list[dict]] = {}
    for case, result in zip(cases, results, strict=True):
        table.setdefault(case.kind, []).append(result)
        if result["is_accepted"] and not result["is_right"]:
            runner.notes.append(
                f"wrong: {case}, {result['error_m']:.2f} m, {result['error_deg']:.1f} degrees, certainty "
                f"{result['certainty']:.2f}"
            )
        if not result["is_accepted"] and case.kind not in FALSE_KINDS:
            what = "ambiguous" if result["is_ambiguous"] else "kept apart"
            runner.notes.append(f"{what}: {case}, {result['reason']}")
    order = [*(band_name(band) for band in BANDS), *FALSE_KINDS]
    return [_row(kind, table[kind]) for kind in order if kind in table]


def band_name(band: tuple[float, float]) -> str:
    """The name of a band of overlap."""
    return f"overlap {100 * band[0]:.0f} to {100 * band[1]:.0f} %"


def buildings(folder: Path, is_calibration: bool = False) -> list[str]:
    """Files of the maps that the table shows, or of those on which the method was calibrated."""
    plans = sorted((folder / "houseexpo").glob("*.json"))
    plans = [plan for plan in plans[0 if is_calibration else 1 :: 2] if plan.stem[:12] not in BROKEN]
    ipa = [folder / "maps" / "ipa" / f"{name}.png" for name in (CALIBRATED_ON if is_calibration else IPA)]
    ros = [] if is_calibration else [folder / "maps" / name for name in ROS]
    if lacking := [path for path in (*ros, *ipa) if not path.is_file()]:
        raise DataError(f"{lacking[0]} is missing; docs/real_data.md lists what TWC_DATA holds")
    wide = [path for path in plans if _area_m2(_building(str(path))) >= AREA_MIN_M2]
    return [str(path) for path in (*ros, *ipa, *wide)]


def try_case(case: Case) -> dict:
    """Place one pair, and judge the result."""
    cut = make_pair(case)
    placement = place(cut.target, cut.source)
    best = placement.best
    error_m, error_deg = (None, None) if best is None else error_of(cut, best.pose)
    is_right = error_m is not None and error_deg is not None and error_m <= RIGHT_M and error_deg <= RIGHT_DEG
    return {
        "is_accepted": placement.is_believed,
        "certainty": placement.certainty,
        "is_right": is_right and case.kind not in FALSE_KINDS,
        "overlap": cut.overlap,
        "error_m": error_m,
        "error_deg": error_deg,
        "is_ambiguous": case.kind not in FALSE_KINDS and not placement.is_believed and is_ambiguous(cut),
        "reason": placement.reason,
    }


def is_ambiguous(cut: Cut) -> bool:
    """Whether the parts as the building shows them fit elsewhere at least as well as where they belong."""
    target, source = cut.without_errors
    known, cell_m = Cut(target, source, np.zeros(3), cut.overlap), cell_of([target, source])
    true = agreement_at(compared(target, cell_m), compared(source, cell_m), known.pose)
    for one in ranked_placements(target, source):
        error_m, error_deg = error_of(known, one.pose)
        is_elsewhere = error_m >= OTHER_M or np.radians(error_deg) >= OTHER_RAD
        if is_elsewhere and one.contradicting_m == 0.0 and one.agreeing_m >= true.agreeing_m:
            return True
    return False


def make_pair(case: Case) -> Cut:
    """The two maps of a case; equal cases give equal maps."""
    random = np.random.default_rng([hash_of(case.kind), case.number])
    building = _building(case.building)
    first_m, second_m = RESOLUTIONS_M[int(random.integers(len(RESOLUTIONS_M)))]
    resolutions_m = max(building.resolution_m, first_m), max(building.resolution_m, second_m)
    if case.kind == "two buildings":
        files = buildings(data_folder(), is_calibration=case.building not in buildings(data_folder()))
        others = [file for file in files if file != case.building]
        other = _building(others[int(random.integers(len(others)))])
        cuts = [saved_parts(b, overlapping_parts(b, 0.5, random), resolutions_m, random) for b in (building, other)]
        return Cut(cuts[0].target, cuts[1].source, np.zeros(3), 0.0)
    if case.kind == "no overlap":
        return saved_parts(building, overlapping_parts(building, -0.15, random), resolutions_m, random)
    if case.kind == "identical wings":
        pair, floor = twice(building, overlapping_parts(building, 0.2, random)[0])
        one = floor.copy()
        one[:, floor.shape[1] // 2 :] = False
        return saved_parts(pair, (floor, one), resolutions_m, random)
    low, high = next(band for band in BANDS if band_name(band) == case.kind)
    for _ in range(100):
        parts = overlapping_parts(building, random.uniform(low, high), random)
        is_large = min(int(part.sum()) for part in parts) * building.resolution_m**2 >= PART_MIN_M2
        if low <= overlap_of(parts) <= high and is_large:
            return saved_parts(building, parts, resolutions_m, random)
    raise DataError(f"{case.building} cannot be cut into parts that {case.kind}; leave it out")


def error_of(cut: Cut, pose: np.ndarray) -> tuple[float, float]:
    """Errors [m, degrees] of the source's pose, at the middle of its floor."""
    row, column = np.argwhere(cut.source.free).mean(axis=0) + 0.5
    middle = compose(cut.source.origin, np.array([column, row, 0.0]) * cut.source.resolution_m)
    away = between(compose(cut.pose, middle), compose(pose, middle))
    return float(np.hypot(away[0], away[1])), float(abs(np.degrees(away[2])))


def hash_of(text: str) -> int:
    """A number of a text that is the same in all processes."""
    return int.from_bytes(text.encode()[-8:], "little") % 2**32


@cache
def _building(path: str) -> SavedMap:
    return read_saved_maps([path])[0]


def _area_m2(saved: SavedMap) -> float:
    return float(saved.free.sum()) * saved.resolution_m**2


def _row(kind: str, results: list[dict]) -> dict:
    accepted = [result for result in results if result["is_accepted"]]
    right = [result for result in accepted if result["is_right"]]
    errors_m, errors_deg = ([result[key] for result in right] for key in ("error_m", "error_deg"))
    return {
        "kind": kind,
        "pairs": len(results),
        "accepted": len(accepted),
        "right": len(right),
        "wrong": len(accepted) - len(right),
        "abstained": len(results) - len(accepted),
        "ambiguous": None if kind in FALSE_KINDS else sum(result["is_ambiguous"] for result in results),
        "median_error_m": float(np.median(errors_m)) if right else None,
        "median_error_deg": float(np.median(errors_deg)) if right else None,
    }
