"""A path fitted to radio under one assumption of how noisy its odometry is: grown from its beginning by distances that
similarity tells, then tied to itself by fields of strength, its odometry calibrated after each fit."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.config import RadioSlamConfig
from twc_env.geometry import compose, poses_along
from twc_env.slam import radio_field
from twc_env.slam.distance_factor import NO_DISTANCES, Distances, RadioEquations
from twc_env.slam.odometry_calibration import Motions, calibrated
from twc_env.slam.radio_cue import RadioCue

FIRST_STAGE_M, STAGE_GROWTH = 60.0, 1.3
"""The path is fitted up to here first, then up to this many times as far, and so on."""
STAGE_ITERATIONS, FINAL_ITERATIONS, FINAL_ROUNDS = 6, 20, 4
TIE_ITERATIONS = 10


class PathFit:
    """Fits one path; `information` (places - 1, 3, 3) is that of its odometry."""

    def __init__(
        self, travel_m: Array, information: Array, cues: Sequence[RadioCue], config: RadioSlamConfig, cell_m: float
    ):
        self._travel_m, self._information, self._cues = travel_m, information, cues
        self._config, self._cell_m = config, cell_m

    def whole(self, motions: Motions, closures: Distances) -> Array:
        """Poses (places, 3) of the path."""
        return self._tied(*self._grown(motions, closures))

    def _grown(self, motions: Motions, closures: Distances) -> tuple[Array, Motions]:
        """Fit the path from its beginning on, further and further; its odometry is calibrated on the way."""
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

    def _tied(self, poses: Array, motions: Motions) -> Array:
        """Places tied by the fields of strength, from coarse to fine."""
        for k in range(max(cue.rounds for cue in self._cues)):
            ties = [cue.ties(poses, motions, k, self._config.apart_m, self._cell_m) for cue in self._cues]
            poses = self.fit(poses, motions, NO_DISTANCES, [t for t in ties if len(t.pairs)], iterations=TIE_ITERATIONS)
            motions = calibrated(motions, poses)
        return poses

    def fit(
        self, poses: Array, motions: Motions, closures: Distances, ties: Sequence[radio_field.Ties] = (),
        robust: bool = True, iterations: int = FINAL_ITERATIONS,
    ) -> Array:  # fmt: skip
        """Poses after least squares over the odometry of their part of the path, closures and ties."""
        count = len(poses)
        chain = np.arange(count - 1)
        odometry = np.column_stack([chain, chain + 1]), motions.motion[: count - 1], self._information[: count - 1]
        parts = zip(odometry, *((tie.pairs, *tie.relative(poses)) for tie in ties), strict=True)
        edges, measured, information = (np.concatenate(part) for part in parts)
        scale = self._config.robust_scale if robust else math.inf
        return RadioEquations(edges, measured, information, closures, count).fit(poses, scale, iterations)
