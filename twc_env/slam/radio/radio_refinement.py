"""Final fit of radio SLAM: the maximum a posteriori path given odometry and all readings.

Constraints between single places (`radio_field`) give displacements one by one. The evidence of the whole layout
(`radio_evidence`) also depends on which places are similar far apart and which are not, so it is sensitive to the shape
of the map (similar to WiFi-SLAM, Ferris, Fox, Lawrence 2007, without its latent dynamics). Each step solves for all
places at once with the expected information of the evidence (Fisher scoring), in as many unknowns as places have.

Path segments along the building's walls (`building_axes`) constrain the headings: otherwise the heading of the first
pose, and so of the whole map, is only as accurate as the first few turns.

The odometry noise is estimated from how well paths under each noise level explain the readings, integrated over all
paths instead of the best one (type II maximum likelihood; Rasmussen & Williams 2006, Eq. 5.8).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray as Array
from scipy.linalg import cho_factor, cho_solve, cholesky
from scipy.optimize import minimize_scalar

from twc_env.records.geometry import between, poses_along, wrap_angle
from twc_env.slam.odometry.odometry_calibration import CURL_STD_RAD_M, TURN_STD, Motions, calibration
from twc_env.slam.radio.building_axes import BuildingAxes
from twc_env.slam.radio.radio_evidence import FieldEvidence

EVIDENCE_WEIGHT = 6.0
"""Effective number of independent transmitters. With more, paths deviate from the truth by more than their covariance
says. Chosen on walks 0 to 3 and 100 to 105 of the twins."""
AXES_WEIGHT = 0.5
"""Weight of the building axes: with 1 they bend a path that odometry knows better (uw_floor)."""
ROUNDS, STEPS_MAX, SIZE_ITERATIONS = 5, 3, 30
"""Rounds of path and hyperparameter updates, steps per round, and iterations of the first hyperparameter fit."""
GAIN_MIN = 0.1
"""Minimum decrease of the cost to continue a round."""
HALVINGS = 5
LOG_NOISE_STD, LOG_NOISE_BOUNDS = 1.0, (-4.0, 3.0)
"""Prior of the odometry noise factor: log standard deviation and bounds."""


@dataclass(frozen=True, slots=True, eq=False)
class Refined:
    """A refined path."""

    poses: Array
    """(p, 3)."""
    misfit: float
    """Negative log evidence integrated over paths near this one, up to a constant; comparable for the same readings."""
    explained: float
    """Share of the readings' variance explained by position; the rest is noise or correlation along the path."""
    noise: float
    """Estimated odometry noise relative to the configured one."""


def refined(
    poses: Array, motions: Motions, information: Array, evidences: Sequence[FieldEvidence],
    axes: BuildingAxes | None = None,
) -> Refined:  # fmt: skip
    """The maximum a posteriori path, starting from poses (p, 3); its first pose is the origin.

    `motions` lead from place to place, with information (p - 1, 3, 3) of which only the diagonal is used. Fields of any
    length scale explain the readings of a scaled map equally well, so the scale is taken from odometry. `axes` is the
    initial value of the building axes; with a share of 0 they are not used.
    """
    poses = poses / [*2 * [calibration(motions, poses).scale], 1.0]
    sizes = [evidence.fitted(poses[:, :2], iterations=SIZE_ITERATIONS)[1] for evidence in evidences]
    missed = between(poses[:-1], poses[1:]) - motions.motion
    missed[:, 2] = wrap_angle(missed[:, 2])
    fit, noise = _Fit(motions, information, evidences, axes or BuildingAxes()), 1.0
    missed, view = fit.minimised(missed, noise, sizes)
    for _ in range(ROUNDS - 1):
        noise = float(np.sqrt(noise * fit.noise(missed, sizes)))
        poses = fit.poses(missed)
        sizes = [evidence.fitted(poses[:, :2], size)[1] for evidence, size in zip(evidences, sizes, strict=True)]
        missed, view = fit.minimised(missed, noise, sizes)
    shares = [_explained(size) for size in sizes]
    misfit = fit.cost(missed, noise, sizes) + view.volume(noise) + _noise_prior(noise)
    return Refined(fit.poses(missed), misfit, sum(shares) / max(len(shares), 1), noise)


def _explained(size: Array) -> float:
    """Share of the variance of a fitted covariance (`FieldEvidence.fitted`) that depends on position."""
    places, rest = np.exp(size[:2]).sum(), np.exp(size[4:6]).sum()
    return float(places / (places + rest))


def _noise_prior(noise: float) -> float:
    return 0.5 * (np.log(noise) / LOG_NOISE_STD) ** 2


class _Fit:
    """Cost of a path with the odometry corrections `missed` (p - 1, 3) as unknowns: noise plus systematic errors
    (`odometry_calibration`)."""

    def __init__(self, motions: Motions, information: Array, evidences: Sequence[FieldEvidence], axes: BuildingAxes):
        self._motion, self._evidences, self._axes = motions.motion, evidences, axes
        self._variance = 1.0 / np.diagonal(information, axis1=1, axis2=2)
        self._causes = motions.causes * np.array([CURL_STD_RAD_M, TURN_STD])[:, None, None]

    def poses(self, missed: Array) -> Array:
        """(p, 3)."""
        return poses_along(self._motion + missed)

    def cost(self, missed: Array, noise: float, sizes: Sequence[Array]) -> float:
        """Negative log posterior of a path, maximised over the systematic errors."""
        variance = noise**2 * self._variance
        causes = (self._causes / variance).reshape(2, -1)
        constant = causes @ missed.ravel()
        normal = causes @ self._causes.reshape(2, -1).T + np.eye(2)
        strain = (missed**2 / variance).sum() - constant @ np.linalg.solve(normal, constant)
        places = self.poses(missed)[:, :2]
        told = sum(evidence.evidence_with(places, size) for evidence, size in zip(self._evidences, sizes, strict=True))
        return 0.5 * float(strain) + AXES_WEIGHT * self._axes.cost(places) - EVIDENCE_WEIGHT * told

    def minimised(self, missed: Array, noise: float, sizes: Sequence[Array]) -> tuple[Array, _QuadraticModel]:
        """The correction of least cost by damped steps, and the last quadratic model."""
        self._axes = self._axes.fitted(self.poses(missed)[:, :2])
        cost = self.cost(missed, noise, sizes)
        for _ in range(STEPS_MAX):
            view = self._model(missed, sizes, self._axes)
            step = view.maximum(noise) - missed
            for halving in range(HALVINGS):
                moved = missed + 0.5**halving * step
                moved_cost = self.cost(moved, noise, sizes)
                if moved_cost < cost:
                    break
            else:
                return missed, view
            missed, gain, cost = moved, cost - moved_cost, moved_cost
            if gain < GAIN_MIN:
                break
        return missed, view

    def noise(self, missed: Array, sizes: Sequence[Array]) -> float:
        """Estimated odometry noise from the readings alone; path segments held straight by axes would lower it."""
        return self._model(missed, sizes, BuildingAxes(0.0)).noise()

    def _model(self, missed: Array, sizes: Sequence[Array], axes: BuildingAxes) -> _QuadraticModel:
        poses = self.poses(missed)
        by_place, information = (AXES_WEIGHT * part for part in axes.slopes(poses[:, :2]))
        for evidence, size in zip(self._evidences, sizes, strict=True):
            slopes, its_information = evidence.gradient(poses[:, :2], size)
            by_place += EVIDENCE_WEIGHT * slopes
            information += EVIDENCE_WEIGHT * its_information
        return _QuadraticModel(jacobian(poses), missed, self._variance, self._causes, by_place, information)


class _QuadraticModel:
    """Quadratic model of the evidence around one path, in coordinates where its information is the identity."""

    def __init__(
        self, jacobian: Array, missed: Array, variance: Array, causes: Array, by_place: Array, information: Array
    ):
        unknowns = 2 * len(by_place)
        self._jacobian = jacobian.reshape(unknowns, -1)
        self._variance, self._causes = variance.ravel(), causes.reshape(2, -1)
        information = information.reshape(unknowns, unknowns)
        ridge = 1e-9 * np.trace(information) / unknowns + 1e-12
        self._root = cholesky(information + ridge * np.eye(unknowns), lower=True)
        self._pull = information @ (self._jacobian @ missed.ravel()) + by_place.ravel()
        by_cause = self._jacobian @ self._causes.T
        self._noise_moves = (self._jacobian * self._variance) @ self._jacobian.T
        self._causes_move = by_cause @ by_cause.T
        self._noise_told, self._causes_told = (
            self._root.T @ moves @ self._root for moves in (self._noise_moves, self._causes_move)
        )

    def maximum(self, noise: float) -> Array:
        """(p - 1, 3) correction that maximises the quadratic model together with odometry of this noise."""
        told, factor = self._told(noise)
        pull = self._jacobian.T @ (self._pull - self._root @ cho_solve(factor, told))
        return (noise**2 * self._variance * pull + self._causes.T @ (self._causes @ pull)).reshape(-1, 3)

    def noise(self) -> float:
        """Noise factor that maximises the evidence integrated over all paths. It is overestimated from tightly held
        paths and underestimated from loose ones, so the truth lies between."""

        def cost(log_noise: float) -> float:
            noise = float(np.exp(log_noise))
            told, factor = self._told(noise)
            moves = noise**2 * self._noise_moves + self._causes_move
            gained = 0.5 * (self._pull @ moves @ self._pull - told @ cho_solve(factor, told))
            return float(np.log(np.diag(factor[0])).sum() - gained + _noise_prior(noise))

        found = minimize_scalar(cost, bounds=LOG_NOISE_BOUNDS, method="bounded", options={"xatol": 0.05})
        return float(np.exp(found.x))

    def volume(self, noise: float) -> float:
        """Negative log of the ratio of the integral over paths near this one to its maximum."""
        return float(np.log(np.diag(self._told(noise)[1][0])).sum())

    def _told(self, noise: float) -> tuple[Array, tuple]:
        """The gradient transformed by odometry of this noise, and the Cholesky factor of the joint information."""
        moves = noise**2 * self._noise_moves + self._causes_move
        both = noise**2 * self._noise_told + self._causes_told
        both[np.diag_indices(len(both))] += 1.0
        return self._root.T @ (moves @ self._pull), cho_factor(both, lower=True)


def jacobian(poses: Array) -> Array:
    """(p, 2, p - 1, 3) derivative of places by the motions between poses (p, 3): all later places translate with a
    motion and rotate with its turn."""
    count = len(poses)
    later = np.tri(count, count - 1, -1)
    c, s = np.cos(poses[:-1, 2]), np.sin(poses[:-1, 2])
    arm = poses[:, None, :2] - poses[None, 1:, :2]
    by_motion = np.empty((count, 2, count - 1, 3))
    by_motion[:, 0, :, 0], by_motion[:, 0, :, 1], by_motion[:, 0, :, 2] = later * c, later * -s, later * -arm[:, :, 1]
    by_motion[:, 1, :, 0], by_motion[:, 1, :, 1], by_motion[:, 1, :, 2] = later * s, later * c, later * arm[:, :, 0]
    return by_motion
