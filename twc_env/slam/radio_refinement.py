"""The last fit of radio SLAM: the path that is likeliest under odometry and under all that was heard along it at once.

Ties between single places (`radio_field`) tell displacements one by one. The evidence of the whole layout
(`radio_evidence`) also weighs what is alike far away and what is not, so it sees how the map lies as a whole (maximum a
posteriori; WiFi-SLAM, Ferris, Fox, Lawrence 2007, without its latent dynamics). Each step solves for all places at once
with the information that the evidence is expected to hold of them (Fisher scoring), in as many unknowns as places have.

Ways along the walls of a building (`building_axes`) keep the headings straight: without them the heading of the first
pose, and with it the whole map, is only known as well as the first few turns.

How noisy the odometry is nobody says either: it follows from how well paths under each level of noise explain what was
heard, all of them and not the best alone (type II maximum likelihood; Rasmussen & Williams 2006, Eq. 5.8).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray as Array
from scipy.linalg import cho_factor, cho_solve, cholesky
from scipy.optimize import minimize_scalar

from twc_env.geometry import between, poses_along, wrap_angle
from twc_env.slam.building_axes import BuildingAxes
from twc_env.slam.odometry_calibration import CURL_STD_RAD_M, TURN_STD, Motions, calibration
from twc_env.slam.radio_evidence import FieldEvidence

EVIDENCE_WEIGHT = 6.0
"""What is heard weighs as so many independent transmitters: with more of them, paths stray from the truth further than
they claim. Chosen on walks 0 to 3 and 100 to 105 of the twins."""
AXES_WEIGHT = 0.5
"""Ways along axes count half: counted in full they bend a path that odometry knows better (uw_floor)."""
ROUNDS, STEPS_MAX, SIZE_ITERATIONS = 5, 3, 30
"""Each round moves the path, then fits noise and covariance anew; this one is first fitted in more iterations."""
GAIN_MIN = 0.1
"""A step that gains less is the last of its round."""
HALVINGS = 5
LOG_NOISE_STD, LOG_NOISE_BOUNDS = 1.0, (-4.0, 3.0)
"""By what factor the noise of odometry may differ from the configured one, as a logarithm."""


@dataclass(frozen=True, slots=True, eq=False)
class Refined:
    """A refined path."""

    poses: Array
    """(p, 3)."""
    misfit: float
    """Minus the logarithm of the probability of what was heard, over all paths near this one, up to a constant: of
    paths by the same evidence the lowest is best."""
    explained: float
    """Share of what was heard, by variance, that places explain: the rest is noise, or shared by neighbours along the
    path only."""
    noise: float
    """How many times as noisy as configured the odometry is."""


def refined(
    poses: Array, motions: Motions, information: Array, evidences: Sequence[FieldEvidence],
    axes: BuildingAxes | None = None,
) -> Refined:  # fmt: skip
    """The path that is likeliest, from poses (p, 3); its first pose is the origin.

    `motions` lead from place to place, with information (p - 1, 3, 3) of which only the diagonal counts. Fields of any
    size explain what was heard as well in a map of that size: so it is the odometry's, whatever size the poses have.
    `axes` are where the search for those of the building begins; with a share of 0 there are none.
    """
    poses = poses / [*2 * [calibration(motions, poses).scale], 1.0]
    sizes = [evidence.fitted(poses[:, :2], iterations=SIZE_ITERATIONS)[1] for evidence in evidences]
    missed = between(poses[:-1], poses[1:]) - motions.motion
    missed[:, 2] = wrap_angle(missed[:, 2])
    fit, noise = _Fit(motions, information, evidences, axes or BuildingAxes()), 1.0
    missed, view = fit.settled(missed, noise, sizes)
    for _ in range(ROUNDS - 1):
        noise = float(np.sqrt(noise * fit.noise(missed, sizes)))
        poses = fit.poses(missed)
        sizes = [evidence.fitted(poses[:, :2], size)[1] for evidence, size in zip(evidences, sizes, strict=True)]
        missed, view = fit.settled(missed, noise, sizes)
    shares = [_explained(size) for size in sizes]
    misfit = fit.cost(missed, noise, sizes) + view.volume(noise) + _unlikely(noise)
    return Refined(fit.poses(missed), misfit, sum(shares) / max(len(shares), 1), noise)


def _explained(size: Array) -> float:
    """Share of the variance of a fitted covariance (`FieldEvidence.fitted`) that depends on places."""
    places, rest = np.exp(size[:2]).sum(), np.exp(size[4:6]).sum()
    return float(places / (places + rest))


def _unlikely(noise: float) -> float:
    return 0.5 * (np.log(noise) / LOG_NOISE_STD) ** 2


class _Fit:
    """A path whose unknowns are what the odometry missed of each motion (p - 1, 3): noise, and errors that stay the
    same all along (`odometry_calibration`)."""

    def __init__(self, motions: Motions, information: Array, evidences: Sequence[FieldEvidence], axes: BuildingAxes):
        self._motion, self._evidences, self._axes = motions.motion, evidences, axes
        self._variance = 1.0 / np.diagonal(information, axis1=1, axis2=2)
        self._causes = motions.causes * np.array([CURL_STD_RAD_M, TURN_STD])[:, None, None]

    def poses(self, missed: Array) -> Array:
        """(p, 3)."""
        return poses_along(self._motion + missed)

    def cost(self, missed: Array, noise: float, sizes: Sequence[Array]) -> float:
        """Minus the logarithm of the probability of a path, under the likeliest constant errors."""
        variance = noise**2 * self._variance
        causes = (self._causes / variance).reshape(2, -1)
        constant = causes @ missed.ravel()
        normal = causes @ self._causes.reshape(2, -1).T + np.eye(2)
        strain = (missed**2 / variance).sum() - constant @ np.linalg.solve(normal, constant)
        places = self.poses(missed)[:, :2]
        told = sum(evidence.under(places, size) for evidence, size in zip(self._evidences, sizes, strict=True))
        return 0.5 * float(strain) + AXES_WEIGHT * self._axes.cost(places) - EVIDENCE_WEIGHT * told

    def settled(self, missed: Array, noise: float, sizes: Sequence[Array]) -> tuple[Array, _View]:
        """What the odometry missed where the cost is least, and the last view from there."""
        self._axes = self._axes.fitted(self.poses(missed)[:, :2])
        cost = self.cost(missed, noise, sizes)
        for _ in range(STEPS_MAX):
            view = self._view(missed, sizes, self._axes)
            step = view.likeliest(noise) - missed
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
        """How noisy the odometry is, by what was heard alone: ways that axes hold straight look less noisy."""
        return self._view(missed, sizes, BuildingAxes(0.0)).noise()

    def _view(self, missed: Array, sizes: Sequence[Array], axes: BuildingAxes) -> _View:
        poses = self.poses(missed)
        by_place, information = (AXES_WEIGHT * part for part in axes.slopes(poses[:, :2]))
        for evidence, size in zip(self._evidences, sizes, strict=True):
            slopes, its_information = evidence.slopes(poses[:, :2], size)
            by_place += EVIDENCE_WEIGHT * slopes
            information += EVIDENCE_WEIGHT * its_information
        return _View(jacobian(poses), missed, self._variance, self._causes, by_place, information)


class _View:
    """The evidence as a parabola around one path, in coordinates in which its information is one."""

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

    def likeliest(self, noise: float) -> Array:
        """(p - 1, 3) what the odometry missed where the parabola and odometry of this noise are likeliest together."""
        told, factor = self._told(noise)
        pull = self._jacobian.T @ (self._pull - self._root @ cho_solve(factor, told))
        return (noise**2 * self._variance * pull + self._causes.T @ (self._causes @ pull)).reshape(-1, 3)

    def noise(self) -> float:
        """How many times as noisy as configured the odometry is: by what is then heard on all paths together. From
        paths that were held tightly it looks noisier than from loose ones, so that the truth lies in between."""

        def cost(log_noise: float) -> float:
            noise = float(np.exp(log_noise))
            told, factor = self._told(noise)
            moves = noise**2 * self._noise_moves + self._causes_move
            gained = 0.5 * (self._pull @ moves @ self._pull - told @ cho_solve(factor, told))
            return float(np.log(np.diag(factor[0])).sum() - gained + _unlikely(noise))

        found = minimize_scalar(cost, bounds=LOG_NOISE_BOUNDS, method="bounded", options={"xatol": 0.05})
        return float(np.exp(found.x))

    def volume(self, noise: float) -> float:
        """By how much less paths near this one are likely together than the best of them: minus a logarithm."""
        return float(np.log(np.diag(self._told(noise)[1][0])).sum())

    def _told(self, noise: float) -> tuple[Array, tuple]:
        """What odometry of this noise makes of the pull, and the Cholesky factor of both informations together."""
        moves = noise**2 * self._noise_moves + self._causes_move
        both = noise**2 * self._noise_told + self._causes_told
        both[np.diag_indices(len(both))] += 1.0
        return self._root.T @ (moves @ self._pull), cho_factor(both, lower=True)


def jacobian(poses: Array) -> Array:
    """(p, 2, p - 1, 3) how places move with the motions between poses (p, 3): every later one moves with a motion, and
    swings with its turn."""
    count = len(poses)
    later = np.tri(count, count - 1, -1)
    c, s = np.cos(poses[:-1, 2]), np.sin(poses[:-1, 2])
    arm = poses[:, None, :2] - poses[None, 1:, :2]
    by_motion = np.empty((count, 2, count - 1, 3))
    by_motion[:, 0, :, 0], by_motion[:, 0, :, 1], by_motion[:, 0, :, 2] = later * c, later * -s, later * -arm[:, :, 1]
    by_motion[:, 1, :, 0], by_motion[:, 1, :, 1], by_motion[:, 1, :, 2] = later * s, later * c, later * arm[:, :, 0]
    return by_motion
