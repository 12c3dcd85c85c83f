"""Pose of one robot in a finished map that does not grow: of an earlier session, or the walls of any grid.

While it is lost, guesses come from places of the map that look like the robot's keyframes (texts, radio, scans, by the
recogniser of the settings); where the map or the robot has neither signs nor radio, also from a search of the robot's
recent scans over the whole map (`global_matching`). It is found when guesses from several places agree, and no others
agree half as often: rooms look alike. From then on each scan is matched to the walls, starting from odometry; it is
lost again when the scans fit too badly for longer than `PATIENCE_S`, and found again when several in a row fit well.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.config import EnvConfig
from twc_env.errors import DataError
from twc_env.records.geometry import between, compose, inverse, transform_points, wrap_angle
from twc_env.records.lasting_map import LastingMap
from twc_env.records.messages import GridMap, Keyframe, SensorFrame
from twc_env.slam.mapping.map_saving import keyframes_of
from twc_env.slam.matching.global_matching import match_globally
from twc_env.slam.matching.point_matching import match_to_tree
from twc_env.slam.matching.scan_matching import scan_points
from twc_env.slam.places.place_recognition import make_recogniser
from twc_env.slam.robot import FrontEnds

TRACKED_MIN, FOUND_MIN = 0.6, 0.75
"""Least fit to believe a match while tracking, and to believe a guess: the share of a scan's points on walls, less the
share of its beams that would have gone through walls."""
THROUGH_STEP_M, THROUGH_M = 0.1, 0.4
"""Spacing of the places on a beam that are looked up in the map, and how far before its end the last one is."""
AGAIN = 3
"""Scans in a row that must fit as a guess must, to be no longer lost."""
PATIENCE_S = 1.5
"""It says that it is lost after so long without a match that it believes."""
GATE_M = 0.6
"""Points of a tracked scan further from a wall have no partner at first."""
MOVED_MAX_M, MOVED_MAX_RAD = 0.5, 0.25
"""A match further from odometry's prediction is not believed."""
AGREE_M, AGREE_RAD = 0.7, 0.15
"""Two guesses agree if the poses of the robot that they imply now differ by less."""
APART_M, VOTES_MIN = 2.0, 4
"""Guesses count once in such a length of path, one by a sign twice, and so many must agree."""
RECENT, SEARCH_EVERY = 12, 4
"""Keyframes whose scans are searched for together, and keyframes between two searches of the whole map."""
SCORE_MIN = 0.5
"""Least score of the global search."""
GUESSES_MAX = 60
"""Latest guesses that wait for another that agrees."""


@dataclass(frozen=True, slots=True, eq=False)
class Place:
    """Where a robot believes to be after a frame."""

    pose_map_robot: Array
    """(3,); of a robot that was never found, in the frame where it started."""
    is_lost: bool
    """Whether it does not know, or has not known for longer than `PATIENCE_S`."""
    fit: float
    """How well the latest scan fits the map, see `TRACKED_MIN`; NaN while it was never found."""


class Localiser:
    """Finds and tracks one robot, number 0, in a map. Frames of a robot must be given in order."""

    def __init__(self, config: EnvConfig, known: LastingMap | GridMap):
        """known: a saved map, or any grid, as a `GridMap`, which has no places.

        Raises DataError for a map without walls.
        """
        from scipy.spatial import cKDTree  # slow to import

        grid = known.grid if isinstance(known, LastingMap) else known
        self._walls_m = grid.centre_of(np.argwhere(grid.log_odds > 0))
        if not len(self._walls_m):
            raise DataError("the map to localise in has no walls; choose another file")
        self._tree = cKDTree(self._walls_m)
        self._grid, self._streak = grid, 0
        self._middle_m = 0.5 * (self._walls_m.min(axis=0) + self._walls_m.max(axis=0))
        self._window_m = 0.5 * float(np.ptp(self._walls_m, axis=0).max())
        self._front_end = FrontEnds(config, 1)
        self._range_max_m = config.lidar.range_max_m
        self._recogniser = make_recogniser(config.slam.place_recognition, config.lidar.range_max_m)
        self._places: list[Keyframe] = keyframes_of(known, 1) if isinstance(known, LastingMap) else []
        for place in self._places:
            self._recogniser.propose(place, (1,))
        self._recent: list[Keyframe] = []
        self._since_search = SEARCH_EVERY
        self._pose_map_odom: Array | None = None
        self._guesses: list[tuple[float, int, Array]] = []
        """Path length, weight, and implied pose of the odom frame in the map of guesses while lost."""
        self._has_cues = any(place.signs or len(place.fingerprint.macs) for place in self._places)
        self._believed_s = -math.inf
        self.is_lost = True
        """See `Place`."""

    def update(self, frame: SensorFrame) -> Place:
        """Take in the next frame of the robot."""
        frames, circles = self._front_end.intake.on_circle([frame])
        keyframes = self._front_end.update(frames)
        odom = self._front_end.poses_odom[0]
        points = scan_points(np.asarray(circles[0]), self._range_max_m)
        fit = math.nan
        if self._pose_map_odom is not None and len(points):
            fit = self._track(odom, points, frame.time_s)
        self.is_lost = self._pose_map_odom is None or frame.time_s - self._believed_s > PATIENCE_S
        for keyframe in keyframes:
            self._recent = [*self._recent[1 - RECENT :], keyframe]
            guesses = self._recognised(keyframe)  # also stores it as a place of its own
            if self.is_lost and self._find([*guesses, *self._searched(keyframe)], keyframe, frame.time_s):
                fit = self._track(odom, points, frame.time_s)
        pose = odom.copy() if self._pose_map_odom is None else compose(self._pose_map_odom, odom)
        return Place(pose, self.is_lost, fit)

    def _track(self, odom: Array, points: Array, time_s: float) -> float:
        """Match a scan to the walls from the predicted pose; returns how well it fits."""
        assert self._pose_map_odom is not None
        predicted = compose(self._pose_map_odom, odom)
        match = match_to_tree(self._tree, points, predicted, GATE_M)
        moved = between(predicted, match.pose)
        is_near = math.hypot(moved[0], moved[1]) <= MOVED_MAX_M and abs(moved[2]) <= MOVED_MAX_RAD
        fit = match.inlier_ratio - self._through(match.pose, points)
        self._streak = self._streak + 1 if is_near and fit >= FOUND_MIN else 0
        if is_near and (fit >= TRACKED_MIN if not self.is_lost else self._streak >= AGAIN):
            self._pose_map_odom, self._believed_s = compose(match.pose, inverse(odom)), time_s
        return fit

    def _through(self, pose: Array, points: Array) -> float:
        """Share of beams to points (n, 2) that would have gone through walls of the map from this pose."""
        length_m = np.hypot(points[:, 0], points[:, 1])
        along_m = np.arange(THROUGH_STEP_M, max(length_m.max(), THROUGH_STEP_M) + THROUGH_STEP_M, THROUGH_STEP_M)
        at = transform_points(pose, (points / length_m[:, None])[:, None] * along_m[:, None])
        is_met = (self._grid.level_at(at) > 0) & (along_m < length_m[:, None] - THROUGH_M)
        return float(is_met.any(axis=1).mean())

    def _recognised(self, keyframe: Keyframe) -> list[tuple[int, Array]]:
        """Weights and poses (3,) of a keyframe in the map, by places of the map that look like it."""
        found = self._recogniser.propose(keyframe, (0,))
        return [
            (1 + (candidate.sign_m is not None), compose(self._places[candidate.target[1]].pose_odom, candidate.guess))
            for candidate in found
            if candidate.target[0] == 1
        ]

    def _searched(self, keyframe: Keyframe) -> list[tuple[int, Array]]:
        """Weight and pose (3,) of a keyframe at which its scan and those before it lie on walls, over the whole map."""
        if self._has_cues and any(recent.signs or len(recent.fingerprint.macs) for recent in self._recent):
            return []
        self._since_search += 1
        if self._since_search < SEARCH_EVERY or len(self._recent) < RECENT // 2:
            return []
        self._since_search = 0
        points = np.concatenate([
            transform_points(between(keyframe.pose_odom, k.pose_odom), scan_points(k.ranges_m, self._range_max_m))
            for k in self._recent
        ])  # fmt: skip
        found = match_globally(self._walls_m - self._middle_m, points, self._window_m, SCORE_MIN)
        return [] if found is None else [(1, found.pose + np.array([*self._middle_m, 0.0]))]

    def _find(self, guesses: list[tuple[int, Array]], keyframe: Keyframe, time_s: float) -> bool:
        """Refine guesses of a keyframe's pose; whether one agrees with enough earlier ones, so that it is found."""
        points, here = scan_points(keyframe.ranges_m, self._range_max_m), keyframe.pose_odom
        for weight, pose in guesses if len(points) else ():
            match = match_to_tree(self._tree, points, pose)
            if match.inlier_ratio - self._through(match.pose, points) < FOUND_MIN:
                continue
            guess = compose(match.pose, inverse(here))
            self._guesses = [*self._guesses[1 - GUESSES_MAX :], (keyframe.travel_m, weight, guess)]
            votes, others = self._votes(compose(np.array([own for *_, own in self._guesses]), here))
            if votes >= VOTES_MIN and 2 * others <= votes:
                self._pose_map_odom, self._believed_s, self.is_lost = guess, time_s, False
                self._guesses.clear()
                return True
        return False

    def _votes(self, poses: Array) -> tuple[int, int]:
        """How many votes the latest guess has, by the poses (k, 3) that all imply now; and the most of any other."""
        apart = between(poses[:, None], poses[None])
        agree = (np.hypot(apart[..., 0], apart[..., 1]) <= AGREE_M) & (np.abs(wrap_angle(apart[..., 2])) <= AGREE_RAD)
        is_rival = ~agree[-1]
        rivals = [self._counted(agree[k] & is_rival) for k in np.flatnonzero(is_rival).tolist()]
        return self._counted(agree[-1]), max(rivals, default=0)

    def _counted(self, chosen: Array) -> int:
        """Votes of some guesses (k,) bool: in each stretch of the path the weightiest counts."""
        votes: dict[int, int] = {}
        for k in np.flatnonzero(chosen).tolist():
            travel_m, weight, _ = self._guesses[k]
            stretch = int(travel_m / APART_M)
            votes[stretch] = max(votes.get(stretch, 0), weight)
        return sum(votes.values())
