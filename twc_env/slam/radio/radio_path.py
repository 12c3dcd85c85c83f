"""Fit a path to radio for one assumed odometry noise: first incrementally with distances from similarities, then with
constraints from signal strength fields; odometry is recalibrated after each fit."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.config import RadioSlamConfig
from twc_env.records.geometry import compose, poses_along
from twc_env.slam.odometry.odometry_calibration import Motions, calibrated
from twc_env.slam.pose_graph.distance_factor import NO_DISTANCES, Distances, RadioEquations
from twc_env.slam.radio import radio_field
from twc_env.slam.radio.radio_cue import RadioCue

FIRST_STAGE_M, STAGE_GROWTH = 60.0, 1.3
"""Path length of the first fit [m], and growth factor of the next ones."""
STAGE_ITERATIONS, FINAL_ITERATIONS, FINAL_ROUNDS = 6, 20, 4
CONSTRAINT_ITERATIONS = 10


class PathFit:
    """Fits one path; `information` (places - 1, 3, 3) is that of its odometry."""

    def __init__(
        self, travel_m: Array, information: Array, cues: Sequence[RadioCue], config: RadioSlamConfig, cell_m: float
    ):
        self._travel_m, self._information, self._cues = travel_m, information, cues
        self._config, self._cell_m = config, cell_m

    def fit_whole(self, motions: Motions, closures: Distances) -> Array:
        """Poses (places, 3) of the whole path."""
        return self._fit_fields(*self._fit_incrementally(motions, closures))

    def _fit_incrementally(self, motions: Motions, closures: Distances) -> tuple[Array, Motions]:
        """Fit longer and longer parts of the path from its start, recalibrating odometry after each."""
        poses, total_m = np.zeros((1, 3)), self._travel_m[-1]
        end_m, last = FIRST_STAGE_M, closures.pairs.max(axis=1)
        rounds_left = FINAL_ROUNDS
        while rounds_left:
            is_whole = end_m >= total_m
            count = len(self._travel_m) if is_whole else max(int(np.searchsorted(self._travel_m, end_m)), 2)
            rest = poses_along(motions.motion[len(poses) - 1 : count - 1])
            poses = np.concatenate([poses[:-1], compose(poses[-1], rest)])
            within = closures[last < count]
            if len(within) >= radio_field.NEIGHBOURS_MIN:
                iterations = FINAL_ITERATIONS if is_whole else STAGE_ITERATIONS
                poses = self.fit(poses, motions, within, iterations=iterations)
                motions = calibrated(motions, poses)
            end_m *= STAGE_GROWTH
            rounds_left -= is_whole
        return poses, motions

    def _fit_fields(self, poses: Array, motions: Motions) -> Array:
        """Fit with constraints from the signal strength fields, coarse to fine."""
        for k in range(max(cue.rounds for cue in self._cues)):
            constraints = [cue.constraints(poses, motions, k, self._config.apart_m, self._cell_m) for cue in self._cues]
            poses = self.fit(
                poses, motions, NO_DISTANCES, [c for c in constraints if len(c.pairs)], iterations=CONSTRAINT_ITERATIONS
            )
            motions = calibrated(motions, poses)
        return poses

    def fit(
        self, poses: Array, motions: Motions, closures: Distances,
        constraints: Sequence[radio_field.FieldConstraints] = (),
        robust: bool = True, iterations: int = FINAL_ITERATIONS,
    ) -> Array:  # fmt: skip
        """(n, 3) poses after least squares over odometry, distance closures and field constraints.

        poses: (n, 3) to begin with; robust: closures that do not fit lose weight (`robust_scale`).
        """
        count = len(poses)
        chain = np.arange(count - 1)
        odometry = np.column_stack([chain, chain + 1]), motions.motion[: count - 1], self._information[: count - 1]
        parts = zip(odometry, *((c.pairs, *c.relative(poses)) for c in constraints), strict=True)
        edges, measured, information = (np.concatenate(part) for part in parts)
        scale = self._config.robust_scale if robust else math.inf
        return RadioEquations(edges, measured, information, closures, count).fit(poses, scale, iterations)
