"""Geometric verification of loop candidates by scan matching."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.config import LidarConfig, OdometryFilterConfig, VerificationConfig
from twc_env.records.array_validation import validated_pose
from twc_env.records.messages import Keyframe, LoopCandidate, LoopClosure, is_loose
from twc_env.slam.matching.closure_covariance import closure_covariance
from twc_env.slam.matching.global_matching import match_globally, turn_along_walls, walls_run
from twc_env.slam.matching.point_matching import match_points
from twc_env.slam.matching.target_walls import TargetWalls, WallMatch
from twc_env.slam.pose_graph.keyframe_paths import path_position

STEP_M, STEP_RAD = 0.15, 0.05
"""Step of the correlative search; the refinement converges from further than one step."""
SPACING_M = 0.9
"""Path length between the neighbouring keyframes whose scans are used."""
SIGN_STD, NEAR_STD, OPEN_STD = (0.2, 0.2, 0.1), (2.0, 2.0, 0.5), (50.0, 50.0, 0.5)
"""Prior standard deviation of the candidate's guess [m, m, rad]: from a shared sign, from proximity, and from proximity
if the match is loose. A shared sign fixes the position along a corridor. Proximity does not: guesses share their errors
(drift, WiFi), so wrong closures would be consistent."""
SIGN_ALONE_STD = (0.1, 0.12, 0.065)
"""Standard deviation of a shared sign without scan matching [m, m, rad]. Measured on training buildings for pairs with
one sign in common: 0.09, 0.12, 0.06."""
ANYWHERE = ("wifi", "lidar")
"""Recognisers whose guess contains at most a rotation: matches are searched at every heading within WIDE_WINDOW_M."""
WIDE_WINDOW_M = 3.0
SIGN_INFORMATION, NEAR_INFORMATION = (
    np.stack([np.diag(1.0 / np.square(std)) for std in stds]) for stds in ((SIGN_STD, SIGN_STD), (NEAR_STD, OPEN_STD))
)
"""(2, 3, 3) information of these, the second for loose matches."""
FITNESS_MAX_M2 = 0.1
"""Greatest mean squared distance of pairs of points in radio SLAM; the unit is not printed."""
Path = Sequence[Keyframe]
"""All stored keyframes of a robot, in order."""


class LoopVerifier:
    """Matches the scans of two keyframes and their neighbours along the path."""

    def __init__(self, config: VerificationConfig, noise: OdometryFilterConfig, lidar: LidarConfig):
        self._config = config
        self._noise = noise
        variance_m2 = noise.match_std_m**2 * noise.match_correlation
        size_m = 2 * (lidar.range_max_m + config.cloud_reach_m + 1.0)
        self._walls = TargetWalls(size_m, lidar, variance_m2)
        self._drawn: tuple[int, int] | None = None

    def clear(self) -> None:
        """Drop the cached walls of the last target."""
        self._drawn = None

    def verify(self, candidate: LoopCandidate, target_path: Path, source_path: Path) -> LoopClosure:
        """Match the source's points to the target's walls.

        Returns a closure with status "accepted" or "rejected" (and the reason); the back end may still reject it.
        """
        target, source = _keyframes_of(candidate, target_path, source_path)
        rule, points = self._config, self._points(source, source_path, SPACING_M)
        if rule.method == "fitness":
            return self._by_fitness(candidate, self._points(target, target_path), points)
        pose, covariance, overlap = self._match(candidate, target, target_path, points)
        reason = ""
        if overlap < rule.overlap_min:
            reason = f"overlap {overlap:.2f} < {rule.overlap_min:g}"
        else:
            contradiction = self._walls.contradiction(target, source, pose)
            if contradiction > rule.contradiction_max:
                reason = f"contradiction {contradiction:.2f} > {rule.contradiction_max:g}"
        status = "rejected" if reason else "accepted"
        return LoopClosure(candidate, pose, covariance, overlap, status, reason)

    def _by_fitness(self, candidate: LoopCandidate, target: Array, source: Array) -> LoopClosure:
        """ICP, accepted as printed in radio SLAM: fitness below FITNESS_MAX_M2, and more pairs than half of the mean
        number of points of both scans."""
        paired = match_points(target, source, candidate.guess)
        pairs, needed = paired.inlier_ratio * len(source), 0.25 * (len(target) + len(source))
        reason = ""
        if not paired.fitness_m2 < FITNESS_MAX_M2:
            reason = f"fitness {paired.fitness_m2:.3f} >= {FITNESS_MAX_M2:g}"
        elif pairs <= needed:
            reason = f"{pairs:.0f} matches <= {needed:.0f}"
        information = paired.information(self._noise.match_std_m, self._noise.match_correlation)
        covariance = closure_covariance(information, _priors(candidate), float(paired.pose[2]))
        status = "rejected" if reason else "accepted"
        return LoopClosure(candidate, paired.pose, covariance, paired.inlier_ratio, status, reason)

    def is_fixed_by_walls(self, closure: LoopClosure, target_path: Path, source_path: Path, width_m: float) -> bool:
        """Whether a closure is not loose even without objects narrower than width_m, which may be robots."""
        target, source = _keyframes_of(closure.candidate, target_path, source_path)
        self._draw_target(target, target_path)
        seen = _neighbours(source, source_path, min(self._config.cloud_reach_m, SPACING_M))
        remaining = self._walls.refine(
            self._walls.points(seen, width_m), closure.pose_target_source, _priors(closure.candidate)
        )
        return not is_loose(remaining.covariance)

    def _match(self, candidate: LoopCandidate, target: Keyframe, target_path: Path, points: Array) -> WallMatch:
        """Match of the source's points (n, 2) to the target."""
        priors = _priors(candidate)
        if self._config.method == "point-to-point":
            paired = match_points(self._points(target, target_path), points, candidate.guess)
            information = paired.information(self._noise.match_std_m, self._noise.match_correlation)
            return WallMatch(
                paired.pose, closure_covariance(information, priors, float(paired.pose[2])), paired.inlier_ratio
            )
        guess = validated_pose(candidate.guess, "guess")
        self._draw_target(target, target_path)
        match = self._walls.refine(points, guess, priors)
        if match.overlap < self._config.overlap_min or candidate.recogniser in ANYWHERE:  # may not converge
            better = self._search(candidate, target, target_path, points)
            searched = self._walls.refine(points, better, priors)
            if searched.overlap >= match.overlap:
                return searched
        return match

    def scans_needed(self, candidate: LoopCandidate, target_path: Path, source_path: Path) -> list[tuple[int, int]]:
        """(robot, keyframe index) of every scan that `verify` needs."""
        reach = self._config.cloud_reach_m
        target, source = _keyframes_of(candidate, target_path, source_path)
        keyframes = _neighbours(target, target_path, reach)
        keyframes += _neighbours(source, source_path, min(reach, SPACING_M))
        return [k.key for k in keyframes]

    def _draw_target(self, target: Keyframe, path: Path) -> None:
        if self._drawn == target.key and path[-1].travel_m > target.travel_m + self._config.cloud_reach_m:
            return
        self._drawn = target.key
        self._walls.draw(_neighbours(target, path, self._config.cloud_reach_m))

    def _search(self, candidate: LoopCandidate, target: Keyframe, target_path: Path, points: Array) -> Array:
        """A better guess: search around the candidate's guess, or globally for the recognisers of `ANYWHERE`."""
        rule = self._config
        if candidate.recogniser in ANYWHERE:
            target_points = self._points(target, target_path, SPACING_M)
            turn_rad = None
            if candidate.recogniser == "wifi":
                turn_rad = turn_along_walls(walls_run(target_points), walls_run(points))
            found = match_globally(target_points, points, WIDE_WINDOW_M, turn_rad=turn_rad)
            return candidate.guess if found is None else found.pose
        window = rule.window_m, rule.window_rad
        return self._walls.field.correlate(points, candidate.guess, window, (STEP_M, STEP_RAD), stride=4)[0]

    def _points(self, keyframe: Keyframe, path: Path, reach_m: float = math.inf) -> Array:
        """(n, 2) scan points of the keyframe and its neighbours within reach, in the keyframe's frame."""
        return self._walls.points(_neighbours(keyframe, path, min(self._config.cloud_reach_m, reach_m)))


class SignVerifier:
    """Accepts shared signs without verification, for robots without laser."""

    def verify(self, candidate: LoopCandidate, target_path: Path, source_path: Path) -> LoopClosure:
        """The candidate's guess as the measurement."""
        return LoopClosure(candidate, candidate.guess, np.diag(np.square(SIGN_ALONE_STD)), 0.0, "accepted")

    def scans_needed(self, candidate: LoopCandidate, target_path: Path, source_path: Path) -> list[tuple[int, int]]:
        """No scans."""
        return []


def _priors(candidate: LoopCandidate) -> Array:
    """(2, 3, 3) prior information of the candidate's guess, see `closure_covariance`."""
    return NEAR_INFORMATION if candidate.sign_m is None else SIGN_INFORMATION


def _keyframes_of(candidate: LoopCandidate, target_path: Path, source_path: Path) -> tuple[Keyframe, Keyframe]:
    """The two keyframes of a candidate."""
    target, source = path_position(target_path, candidate.target[1]), path_position(source_path, candidate.source[1])
    return target_path[target], source_path[source]


def _neighbours(keyframe: Keyframe, path: Path, reach_m: float) -> list[Keyframe]:
    """The keyframe, followed by others of its robot within reach_m of path length, at least SPACING_M apart."""
    chosen, here_m, position = [keyframe], keyframe.travel_m, path_position(path, keyframe.index)
    for direction, positions in ((-1.0, range(position - 1, -1, -1)), (1.0, range(position + 1, len(path)))):
        first_m = last_m = direction * here_m
        for k in positions:
            other_m = direction * path[k].travel_m
            if other_m - first_m > reach_m:
                break
            if other_m - last_m >= SPACING_M:
                chosen.append(path[k])
                last_m = other_m
    return chosen
