"""SLAM from odometry and radio fingerprints alone: a trajectory and a radio map, without knowing any transmitter.

Distance closures, derived from the similarity of fingerprints (radio SLAM Eq. 1-3), first correct the path
incrementally from its start. Then local models of signal strength around each place tie it to other visits nearby
(`radio_path`). `paper` performs the first step only, as published. Finally the whole path is optimised for the
likelihood of all readings (`radio_refinement`).

The odometry noise is unknown, so several assumptions are tried, and the result that best explains the readings without
straining the odometry is kept (`radio_evidence`). With several kinds of radio, each is also tried alone, since an
imprecise one distorts a precise one; then all readings select among the refined paths. If none explains the readings
better than the odometry, the odometry is returned.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray as Array
from scipy.stats import spearmanr

from twc_env.config import RadioSlamConfig
from twc_env.errors import UNFIT, DataError
from twc_env.kernels.blas_threads import one_blas_thread
from twc_env.records.fingerprint_validation import validated_fingerprints
from twc_env.records.geometry import between, compose, inverse, poses_along, wrap_angle
from twc_env.records.messages import Fingerprint, Keyframe
from twc_env.slam.odometry.odometry_calibration import Calibration, Motions, between_places, calibrated
from twc_env.slam.pose_graph.distance_factor import Distances, concatenate_distances
from twc_env.slam.pose_graph.solver import squared_errors
from twc_env.slam.radio import radio_closures, radio_cue, radio_field
from twc_env.slam.radio.radio_cue import CUES, RadioCue
from twc_env.slam.radio.radio_path import PathFit
from twc_env.slam.radio.radio_refinement import Refined, refined
from twc_env.slam.radio.similarity_model import SimilarityModel

PAPER_ITERATIONS = 60
NOISE_LEVELS = ((1.0, 1.0), (1.0, 3.0), (3.0, 3.0), (6.0, 6.0), (10.0, 10.0))
"""Assumed factors of the configured odometry noise in position and heading; each pair is tried."""
STRAIN_NOISE, EVIDENCE_WEIGHT = 3.0, 2.0
"""Odometry noise factor of the strain of a solution, and the weight of its evidence against the strain (an effective
number of transmitters, whose readings are far from independent)."""
STRAIN_MAX, EVIDENCE_LOSS_MAX, EXPLAINED_MIN, CURLS_RAD_M = 0.15, 20.0, 0.6, (-0.012, 0.012)
"""If every solution exceeds this strain per place or has this much less evidence than another, or if position explains
less than this share of the variance, the path is wrong from the start; it is then also started with these curls."""
ORDER_MIN, EVIDENCE_GAIN_MIN = 0.1, 0.5
"""Below this rank correlation of similarity and distance, readings carry no information. A path with this evidence gain
over odometry is accepted (its weight in the final fit is 20 to 1); with less gain only if its rank correlation is
higher than odometry's, since most pairs of places are far apart and dissimilar in any order."""
RANKED_PAIRS_MAX = 50_000
"""Maximum number of pairs of places for the rank correlation."""
POSITION_STD_MIN_M, HEADING_STD_MIN_RAD = 0.02, 0.005


@dataclass(frozen=True, slots=True, eq=False)
class RadioLog:
    """One robot's record, scan by scan (n). Raises DataError for parts of inconsistent shape."""

    motions: Array
    """(n - 1, 3) odometry from each scan to the next."""
    turned_rad: Array
    """(n - 1,) turn between scans, not wrapped."""
    fingerprints: Sequence[Fingerprint]
    """(n) WiFi and LTE readings together."""

    def __post_init__(self) -> None:
        steps = max(len(self.fingerprints) - 1, len(self.turned_rad))
        try:
            motions, turned_rad = np.asarray(self.motions, float), np.asarray(self.turned_rad, float)
        except UNFIT as error:
            raise DataError(f"motions and turns must be numbers: {error}") from None
        shapes = motions.shape, turned_rad.shape, len(self.fingerprints)
        if shapes != ((steps, 3), (steps,), steps + 1):
            raise DataError(
                f"a radio log has motions ({steps}, 3), turns ({steps},) and {steps + 1} fingerprints; "
                f"got {shapes[0]}, {shapes[1]} and {shapes[2]}"
            )
        if not (np.isfinite(motions).all() and np.isfinite(turned_rad).all()):
            raise DataError("motions and turns of a radio log must be finite")
        object.__setattr__(self, "fingerprints", validated_fingerprints(self.fingerprints))
        object.__setattr__(self, "motions", motions)
        object.__setattr__(self, "turned_rad", turned_rad)

    @property
    def odometry(self) -> Array:
        """(n, 3) dead reckoning from (0, 0, 0)."""
        return poses_along(self.motions)

    @property
    def travel_m(self) -> Array:
        """(n,) path length."""
        return np.concatenate([[0.0], np.cumsum(np.hypot(self.motions[:, 0], self.motions[:, 1]))])


def log_of(keyframes: Sequence[Keyframe]) -> RadioLog:
    """Keyframes of one robot, in order, as a log."""
    motions = np.array([k.motion for k in keyframes[1:]]).reshape(-1, 3)
    return RadioLog(motions, wrap_angle(motions[:, 2]), [k.fingerprint for k in keyframes])


@dataclass(frozen=True, slots=True, eq=False)
class RadioResult:
    """Solution of a log."""

    poses: Array
    """(n, 3) pose of every scan, the first at (0, 0, 0)."""
    places: Array
    """(p,) scans that are places of the graph."""
    models: dict[str, SimilarityModel]
    closures: Distances
    """Between places."""
    fell_back: bool
    """Whether the odometry was returned unchanged."""


@dataclass(frozen=True, slots=True, eq=False)
class _Candidate:
    """A candidate solution: poses (p, 3) of the places, strain of the odometry, and evidence of the readings."""

    poses: Array
    strain: float
    evidence: float

    @property
    def misfit(self) -> float:
        return self.strain - EVIDENCE_WEIGHT * self.evidence


@one_blas_thread()
def solve(
    log: RadioLog, config: RadioSlamConfig, cues: Sequence[str] = CUES, false_closures: Distances | None = None
) -> RadioResult:
    """Trajectory from a log. Cues that the log does not contain are skipped; without any, the odometry is returned.

    Raises DataError for unknown cues. `false_closures`, between scans, are added to the closures in robustness tests.
    """
    cues = cues if isinstance(cues, str) else tuple(cues)
    if isinstance(cues, str) or not set(cues) <= set(CUES):
        raise DataError(f"cues must be a list of some of {', '.join(CUES)}; got {cues!r}")
    return _Solver(log, config, cues).run(false_closures)


class _Solver:
    def __init__(self, log: RadioLog, config: RadioSlamConfig, cues: Sequence[str]):
        self._log, self._config = log, config
        travel_m, odometry = log.travel_m, log.odometry
        spacing_m = max(config.spacing_m, travel_m[-1] / config.places_max)
        self._places = _spaced(travel_m, spacing_m)
        self._travel_m = travel_m[self._places]
        self._odometry = odometry[self._places]
        turned_abs = np.concatenate([[0.0], np.cumsum(np.abs(log.turned_rad))])[self._places]
        self._motions = between_places(Motions(log.motions, log.turned_rad), self._places)
        self._information = motion_information(config, np.diff(self._travel_m), np.diff(turned_abs))
        self._cell_m = max(config.cell_m, 2 * spacing_m)
        found = [
            radio_cue.prepared(name, log.fingerprints, travel_m, self._places, self._odometry, config) for name in cues
        ]
        self._cues = [cue for cue in found if cue is not None]

    def run(self, false_closures: Distances | None) -> RadioResult:
        closures = self._closures(self._cues, false_closures)
        if len(closures) < radio_field.NEIGHBOURS_MIN:
            return self._result(self._odometry, closures, fell_back=True)
        if self._config.weighting == "paper":
            fit = PathFit(self._travel_m, self._information, self._cues, self._config, self._cell_m)
            poses = fit.fit(self._odometry, self._motions, closures, robust=False, iterations=PAPER_ITERATIONS)
            return self._result(poses, closures, fell_back=False)
        paths = [self._path(self._cues, closures)]
        if len(self._cues) > 1:
            for cue in self._cues:
                alone = self._closures([cue], false_closures)
                if len(alone) >= radio_field.NEIGHBOURS_MIN:
                    paths.append(self._path([cue], alone))
        best = min(paths, key=lambda path: path.misfit).poses
        if self._improves_on_odometry(best):
            return self._result(best, closures, fell_back=False)
        return self._result(self._odometry, closures, fell_back=True)

    def _path(self, cues: Sequence[RadioCue], closures: Distances) -> Refined:
        """The path by some of the cues, refined with the readings of all."""
        candidates = self._candidates(cues, self._motions, closures)
        most = max(found.evidence for found in candidates) - EVIDENCE_LOSS_MAX
        is_astray = all(found.evidence < most or found.strain > STRAIN_MAX * len(self._places) for found in candidates)
        path = None if is_astray else self._refined(candidates)
        if path is None or path.explained < EXPLAINED_MIN:
            for curl in CURLS_RAD_M:
                candidates += self._candidates(cues, Calibration(curl_rad_m=curl).applied(self._motions), closures)
            path = self._refined(candidates)
        return path

    def _refined(self, candidates: Sequence[_Candidate]) -> Refined:
        """The best candidate after refinement."""
        best = min(candidates, key=lambda found: found.misfit).poses
        return refined(best, self._motions, self._information, [cue.evidence_along for cue in self._cues])

    def _candidates(self, cues: Sequence[RadioCue], motions: Motions, closures: Distances) -> list[_Candidate]:
        """One candidate solution per assumed noise level."""
        candidates = []
        for noise, heading_noise in NOISE_LEVELS:
            std = np.array([noise, noise, heading_noise])
            information = self._information / (std[:, None] * std)
            fit = PathFit(self._travel_m, information, cues, self._config, self._cell_m)
            poses = fit.fit_whole(motions, closures)
            chain = np.arange(len(poses) - 1)
            squared = squared_errors(
                poses, np.column_stack([chain, chain + 1]), calibrated(motions, poses).motion, self._information
            )
            strain = 0.5 * float(squared.sum()) / STRAIN_NOISE**2
            candidates.append(_Candidate(poses, strain, sum(cue.evidence.of(poses[:, :2]) for cue in cues)))
        return candidates

    def _improves_on_odometry(self, poses: Array) -> bool:
        """Whether the readings show that the path is better than the odometry."""
        order = self._rank_agreement(poses)
        if order <= ORDER_MIN:
            return False
        evidence, by_odometry = (
            sum(cue.evidence_along.of(path[:, :2]) for cue in self._cues) for path in (poses, self._odometry)
        )
        return evidence - by_odometry > EVIDENCE_GAIN_MIN or order > self._rank_agreement(self._odometry)

    def _rank_agreement(self, poses: Array) -> float:
        """Mean rank correlation of proximity and similarity over pairs of places far apart along the path."""
        i, j = np.triu_indices(len(poses), 1)
        apart = np.flatnonzero(self._travel_m[j] - self._travel_m[i] > self._config.apart_m)
        chosen = apart[:: max(1, len(apart) // RANKED_PAIRS_MAX)]
        i, j = i[chosen], j[chosen]
        near = -np.linalg.norm(poses[i, :2] - poses[j, :2], axis=1)
        return float(np.mean([_rank_correlation(near, cue.similarity[i, j]) for cue in self._cues]))

    def _closures(self, cues: Sequence[RadioCue], false_closures: Distances | None) -> Distances:
        """Distance closures of these cues, with the false ones added."""
        parts = [cue.closures(self._config, self._cell_m) for cue in cues]
        if false_closures is not None:
            near = np.abs(self._places[None] - false_closures.pairs.reshape(-1, 1)).argmin(axis=1).reshape(-1, 2)
            parts.append(Distances(np.sort(near, axis=1), false_closures.distance_m, false_closures.variance_m2))
        found = concatenate_distances(parts)
        found = found[found.pairs[:, 0] != found.pairs[:, 1]]
        if self._config.weighting == "ours":
            found = found[radio_closures.with_support(found.pairs[:, 0], found.pairs[:, 1], self._travel_m)]
        return found

    def _result(self, place_poses: Array, closures: Distances, fell_back: bool) -> RadioResult:
        poses = spread(self._log.odometry, self._log.travel_m, self._places, place_poses)
        models = {cue.name: cue.model for cue in self._cues}
        return RadioResult(poses, self._places, models, closures, fell_back)


def _rank_correlation(near: Array, likeness: Array) -> float:
    """0 if all similarities are equal, as with one transmitter received everywhere."""
    return float(spearmanr(near, likeness).statistic) if np.ptp(near) > 0 and np.ptp(likeness) > 0 else 0.0


def motion_information(config: RadioSlamConfig, length_m: Array, turned_rad: Array) -> Array:
    """(k, 3, 3) information of odometry over path lengths (k,) and absolute turns (k,)."""
    position = config.position_std_per_m**2 * length_m + POSITION_STD_MIN_M**2
    heading = config.heading_std_per_m**2 * length_m + config.heading_std_per_rad**2 * turned_rad
    information = np.zeros((len(length_m), 3, 3))
    information[:, 0, 0] = information[:, 1, 1] = 1.0 / position
    information[:, 2, 2] = 1.0 / (heading + HEADING_STD_MIN_RAD**2)
    return information


def spread(path: Array, travel_m: Array, places: Array, place_poses: Array) -> Array:
    """All poses of a path (n, 3) after those at `places` have moved: corrections are interpolated in between."""
    poses = np.empty_like(path)
    for a, b, start, end in zip(places, [*places[1:], len(path)], place_poses, [*place_poses[1:], None], strict=True):
        own = compose(start, between(path[a], path[a:b]))
        if end is not None:
            missing = end - compose(start, between(path[a], path[b]))
            missing[2] = wrap_angle(missing[2])
            share = (travel_m[a:b] - travel_m[a]) / max(travel_m[b] - travel_m[a], 1e-9)
            own = own + share[:, None] * missing
        poses[a:b] = own
    poses[:, 2] = wrap_angle(poses[:, 2])
    return compose(inverse(poses[0]), poses)


def _spaced(travel_m: Array, spacing_m: float) -> Array:
    """Indices of the first scan and of each next one at least spacing_m further."""
    chosen, last = [0], travel_m[0]
    for k in range(1, len(travel_m)):
        if travel_m[k] - last >= spacing_m:
            chosen.append(k)
            last = travel_m[k]
    return np.array(chosen)
