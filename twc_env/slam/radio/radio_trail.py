"""Radio SLAM scan by scan in bounded memory, for paths of any length in a building of limited size.

Places of the graph are `spacing_m` apart along the path, up to `trail_places_max`. From then on each new place replaces
an old one: the one with the nearest other place, which is most redundant. The motions around it are concatenated, so
odometry stays exact; its fingerprint is dropped. Every `trail_period_m`, signal strength fields (`radio_field`)
constrain places relative to other visits nearby, and the graph is optimised from its current state. The time per step
depends on the building, not on the path length.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray as Array
from scipy.sparse import csr_array

from twc_env.config import RadioSlamConfig
from twc_env.errors import DataError
from twc_env.records.array_validation import real_array, validated_pose
from twc_env.records.fingerprint_validation import validated_fingerprint
from twc_env.records.geometry import between, compose, poses_along
from twc_env.records.messages import Fingerprint
from twc_env.slam.odometry.odometry_calibration import Calibration, Motions, calibration
from twc_env.slam.pose_graph.distance_factor import NO_DISTANCES, Distances, RadioEquations, concatenate_distances
from twc_env.slam.radio import radio_closures, radio_field
from twc_env.slam.radio.radio_similarity import all_similarities, features, split_cues
from twc_env.slam.radio.radio_slam import motion_information
from twc_env.slam.radio.similarity_model import SimilarityModel, train_on_path

BANDWIDTHS_M = {"wifi": (8.0, 5.0), "lte": (40.0, 25.0)}
"""Bandwidths of the fields, coarse to fine, in each optimisation."""
ROUNDS = 2
ITERATIONS = 8
RECENT_M = 60.0
"""Places of the latest part of the path with this length are never removed."""
HELD_STD = (1.0, 1.0, 0.2)
"""Standard deviation [m, m, rad] of the prior that keeps places where they were when the first one was removed."""
NOISE = 2.0
"""Factor on the configured odometry noise, since systematic errors are not known yet."""


class _CueFeatures:
    """Features (places, transmitters) of one kind of radio, with reusable rows."""

    def __init__(self, cue: str, rows: int, mode: str):
        self.cue, self._mode = cue, mode
        self._column: dict[int, int] = {}
        self._table = np.zeros((rows, 64), np.float32)
        self.model: SimilarityModel | None = None
        self.field_weights: dict[float, float] = {}
        """Weight of a squared strength difference, by bandwidth."""

    def write(self, row: int, scans: list[Fingerprint]) -> None:
        """Store the mean of the features over scans; a missing reading counts as 0."""
        for scan in scans:
            for mac in scan.macs.tolist():
                self._column.setdefault(mac, len(self._column))
        while len(self._column) > self._table.shape[1]:
            self._table = np.concatenate([self._table, np.zeros_like(self._table)], axis=1)
        self._table[row] = 0.0
        for scan in scans:
            columns = [self._column[mac] for mac in scan.macs.tolist()]
            self._table[row, columns] += features(scan.macs, scan.rssi_dbm, self._mode) / len(scans)

    def of(self, rows: Array) -> Array:
        """(rows, transmitters)."""
        return self._table[rows, : max(len(self._column), 1)]


class RadioTrail:
    """The trajectory of one robot from odometry and radio, scan by scan; it starts at (0, 0, 0)."""

    def __init__(self, config: RadioSlamConfig):
        self._config, size = config, config.trail_places_max + 1
        self._poses, self._steps = np.zeros((0, 3)), np.zeros((0, 6))
        """Per place: pose; and from the previous place: motion (3), signed and absolute turn, path length."""
        self._held_at = np.zeros((0, 3))
        """(places, 3) poses when the first place was removed; NaN for later places."""
        self._rows, self._free = np.zeros(0, np.int64), list(range(size))[::-1]
        self._heard = [_CueFeatures(cue, size, config.similarity) for cue in BANDWIDTHS_M]
        self._step: Array = np.zeros(6)
        """Motion since the last place, as in `_steps`."""
        self._scans: list[list[Fingerprint]] = [[] for _ in self._heard]
        self._calibration = Calibration()
        self._unsolved_m = 0.0
        self._is_full = False

    def __len__(self) -> int:
        return len(self._poses)

    @property
    def pose(self) -> Array:
        """(3,) current pose."""
        return compose(self._poses[-1], self._step[:3]) if len(self) else np.zeros(3)

    def add(self, motion: Array, turned_rad: float, fingerprint: Fingerprint) -> Array:
        """Process the motion (3,) since the last scan and the fingerprint after it; returns the pose (3,).

        Raises DataError for a motion that is not finite or an invalid fingerprint.
        """
        motion, turned = validated_pose(motion, "a motion"), real_array(turned_rad, "a turn")
        if turned.ndim or not np.isfinite(turned):
            raise DataError(f"a turn must be a finite number [rad]; got {turned_rad!r}")
        turned_rad = float(turned)
        fingerprint = validated_fingerprint(fingerprint)
        right = self._calibration.applied(Motions(np.array([motion], float), np.array([turned_rad])))
        turned_rad, length_m = float(right.turned_rad[0]), float(right.length_m[0])
        self._step = _joined(self._step, np.array([*right.motion[0], turned_rad, abs(turned_rad), length_m]))
        self._unsolved_m += length_m
        parts = split_cues(fingerprint)
        for scans, heard in zip(self._scans, self._heard, strict=True):
            scans.append(parts[heard.cue])
        if not len(self) or self._step[5] >= self._config.spacing_m:
            self._add_place()
            if self._unsolved_m >= self._config.trail_period_m:
                self._unsolved_m = 0.0
                self._optimise()
        return self.pose

    def _add_place(self) -> None:
        row = self._free.pop()
        for scans, heard in zip(self._scans, self._heard, strict=True):
            heard.write(row, scans)
            scans.clear()
        self._poses = np.concatenate([self._poses, self.pose[None]])
        self._steps = np.concatenate([self._steps, self._step[None]])
        self._rows = np.append(self._rows, row)
        self._step = np.zeros(6)
        self._held_at = np.concatenate([self._held_at, np.full((1, 3), np.nan)])
        if len(self) > self._config.trail_places_max:
            if not self._is_full:
                self._is_full, self._held_at = True, self._poses.copy()
            self._remove_redundant()

    def _remove_redundant(self) -> None:
        """Remove one of the two nearest places; the latest part of the path is kept."""
        travel = np.cumsum(self._steps[:, 5])
        old = max(int(np.searchsorted(travel, travel[-1] - RECENT_M)), 3)
        places = self._poses[:old, :2]
        away = np.linalg.norm(places[:, None] - places[None], axis=2)
        away[np.tri(old, dtype=bool)] = np.inf
        away[np.arange(old - 1), np.arange(1, old)] = np.inf
        k = int(np.argmin(away)) % old
        self._steps[k + 1] = _joined(self._steps[k], self._steps[k + 1])
        self._free.append(int(self._rows[k]))
        kept = np.arange(len(self)) != k
        self._poses, self._steps, self._rows = self._poses[kept], self._steps[kept], self._rows[kept]
        self._held_at = self._held_at[kept]

    def _optimise(self) -> None:
        travel, poses = np.cumsum(self._steps[:, 5]), self._poses
        for round_ in range(ROUNDS):
            closures = concatenate_distances([self._closures(heard, travel) for heard in self._heard if round_ == 0])
            found = [self._constraints(heard, round_, poses, travel) for heard in self._heard]
            poses = self._fit(poses, [some for some in found if len(some[0])], closures)
            if not self._is_full:
                self._calibrate(poses)
        self._poses = poses

    def _calibrate(self, poses: Array) -> None:
        """Remove the systematic errors from the stored steps and from all later ones."""
        motions = Motions(self._steps[1:, :3], self._steps[1:, 3])
        found = calibration(motions, poses)
        right = found.applied(motions)
        self._steps[1:, :3], self._steps[1:, 3] = right.motion, right.turned_rad
        self._calibration = self._calibration.then(found)

    def _closures(self, heard: _CueFeatures, travel: Array) -> Distances:
        """Distances between similar places, as in `radio_slam`."""
        rule, feature = self._config, heard.of(self._rows)
        similarity = all_similarities(csr_array(feature))
        if heard.model is None or not self._is_full:
            window_m = rule.window_wifi_m if heard.cue == "wifi" else rule.window_lte_m
            reckoned = poses_along(self._steps[1:, :3])
            heard.model = train_on_path(
                similarity, travel, reckoned[:, :2], rule.similarity_min, window_m, rule.bin_width, warns=False
            )
        if not len(heard.model.centre):
            return NO_DISTANCES
        found = radio_closures.closures(
            similarity, travel, heard.model, rule.similarity_min, rule.apart_m, rule.cell_m, rule.closures_per_place
        )
        return found[radio_closures.with_support(found.pairs[:, 0], found.pairs[:, 1], travel)]

    def _constraints(self, heard: _CueFeatures, round_: int, poses: Array, travel: Array) -> tuple[Array, Array, Array]:
        feature, bandwidth_m = heard.of(self._rows), BANDWIDTHS_M[heard.cue][round_]
        if not self._is_full or bandwidth_m not in heard.field_weights:
            heard.field_weights[bandwidth_m] = radio_field.learn_weight(feature, poses[:, :2], travel, bandwidth_m)
        weight = heard.field_weights[bandwidth_m]
        found = radio_field.field_constraints(
            feature, poses[:, :2], travel, bandwidth_m, self._config.apart_m, weight
        )  # fmt: skip
        return found.pairs, *found.relative(poses)

    def _priors(self) -> tuple[Array, Array, Array]:
        """Priors on places from the time when the first one was removed, relative to the first."""
        held = np.flatnonzero(np.isfinite(self._held_at[1:, 0])) + 1
        pairs = np.column_stack([np.zeros_like(held), held])
        information = np.tile(np.diag(1.0 / np.array(HELD_STD) ** 2), (len(held), 1, 1))
        return pairs, between(self._held_at[:1], self._held_at[held]), information

    def _fit(self, poses: Array, constraints: list, closures: Distances) -> Array:
        count, config = len(poses), self._config
        chain = np.column_stack([np.arange(count - 1), np.arange(1, count)])
        odometry = motion_information(config, self._steps[1:, 5], self._steps[1:, 4]) / NOISE**2
        parts = zip((chain, self._steps[1:, :3], odometry), self._priors(), *constraints, strict=True)
        edges, measured, information = (np.concatenate(part) for part in parts)
        equations = RadioEquations(edges, measured, information, closures, count)
        return equations.fit(poses, config.robust_scale, ITERATIONS)


def _joined(first: Array, second: Array) -> Array:
    """Two steps (6,) concatenated."""
    return np.concatenate([compose(first[:3], second[:3]), first[3:] + second[3:]])
